"""The aircraft's equations of motion: nonlinear, three degrees of freedom, quasi-steady or with unsteady lift and tail.

Axes as in conventions. u, w and q are inertial (relative to the air mass that the mean wind carries along); a gust
(u_g, w_g) adds to them to give the velocity relative to the air, so w_g > 0 is an updraught and u_g > 0 a headwind.

Sources: Klein and Morelli 2006 (equations of motion); thin-wing and tail model: wing incidence with Wagner-like memory
of the motion and Kuessner-like memory of the gust met at the leading edge, a tail that meets gust and downwash one
tail arm later. In the steady limit both models return the profile's derivatives exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import G0
from station.numerics.atmosphere import SCALE_HEIGHT, TROPOPAUSE, atmosphere
from station.profile import Aircraft, Indicial
from station.rows import ProfileError
from station.simulation.trigonometry import arctangent, sine_cosine

U, W, Q, THETA, DISTANCE, HEIGHT, ELEVATOR, THRUST, LAGS = range(9)
"""State: u, w (m/s), q (rad/s), theta (rad), distance flown through the air mass (m), height (m), the elevator's drive
(rad), which its surface follows with the play there is, thrust (N); from LAGS on the memory of the lift, first of the
motion, then of the gust (rad)."""

(AIRSPEED, PRESSURE, CL, CD, CM, FORCE_X, FORCE_Z, WING, ALPHA, ALPHA_INERTIAL, GUST_LE, SURFACE) = range(12)
"""What `rates` leaves in `aux`: airspeed (m/s), dynamic pressure (Pa), CL, CD, Cm, specific force at the CG along x and
z (m/s2), effective wing incidence from trim, angle of attack, its inertial part, gust incidence at the leading edge,
elevator surface (rad)."""
AUX_SIZE: Final = 12

_SUPPORTED: Final = frozenset(
    {f"{c}_{x}" for c in ("CL", "Cm") for x in ("0", "V", "alpha", "alpha2", "alpha3", "q", "de", "gust")}
    | {"CD_0", "CD_V", "CD_alpha"}
)


class Constants(NamedTuple):
    """Everything the equations of motion need, SI; one flat value so that compiled code can take it."""

    mass: float
    iyy: float
    area: float
    chord: float
    cl_trim: float
    cl_v: float
    cl_alpha: float
    cl_alpha2: float
    """Per rad2 of alpha itself, not from trim; the powers count the whole alpha without memory. alpha3 and Cm alike."""
    cl_alpha3: float
    cl_q: float
    cl_de: float
    cl_gust: float
    """Beyond CL_alpha, per rad of the gust's part of alpha at the CG; Cm alike."""
    cm_trim: float
    cm_v: float
    cm_alpha: float
    cm_alpha2: float
    cm_alpha3: float
    cm_q: float
    cm_de: float
    cm_gust: float
    cd_0: float
    cd_v: float
    cd_alpha: float
    cd_induced: float
    reference_speed: float
    fixed_rate_reference: float
    """1: rates are normalised with the reference speed, 0: with the airspeed of the instant."""
    fixed_density: float
    """kg/m3; 0: standard atmosphere at the height flown."""
    thrust_cos: float
    thrust_sin: float
    thrust_arm: float
    memory: float
    """1: unsteady lift and a tail that meets the gust late; 0: quasi-steady, everything at the CG."""
    memory_chord: float
    tail_slope: float
    tail_arm: float
    gust_arm: float
    """How far behind the CG the tail meets a gust, m."""
    gust_edge: float
    """How far ahead of the CG the wing does, m."""
    downwash: float
    downwash_delay: float
    actuator_lag: float
    actuator_rate: float
    actuator_limit: float
    elevator_play: float
    """Half of the play between the elevator's drive, where its sensor is, and its surface, rad."""
    trim_alpha: float
    trim_elevator: float
    trim_thrust: float
    trim_speed: float
    trim_height: float
    hold_speed: float
    """Thrust acceleration per speed error, 1/s."""
    hold_height: float
    """Thrust acceleration per height error, 1/s2."""
    hold_lag: float


@dataclass(frozen=True, slots=True)
class Trim:
    """Steady level flight: rad, N, and the lift coefficient."""

    alpha: float
    elevator: float
    thrust: float
    lift_coefficient: float


# The pilot holds speed and height with thrust alone, through a 3 s engine and hand lag: the elevator stays free for the
# test input, so nothing correlates with alpha or q in the identification band. Speed feedback damps the phugoid
# (0.04 Hz, ratio about 0.4); height feedback brings a climb back within about a minute.
HOLD_SPEED: Final = 0.20
HOLD_HEIGHT: Final = 0.004
HOLD_LAG: Final = 3.0


def _steady(aircraft: Aircraft, speed: float, alpha: float, de: float) -> tuple[float, float, float]:
    """CL, CD, Cm in steady flight."""
    v = aircraft.value
    ratio = speed / (aircraft.reference_speed or speed)
    cl = v("CL_0") + v("CL_V") * ratio + v("CL_alpha") * alpha + v("CL_de") * de
    cm = v("Cm_0") + v("Cm_V") * ratio + v("Cm_alpha") * alpha + v("Cm_de") * de
    cl += v("CL_alpha2") * alpha**2 + v("CL_alpha3") * alpha**3
    cm += v("Cm_alpha2") * alpha**2 + v("Cm_alpha3") * alpha**3
    if aircraft.drag is not None:
        return cl, aircraft.drag.zero_lift + aircraft.drag.induced * cl * cl, cm
    return cl, v("CD_0") + v("CD_V") * ratio + v("CD_alpha") * alpha, cm


def find_trim(aircraft: Aircraft, speed: float, height: float) -> Trim:
    """Steady level flight at a true airspeed (m/s) and height (m), by Newton's method on (alpha, elevator, thrust).

    Raises ProfileError if there is none.
    """
    density = aircraft.air_density or atmosphere(height)[2]
    weight = aircraft.inertia.mass * G0
    scale = 0.5 * density * speed**2 * aircraft.geometry.wing_area

    def imbalance(x: NDArray[np.float64]) -> NDArray[np.float64]:
        alpha, de, thrust = float(x[0]), float(x[1]), float(x[2]) * weight
        cl, cd, cm = _steady(aircraft, speed, alpha, de)
        line = alpha + aircraft.thrust_angle
        return np.array(
            [
                (thrust * math.cos(line) - scale * cd) / weight,
                (thrust * math.sin(line) + scale * cl) / weight - 1.0,
                cm + thrust * aircraft.thrust_pitch_arm / (scale * aircraft.geometry.chord),
            ]
        )

    x = np.array([0.05, 0.0, 0.1])
    step = 1e-6
    for _ in range(20):
        f = imbalance(x)
        if np.abs(f).max() < 1e-13:
            break
        jacobian = np.empty((3, 3))
        for j in range(3):
            d = np.zeros(3)
            d[j] = step
            jacobian[:, j] = (imbalance(x + d) - imbalance(x - d)) / (2 * step)
        if abs(np.linalg.det(jacobian)) < 1e-12:
            raise ProfileError(f"aircraft {aircraft.name}: cannot be trimmed: CL_alpha and Cm_de must not be 0")
        x = x - np.linalg.solve(jacobian, f)
    alpha, de, thrust = float(x[0]), float(x[1]), float(x[2]) * weight
    sound = np.abs(imbalance(x)).max() < 1e-9 and abs(alpha) < 0.4 and abs(de) < aircraft.elevator.position_limit
    if not sound or thrust < -1e-9 * weight:
        raise ProfileError(
            f"aircraft {aircraft.name}: no trim at {speed:.1f} m/s, {height:.0f} m "
            f"(alpha {math.degrees(alpha):.1f} deg, elevator {math.degrees(de):.1f} deg, thrust {thrust:.0f} N)"
        )
    return Trim(alpha, de, thrust, _steady(aircraft, speed, alpha, de)[0])


def constants(aircraft: Aircraft, speed: float, height: float, hold: bool = True, play: float = 0.0) -> Constants:
    """The equations' constants for an aircraft trimmed at that true airspeed (m/s) and height (m).

    `hold` lets the pilot hold both with thrust; `play` is the elevator's (whole, rad). Raises ProfileError for an
    aircraft that cannot be simulated.
    """
    iyy = aircraft.inertia.iyy
    if iyy is None:
        raise ProfileError(f"aircraft {aircraft.name}: inertia.iyy: missing; the simulation needs it")
    for name, derivative in aircraft.derivatives.items():
        if name[:2] in ("CL", "CD", "Cm") and name not in _SUPPORTED and derivative.value != 0:
            raise ProfileError(f"aircraft {aircraft.name}: derivatives.{name}: the simulation has no such term")
    trim = find_trim(aircraft, speed, height)
    v, unsteady, drag = aircraft.value, aircraft.unsteady, aircraft.drag
    return Constants(
        mass=aircraft.inertia.mass,
        iyy=iyy,
        area=aircraft.geometry.wing_area,
        chord=aircraft.geometry.chord,
        cl_trim=trim.lift_coefficient,
        cl_v=v("CL_V"),
        cl_alpha=v("CL_alpha"),
        cl_alpha2=v("CL_alpha2"),
        cl_alpha3=v("CL_alpha3"),
        cl_q=v("CL_q"),
        cl_de=v("CL_de"),
        cl_gust=v("CL_gust"),
        cm_trim=v("Cm_0")
        + v("Cm_V") * speed / (aircraft.reference_speed or speed)
        + v("Cm_alpha") * trim.alpha
        + v("Cm_alpha2") * trim.alpha**2
        + v("Cm_alpha3") * trim.alpha**3
        + v("Cm_de") * trim.elevator,
        cm_v=v("Cm_V"),
        cm_alpha=v("Cm_alpha"),
        cm_alpha2=v("Cm_alpha2"),
        cm_alpha3=v("Cm_alpha3"),
        cm_q=v("Cm_q"),
        cm_de=v("Cm_de"),
        cm_gust=v("Cm_gust"),
        cd_0=drag.zero_lift if drag else v("CD_0"),
        cd_v=0.0 if drag else v("CD_V"),
        cd_alpha=0.0 if drag else v("CD_alpha"),
        cd_induced=drag.induced if drag else 0.0,
        reference_speed=aircraft.reference_speed or speed,
        fixed_rate_reference=float(aircraft.rate_reference == "fixed"),
        fixed_density=aircraft.air_density or 0.0,
        thrust_cos=math.cos(aircraft.thrust_angle),
        thrust_sin=math.sin(aircraft.thrust_angle),
        thrust_arm=aircraft.thrust_pitch_arm,
        memory=float(unsteady.memory),
        memory_chord=unsteady.reference_chord or aircraft.geometry.chord,
        tail_slope=unsteady.tail_lift_slope,
        tail_arm=unsteady.tail_arm,
        gust_arm=unsteady.tail_arm * unsteady.tail_penetration,
        gust_edge=aircraft.gust_edge,
        downwash=unsteady.downwash,
        downwash_delay=unsteady.downwash_delay,
        actuator_lag=aircraft.elevator.time_constant,
        actuator_rate=aircraft.elevator.rate_limit,
        actuator_limit=aircraft.elevator.position_limit,
        elevator_play=0.5 * play,
        trim_alpha=trim.alpha,
        trim_elevator=trim.elevator,
        trim_thrust=trim.thrust,
        trim_speed=speed,
        trim_height=height,
        hold_speed=HOLD_SPEED if hold else 0.0,
        hold_height=HOLD_HEIGHT if hold else 0.0,
        hold_lag=HOLD_LAG,
    )


def indicial_table(indicial: Indicial | None) -> NDArray[np.float64]:
    """(2, n): amplitudes, and exponents per chord travelled; n = 0 for a response without memory."""
    return np.array([indicial.a, indicial.b]) if indicial else np.zeros((2, 0))


def span_averaged(table: NDArray[np.float64], length: float) -> NDArray[np.float64]:
    """A response to gusts, (2, n), behind a first-order lag of `length` chords travelled, (2, n + 1).

    The wing meets the mean of the gusts along its span. That of a sum of exponentials behind the lag is again one:
    1 - sum a b'/(b' - b) exp(-b t) - (1 - sum a b'/(b' - b)) exp(-b' t), b' = 1/length.
    """
    if length <= 0:
        return table
    b = 1.0 / length
    own = np.where(np.abs(b - table[1]) < 1e-6 * b, table[1] * (1 + 2e-6), table[1])
    a = table[0] * b / (b - own)
    return np.array([[*a, 1.0 - a.sum()], [*own, b]])


@njit(cache=True, error_model="numpy")
def trimmed_state(c: Constants, lags: int) -> NDArray[np.float64]:
    """The state in trim, with that many memory states at rest."""
    x = np.zeros(LAGS + lags)
    x[U] = c.trim_speed * math.cos(c.trim_alpha)
    x[W] = c.trim_speed * math.sin(c.trim_alpha)
    x[THETA] = c.trim_alpha
    x[HEIGHT] = c.trim_height
    x[ELEVATOR] = c.trim_elevator
    x[THRUST] = c.trim_thrust
    return x


@njit(cache=True, error_model="numpy")
def air_at(c: Constants, height: float) -> tuple[float, float, float]:
    """Height (m), density there (kg/m3) and its slope (kg/m4): enough for the few centimetres of one step."""
    if c.fixed_density > 0.0:
        return height, c.fixed_density, 0.0
    density = atmosphere(height)[2]
    if height > TROPOPAUSE:
        return height, density, -density / SCALE_HEIGHT
    temperature = 288.15 - 0.0065 * height
    return height, density, -4.255876 * 0.0065 / temperature * density


@njit(cache=True, error_model="numpy", inline="always")
def rates(
    c: Constants,
    lift_motion: NDArray[np.float64],
    lift_gust: NDArray[np.float64],
    x: NDArray[np.float64],
    command: float,
    air: tuple[float, float, float],
    gust: tuple[float, float, float, float, float, float],
    past_wing: float,
    side: float,
    surface: float,
    dx: NDArray[np.float64],
    aux: NDArray[np.float64],
) -> None:
    """Time derivative of the state `x` into `dx`, and the quantities on the way into `aux`.

    `air` is what `air_at` gives for a height within a metre of the state's; `gust` (u_g, w_g) at the CG, at the leading
    edge and at the tail, m/s; `past_wing` the wing incidence (from trim, rad) whose downwash reaches the tail now;
    `side` the sideways velocity relative to the air, m/s; `surface` where the elevator was a step ago and `command`
    where it is commanded, rad.
    """
    u, w, q, theta = x[U], x[W], x[Q], x[THETA]
    ua, wa = u + gust[0], w + gust[1]
    speed = math.sqrt(ua * ua + side * side + wa * wa)
    alpha_inertial = arctangent(w, u)
    alpha = arctangent(wa, ua)
    pressure = 0.5 * (air[1] + air[2] * (x[HEIGHT] - air[0])) * speed * speed
    qhat = 0.5 * q * c.chord / (c.reference_speed if c.fixed_rate_reference > 0.0 else speed)
    moved = min(max(surface, x[ELEVATOR] - c.elevator_play), x[ELEVATOR] + c.elevator_play)
    de = moved - c.trim_elevator
    faster = (speed - c.trim_speed) / c.reference_speed

    nm = lift_motion.shape[1]
    ng = lift_gust.shape[1]
    gust_le = arctangent(w + gust[3], u + gust[2]) - alpha_inertial
    from_trim = alpha_inertial - c.trim_alpha
    if c.memory > 0.0:
        wing = from_trim + gust_le
        chords = speed / c.memory_chord
        for i in range(nm):
            wing += lift_motion[0, i] * (x[LAGS + i] - from_trim)
            dx[LAGS + i] = lift_motion[1, i] * chords * (from_trim - x[LAGS + i])
        for i in range(ng):
            wing += lift_gust[0, i] * (x[LAGS + nm + i] - gust_le)
            dx[LAGS + nm + i] = lift_gust[1, i] * chords * (gust_le - x[LAGS + nm + i])
        gust_tail = arctangent(w + gust[5], u + gust[4]) - alpha_inertial
        tail = from_trim + q * c.tail_arm / speed + gust_tail - c.downwash * past_wing
        share, arm = c.tail_slope, c.tail_arm / c.chord
        cl = (c.cl_alpha - share * (1.0 - c.downwash)) * wing + share * tail
        cl += (c.cl_q - 2.0 * share * arm * (1.0 + c.downwash)) * qhat
        cm = (c.cm_alpha + share * arm * (1.0 - c.downwash)) * wing - share * arm * tail
        cm += (c.cm_q + 2.0 * share * arm * arm * (1.0 + c.downwash)) * qhat
    else:
        wing = alpha - c.trim_alpha
        for i in range(LAGS, x.shape[0]):
            dx[i] = 0.0
        cl = c.cl_alpha * wing + c.cl_q * qhat
        cm = c.cm_alpha * wing + c.cm_q * qhat
    from_gust = alpha - alpha_inertial
    square, cube = alpha**2 - c.trim_alpha**2, alpha**3 - c.trim_alpha**3
    cl += c.cl_trim + c.cl_v * faster + c.cl_de * de + c.cl_gust * from_gust
    cl += c.cl_alpha2 * square + c.cl_alpha3 * cube
    cm += c.cm_trim + c.cm_v * faster + c.cm_de * de + c.cm_gust * from_gust
    cm += c.cm_alpha2 * square + c.cm_alpha3 * cube
    cd = c.cd_0 + c.cd_v * speed / c.reference_speed + c.cd_alpha * alpha + c.cd_induced * cl * cl

    cos_a, sin_a = ua / speed, wa / speed
    force = pressure * c.area
    fx = (force * (cl * sin_a - cd * cos_a) + x[THRUST] * c.thrust_cos) / c.mass
    fz = (force * (-cd * sin_a - cl * cos_a) - x[THRUST] * c.thrust_sin) / c.mass
    sin_t, cos_t = sine_cosine(theta)
    dx[U] = fx - q * w - G0 * sin_t
    dx[W] = fz + q * u + G0 * cos_t
    dx[Q] = (force * c.chord * cm + x[THRUST] * c.thrust_arm) / c.iyy
    dx[THETA] = q
    dx[DISTANCE] = u * cos_t + w * sin_t
    dx[HEIGHT] = u * sin_t - w * cos_t
    wanted = min(max(command, -c.actuator_limit), c.actuator_limit)
    dx[ELEVATOR] = min(max((wanted - x[ELEVATOR]) / c.actuator_lag, -c.actuator_rate), c.actuator_rate)
    hold = c.hold_speed * (c.trim_speed - speed) + c.hold_height * (c.trim_height - x[HEIGHT])
    thrust = min(max(c.trim_thrust + c.mass * hold, 0.0), 3.0 * c.trim_thrust)
    dx[THRUST] = (thrust - x[THRUST]) / c.hold_lag

    aux[AIRSPEED], aux[PRESSURE] = speed, pressure
    aux[CL], aux[CD], aux[CM] = cl, cd, cm
    aux[FORCE_X], aux[FORCE_Z] = fx, fz
    aux[WING], aux[ALPHA], aux[ALPHA_INERTIAL], aux[GUST_LE] = wing, alpha, alpha_inertial, gust_le
    aux[SURFACE] = moved
