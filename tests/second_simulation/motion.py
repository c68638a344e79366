"""Six degrees of freedom in earth axes with a quaternion, tail and wing built up apart, in frozen air.

Newton's law is written for the velocity over ground and the attitude as a quaternion; wing, tail and downwash are
forces of their own, each in the air that it meets. What a table of derivatives says is given back in slow motion.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tests.second_simulation.air import BEHIND, STEP, Air
from tests.second_simulation.aircraft import (
    AREA,
    CHORD,
    IXX,
    IXZ,
    IZZ,
    LATERAL,
    SPAN,
    UPWASH_MOTION,
    WAGNER,
    Drawn,
    G,
    density,
)

Array = NDArray[np.float64]

RATE: Final = 400
DT: Final = 1.0 / RATE
HELD: Final = RATE // 50
"""Steps from one command of the pilot or autopilot to the next."""


class Hidden(NamedTuple):
    """What the aircraft does that its derivatives do not say; SI, nothing at 0."""

    alpha2: float = 0.0
    speed: float = 0.0
    """CL_V."""
    tail_late: float = 0.0
    """Share of the tail arm by which gusts meet it late."""
    downwash_late: float = 0.0
    gust_early: float = 0.0
    """Share of the boom by which gusts meet the vane early."""
    thrust_arm: float = 0.0
    backlash: float = 0.0
    """Between the elevator's sensor and its surface."""
    flexure: float = 0.0
    """Of the boom, by the CG's normal acceleration."""
    mode: float = 0.0
    """Of the boom, by its tip's, through its first bending mode."""
    stall_sharpness: float = 0.0
    """Goman and Khrabrov 1994: a1; 0: never separated."""
    stall_alpha: float = 0.0
    stall_lag: float = 0.0
    stall_late: float = 0.0
    """tau2."""
    slosh: float = 0.0
    """Share of the mass that swings at 0.6 Hz along the body."""


class Feedback(NamedTuple):
    """Gains of the controls on what an autopilot measures: rad by rad/s, rad, m."""

    q: float = 0.0
    theta: float = 0.0
    h: float = 0.0
    phi: float = 0.0
    p: float = 0.0
    r: float = 0.0
    delay: float = 0.04
    noise: float = 0.0
    """Of all its signals, times 0.1 deg(/s) and 1 m."""


class Constants(NamedTuple):
    """The aircraft as the equations need it."""

    mass: float
    iyy: float
    cl: tuple[float, float, float, float]
    cm: tuple[float, float, float, float]
    cd0: float
    induced: float
    lateral: tuple[float, ...]
    tail_slope: float
    downwash: float
    tail_arm: float
    boom: float
    upwash_body: float
    upwash_wing: float
    sidewash: float
    vane: float
    vane_damping: float
    motion_a: tuple[float, float]
    motion_b: tuple[float, float]
    upwash_a: tuple[float, float]
    upwash_b: tuple[float, float]
    rho: float
    speed: float
    thrust: float
    thrust_slope: float
    actuator: float
    alpha: float
    elevator: float


POS, VEL, QUAT, RATES, SURF, WAKE = 0, 3, 6, 10, 13, 16
TURN, VANE, BETA, SEP, MODE, FUEL, BEFORE = 18, 20, 22, 24, 25, 27, 29
STATES: Final = 30
BRIEF: Final = 0.02
"""Seconds over which the angle of attack's rate is taken."""

COLUMNS: Final = (
    "alpha_vane", "beta_vane", "airspeed", "dynamic_pressure", "p", "q", "r", "ax", "ay", "az", "phi", "theta", "psi",
    "v_north", "v_east", "v_down", "altitude", "elevator", "aileron", "rudder", "thrust", "qdot", "pdot", "rdot",
    "alpha", "alpha_inertial", "w_gust", "CL", "Cm", "surface",
)  # fmt: skip


def constants(aircraft: Drawn, hidden: Hidden) -> Constants:
    """Trimmed in level flight in still air."""
    d, rho, v = aircraft.derivatives, density(aircraft.altitude), aircraft.speed
    pressure = 0.5 * rho * v * v * AREA
    alpha, elevator, thrust = 0.0, 0.0, 0.0
    for _ in range(200):
        need = (aircraft.mass * G - thrust * math.sin(alpha)) / pressure
        separated = stalled(alpha, hidden)
        extra = hidden.alpha2 * alpha * alpha
        moment = thrust * hidden.thrust_arm / (pressure * CHORD)
        slope = np.array([[d["CL_alpha"], d["CL_de"]], [d["Cm_alpha"], d["Cm_de"]]])
        of_wing = d["CL_alpha"] - aircraft.tail_slope * (1 - aircraft.downwash)
        lost = (1 - separated) * (aircraft.CL_0 + of_wing * alpha)
        wanted = [need - aircraft.CL_0 - separated * extra + lost, -aircraft.Cm_0 - moment]
        step = np.linalg.solve(slope, wanted)
        alpha, elevator = alpha + 0.5 * (step[0] - alpha), elevator + 0.5 * (step[1] - elevator)
        drag = aircraft.CD_0 + aircraft.induced * need**2
        thrust = pressure * drag / math.cos(alpha)
    memory, rate = aircraft.memory, aircraft.memory_rate
    return Constants(
        mass=aircraft.mass,
        iyy=aircraft.iyy,
        cl=(aircraft.CL_0, d["CL_alpha"], d["CL_q"], d["CL_de"]),
        cm=(aircraft.Cm_0, d["Cm_alpha"], d["Cm_q"], d["Cm_de"]),
        cd0=aircraft.CD_0,
        induced=aircraft.induced,
        lateral=tuple(aircraft.lateral[n] for n in LATERAL),
        tail_slope=aircraft.tail_slope,
        downwash=aircraft.downwash,
        tail_arm=aircraft.tail_arm,
        boom=aircraft.boom_x,
        upwash_body=aircraft.upwash_body,
        upwash_wing=aircraft.upwash_wing,
        sidewash=aircraft.sidewash,
        vane=2 * math.pi * aircraft.vane_hz,
        vane_damping=aircraft.vane_damping,
        motion_a=(memory * WAGNER["a"][0], memory * WAGNER["a"][1]),
        motion_b=(rate * WAGNER["b"][0], rate * WAGNER["b"][1]),
        upwash_a=(aircraft.upwash_memory * UPWASH_MOTION["a"][0], aircraft.upwash_memory * UPWASH_MOTION["a"][1]),
        upwash_b=(aircraft.upwash_rate * UPWASH_MOTION["b"][0], aircraft.upwash_rate * UPWASH_MOTION["b"][1]),
        rho=rho,
        speed=v,
        thrust=thrust,
        thrust_slope=aircraft.thrust_slope,
        actuator=aircraft.actuator_lag,
        alpha=alpha,
        elevator=elevator,
    )


@njit(cache=True)
def attached(alpha: float, sharpness: float, angle: float) -> float:
    return 0.5 * (1 - math.tanh(sharpness * (alpha - angle)))


def stalled(alpha: float, hidden: Hidden) -> float:
    """Share of the attached lift that is left (Kirchhoff)."""
    if not hidden.stall_sharpness:
        return 1.0
    return 0.25 * (1 + math.sqrt(attached(alpha, hidden.stall_sharpness, hidden.stall_alpha))) ** 2


@njit(cache=True)
def at(field: Array, place: float) -> float:
    x = (place + BEHIND) / STEP
    i = min(max(math.floor(x), 0), len(field) - 2)
    return field[i] + (x - i) * (field[i + 1] - field[i])


@njit(cache=True)
def lifted(gust: float, angle: float, speed: float) -> float:
    """rad, by how much an updraught `gust` (m/s) raises a flow that comes at `angle` (rad), by the law of sines;
    `speed` (m/s) is that of the flow with the gust in it. What follows at once so has the vane's angle of attack."""
    return math.asin(gust * math.cos(angle) / speed)


@njit(cache=True)
def passed(places: Array, values: Array, newest: int, place: float) -> float:
    """What the wing's incidence was where it was at `place`."""
    i = newest
    while i > 0 and places[i] > place:
        i -= 1
    if i == newest:
        return values[newest]
    share = (place - places[i]) / max(places[i + 1] - places[i], 1e-9)
    return values[i] + max(share, 0.0) * (values[i + 1] - values[i])


@njit(cache=True)
def rates(x, c, h, gusts, command, surface, places, values, newest, out):
    """Derivative of the state; `out` takes COLUMNS. `surface`: where the elevator was when the step began."""
    half = 0.5 * h.backlash
    surface = min(max(surface, x[SURF] - half), x[SURF] + half)
    up, wing_field, upwash_field, head, side, roll_field = gusts
    dx = np.zeros(STATES)
    a, b, cc, d = x[QUAT], x[QUAT + 1], x[QUAT + 2], x[QUAT + 3]
    # Rotation from body to earth.
    r00, r01, r02 = a * a + b * b - cc * cc - d * d, 2 * (b * cc - a * d), 2 * (b * d + a * cc)
    r10, r11, r12 = 2 * (b * cc + a * d), a * a - b * b + cc * cc - d * d, 2 * (cc * d - a * b)
    r20, r21, r22 = 2 * (b * d - a * cc), 2 * (cc * d + a * b), a * a - b * b - cc * cc + d * d
    vn, ve, vd = x[VEL], x[VEL + 1], x[VEL + 2]
    p, q, r = x[RATES], x[RATES + 1], x[RATES + 2]
    u, v, w = r00 * vn + r10 * ve + r20 * vd, r01 * vn + r11 * ve + r21 * vd, r02 * vn + r12 * ve + r22 * vd
    place = x[POS]
    gu, gv, gw = at(head, place), at(side, place), at(up, place)
    ua, va, wa = u + gu, v + gv, w + gw
    speed = math.sqrt(ua * ua + va * va + wa * wa)
    inertial = math.atan2(w, u)
    # A gust along the path turns the flow of the aircraft's own motion, at each place when it is there.
    turn = math.atan2(w, ua) - inertial
    alpha, beta = math.atan2(wa, ua), math.asin(va / speed)
    thinner = density(-x[POS + 2]) / c.rho
    pressure = 0.5 * c.rho * thinner * speed * speed
    force = pressure * AREA
    edge = lifted(at(wing_field, place + 0.25 * CHORD), inertial + turn, speed)
    # Motion's share of the wing's incidence, with its memory.
    moved = inertial * (1 - c.motion_a[0] - c.motion_a[1])
    for k in range(2):
        moved += c.motion_a[k] * x[WAKE + k]
        dx[WAKE + k] = speed / CHORD * c.motion_b[k] * (inertial - x[WAKE + k])
    wing = moved + edge + turn
    behind = c.tail_arm + speed * h.downwash_late
    wash = c.downwash * passed(places, values, newest, place - behind)
    turn_tail = math.atan2(w, u + at(head, place - c.tail_arm)) - inertial
    met = lifted(at(up, place - c.tail_arm * (1 + h.tail_late)), inertial + turn_tail, speed)
    tail = inertial + turn_tail + q * c.tail_arm / speed + met - wash
    qhat, arm = q * CHORD / (2 * speed), c.tail_arm / CHORD
    whole = c.tail_slope * (1 - c.downwash)
    cl_wing = c.cl[0] + (c.cl[1] - whole) * wing + h.alpha2 * alpha * alpha + h.speed * (speed / c.speed - 1)
    if h.stall_sharpness > 0:
        share = x[SEP]
        turning = (alpha - x[BEFORE]) / BRIEF
        dx[BEFORE] = turning
        target = attached(alpha - h.stall_late * turning, h.stall_sharpness, h.stall_alpha)
        dx[SEP] = (target - share) / h.stall_lag
        cl_wing *= 0.25 * (1 + math.sqrt(max(share, 0.0))) ** 2
    rest_q = c.cl[2] - 2 * c.tail_slope * arm * (1 + c.downwash)
    cl = cl_wing + c.tail_slope * tail + rest_q * qhat + c.cl[3] * surface
    rest_m = c.cm[2] + 2 * c.tail_slope * arm * arm * (1 + c.downwash)
    cm = c.cm[0] + (c.cm[1] + whole * arm) * wing - c.tail_slope * arm * tail + rest_m * qhat + c.cm[3] * surface
    cd = c.cd0 + c.induced * cl * cl
    thrust = c.thrust * thinner * (1 + c.thrust_slope * (speed / c.speed - 1))
    ca, sa = ua / math.hypot(ua, wa), wa / math.hypot(ua, wa)
    t = c.lateral
    phat, rhat = (p + at(roll_field, place)) * SPAN / (2 * speed), r * SPAN / (2 * speed)
    da, dr = x[SURF + 1], x[SURF + 2]
    cy = t[0] * beta + t[1] * phat + t[2] * rhat + t[3] * da + t[4] * dr
    croll = t[5] * beta + t[6] * phat + t[7] * rhat + t[8] * da + t[9] * dr
    cn = t[10] * beta + t[11] * phat + t[12] * rhat + t[13] * da + t[14] * dr
    fx = (force * (cl * sa - cd * ca) + thrust) / c.mass
    fy = force * cy / c.mass
    fz = -force * (cl * ca + cd * sa) / c.mass
    if h.slosh > 0:
        s, sv = x[FUEL], x[FUEL + 1]
        wn = 2 * math.pi * 0.6
        dx[FUEL] = sv
        dx[FUEL + 1] = -wn * wn * s - 2 * 0.1 * wn * sv - fx
        cm -= h.slosh * c.mass * s * (-fz) / (force * CHORD)
    qdot = (force * CHORD * cm + thrust * h.thrust_arm - (IXX - IZZ) * p * r - IXZ * (p * p - r * r)) / c.iyy
    roll = force * SPAN * croll - (IZZ - c.iyy) * q * r + IXZ * p * q
    yaw = force * SPAN * cn - (c.iyy - IXX) * p * q - IXZ * q * r
    inverse = 1.0 / (IXX * IZZ - IXZ * IXZ)
    pdot, rdot = (IZZ * roll + IXZ * yaw) * inverse, (IXZ * roll + IXX * yaw) * inverse
    # Gusts and wakes stand along the path: the boom meets them a boom's length before the CG, in a dive too.
    dx[POS], dx[POS + 1], dx[POS + 2] = math.sqrt(vn * vn + ve * ve + vd * vd), ve, vd
    dx[VEL] = r00 * fx + r01 * fy + r02 * fz
    dx[VEL + 1] = r10 * fx + r11 * fy + r12 * fz
    dx[VEL + 2] = r20 * fx + r21 * fy + r22 * fz + G
    dx[QUAT] = 0.5 * (-b * p - cc * q - d * r)
    dx[QUAT + 1] = 0.5 * (a * p + cc * r - d * q)
    dx[QUAT + 2] = 0.5 * (a * q - b * r + d * p)
    dx[QUAT + 3] = 0.5 * (a * r + b * q - cc * p)
    dx[RATES], dx[RATES + 1], dx[RATES + 2] = pdot, qdot, rdot
    for k in range(3):
        dx[SURF + k] = min(max((command[k] - x[SURF + k]) / c.actuator, -1.05), 1.05)
    # The vanes: the boom's own motion, the air that it meets, and the flow that the wing turns.
    ahead = place + c.boom * (1 + h.gust_early)
    bu, bw, bv = u + at(head, ahead), w - q * c.boom, v + r * c.boom
    turned = inertial * (1 - c.upwash_a[0] - c.upwash_a[1])
    for k in range(2):
        turned += c.upwash_a[k] * x[TURN + k]
        dx[TURN + k] = speed / CHORD * c.upwash_b[k] * (inertial - x[TURN + k])
    turned += lifted(at(upwash_field, place + 0.25 * CHORD), inertial + turn, speed) + turn
    bend = h.flexure * fz
    if h.mode > 0:
        wn = 2 * math.pi * 8.0
        dx[MODE] = x[MODE + 1]
        dx[MODE + 1] = wn * wn * (h.mode * (fz - qdot * c.boom) - x[MODE]) - 2 * 0.03 * wn * x[MODE + 1]
        bend += x[MODE] - 0.5 * c.boom * x[MODE + 1] / speed
    flow = (1 + c.upwash_body) * math.atan2(bw + at(up, ahead), bu) + c.upwash_wing * turned + bend
    slip = (1 + c.sidewash) * math.atan2(bv + at(side, ahead), bu)
    dx[VANE] = x[VANE + 1]
    dx[VANE + 1] = c.vane * c.vane * (flow - x[VANE]) - 2 * c.vane_damping * c.vane * x[VANE + 1]
    dx[BETA] = x[BETA + 1]
    dx[BETA + 1] = c.vane * c.vane * (slip - x[BETA]) - 2 * c.vane_damping * c.vane * x[BETA + 1]
    out[0], out[1], out[2], out[3] = x[VANE], x[BETA], speed, pressure
    out[4], out[5], out[6], out[7], out[8], out[9] = p, q, r, fx, fy, fz
    out[10] = math.atan2(r21, r22)
    out[11] = -math.asin(min(max(r20, -1.0), 1.0))
    out[12] = math.atan2(r10, r00)
    out[13], out[14], out[15], out[16] = vn, ve, vd, -x[POS + 2]
    out[17], out[18], out[19], out[20] = x[SURF], da, dr, thrust
    out[21], out[22], out[23] = qdot, pdot, rdot
    out[24], out[25], out[26], out[27], out[28], out[29] = alpha, inertial, gw, cl, cm, surface
    return dx, wing


@njit(cache=True)
def integrate(x, c, h, f, gusts, inputs, noise, rows):
    """Fourth-order Runge-Kutta; the controls are held for HELD steps, and follow what was measured f.delay ago."""
    n = len(rows)
    places, values = np.empty(n + 1), np.empty(n + 1)
    places[0], values[0] = x[POS] - 1000.0, x[WAKE]
    late = round(f.delay * RATE)
    scratch, command = np.empty(rows.shape[1]), np.array([c.elevator, 0.0, 0.0])
    level, surface = x[SURF] * 0 + c.alpha, x[SURF]
    height = -x[POS + 2]
    for i in range(n):
        if i % HELD == 0:
            for k in range(3):
                command[k] = inputs[k, i]
            command[0] += c.elevator
            j = i - late
            if j >= 0:
                m = noise[i // HELD] * f.noise
                deg = math.pi / 180
                command[0] += f.q * (rows[j, 5] + 0.1 * deg * m[0]) + f.theta * (rows[j, 11] - level + 0.1 * deg * m[1])
                command[0] += f.h * (rows[j, 16] - height + m[2])
                command[1] += f.phi * (rows[j, 10] + 0.1 * deg * m[3]) + f.p * (rows[j, 4] + 0.1 * deg * m[4])
                command[2] += f.r * (rows[j, 6] + 0.1 * deg * m[5])
            for k in range(3):
                command[k] = min(max(command[k], -0.35), 0.35)
        half = 0.5 * h.backlash
        surface = min(max(surface, x[SURF] - half), x[SURF] + half)
        k1, wing = rates(x, c, h, gusts, command, surface, places, values, i, rows[i])
        newest = i + 1
        places[newest], values[newest] = x[POS], wing
        k2, _ = rates(x + 0.5 * DT * k1, c, h, gusts, command, surface, places, values, newest, scratch)
        k3, _ = rates(x + 0.5 * DT * k2, c, h, gusts, command, surface, places, values, newest, scratch)
        k4, _ = rates(x + DT * k3, c, h, gusts, command, surface, places, values, newest, scratch)
        x = x + DT / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        norm = math.sqrt(x[QUAT] ** 2 + x[QUAT + 1] ** 2 + x[QUAT + 2] ** 2 + x[QUAT + 3] ** 2)
        for k in range(4):
            x[QUAT + k] /= norm


def fly(
    aircraft: Drawn, met: Air, inputs: Array, hidden: Hidden, feedback: Feedback, rng: np.random.Generator
) -> dict[str, Array]:
    """COLUMNS at every DT, true; `inputs` (3, n): what the pilot adds to the trimmed elevator, aileron and rudder."""
    c = constants(aircraft, hidden)
    x = np.zeros(STATES)
    x[POS + 2], x[VEL] = -aircraft.altitude, aircraft.speed
    x[QUAT], x[QUAT + 2] = math.cos(c.alpha / 2), math.sin(c.alpha / 2)
    x[SURF] = c.elevator
    x[WAKE : WAKE + 2] = x[TURN : TURN + 2] = c.alpha
    x[BEFORE] = c.alpha
    x[SEP] = attached(c.alpha, hidden.stall_sharpness, hidden.stall_alpha) if hidden.stall_sharpness else 1.0
    fz = -G * math.cos(c.alpha)
    x[MODE] = hidden.mode * fz
    x[FUEL] = -G * math.sin(c.alpha) / (2 * math.pi * 0.6) ** 2
    x[VANE] = (1 + c.upwash_body + c.upwash_wing) * c.alpha + (hidden.flexure + hidden.mode) * fz
    rows = np.empty((inputs.shape[1], len(COLUMNS)))
    noise = rng.standard_normal((inputs.shape[1] // HELD + 1, 6))
    gusts = (met.up, met.wing, met.upwash, met.head, met.side, met.roll)
    integrate(x, c, hidden, feedback, gusts, inputs, noise, rows)
    return dict(zip(COLUMNS, rows.T.copy(), strict=True))
