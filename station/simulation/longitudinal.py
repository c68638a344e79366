"""The longitudinal equations of motion: nonlinear, three degrees of freedom, quasi-steady or with unsteady lift.

Axes as in conventions. u, w and q are inertial (relative to the air mass that the mean wind carries along); a gust
(u_g, w_g) adds to them to give the velocity relative to the air, so w_g > 0 is an updraught and u_g > 0 a headwind.

Sources: Klein and Morelli 2006 (equations of motion); thin-wing and tail model: wing incidence with a Wagner-like
response to the motion and a Kuessner-like response to the gust met at the leading edge, a tail that meets gust and
downwash one tail arm later. In the steady limit both models return the profile's derivatives exactly.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import G0
from station.numerics.atmosphere import (
    LAPSE,
    PRESSURE_POWER,
    SCALE_HEIGHT,
    SEA_LEVEL_TEMPERATURE,
    TROPOPAUSE,
    atmosphere,
)
from station.simulation.airframe import Constants, Tables
from station.simulation.stalling import lift_left
from station.simulation.trigonometry import arctangent, sine_cosine

U, W, Q, THETA, DISTANCE, HEIGHT, ELEVATOR, THRUST, LAGS = range(9)
"""State: u, w (m/s), q (rad/s), theta (rad), distance flown through the air mass (m), height (m), the elevator's drive
(rad), which its surface follows with the backlash there is, thrust (N); from LAGS on the lagged incidences of the
unsteady lift, first of the motion, then of the gust (rad)."""

_MOST_THRUST: Final = 3.0
"""That the engines give, in trim thrusts."""


class Air(NamedTuple):
    """The density about a height: enough for the few centimetres of one step."""

    height: float
    """m."""
    density: float
    """kg/m3."""
    slope: float
    """kg/m4."""


class Gust(NamedTuple):
    """The gust where the aircraft meets it, m/s: headwind and updraught positive."""

    u: float
    """At the CG, as w."""
    w: float
    u_edge: float
    """At the leading edge."""
    w_edge: float
    u_tail: float
    w_tail: float


class Met(NamedTuple):
    """What acts on the aircraft at an instant, apart from its own motion."""

    air: Air
    gust: Gust
    side: float
    """Sideways velocity relative to the air, m/s."""
    past_wing: float
    """Wing incidence, from trim, whose downwash reaches the tail now, rad."""
    surface: float
    """Where the elevator was a step ago, rad."""
    command: float
    """Where it is commanded, rad."""
    attached: float
    """Share of the wing's chord along which the flow is attached."""


class Flow(NamedTuple):
    """Quantities on the way from the state to its derivative."""

    airspeed: float
    pressure: float
    """Dynamic, Pa."""
    cl: float
    cd: float
    cm: float
    force_x: float
    """Specific force at the CG along x, m/s2; force_z along z."""
    force_z: float
    wing: float
    """Effective wing incidence from trim, rad."""
    alpha: float
    alpha_inertial: float
    gust_edge: float
    """Incidence that the gust makes at the leading edge, rad."""
    surface: float
    """The elevator's, rad."""


def trimmed_state(c: Constants, lags: int) -> NDArray[np.float64]:
    """The state in trim, with that many lagged incidences at rest."""
    x = np.zeros(LAGS + lags)
    x[U] = c.trim_speed * math.cos(c.trim_alpha)
    x[W] = c.trim_speed * math.sin(c.trim_alpha)
    x[THETA] = c.trim_alpha
    x[HEIGHT] = c.trim_height
    x[ELEVATOR] = c.trim_elevator
    x[THRUST] = c.trim_thrust
    return x


@njit(cache=True, error_model="numpy")
def air_at(c: Constants, height: float) -> Air:
    """The air about a height (m)."""
    if c.fixed_density > 0.0:
        return Air(height, c.fixed_density, 0.0)
    density = atmosphere(height)[2]
    if height > TROPOPAUSE:
        return Air(height, density, -density / SCALE_HEIGHT)
    temperature = SEA_LEVEL_TEMPERATURE - LAPSE * height
    return Air(height, density, -(PRESSURE_POWER - 1.0) * LAPSE / temperature * density)


@njit(cache=True, error_model="numpy", inline="always")
def _incidences(
    c: Constants, tables: Tables, x: NDArray[np.float64], met: Met, speed: float, alpha_inertial: float,
    gust_edge: float, dx: NDArray[np.float64],
) -> tuple[float, float]:  # fmt: skip
    """Effective incidence of wing and tail from trim, rad, with unsteady lift; its lags' derivatives into `dx`."""
    motions, gusts = tables.lift_motion.shape[1], tables.lift_gust.shape[1]
    from_trim = alpha_inertial - c.trim_alpha
    wing = from_trim + gust_edge
    chords = speed / c.indicial_chord
    for i in range(motions):
        wing += tables.lift_motion[0, i] * (x[LAGS + i] - from_trim)
        dx[LAGS + i] = tables.lift_motion[1, i] * chords * (from_trim - x[LAGS + i])
    for i in range(gusts):
        j = LAGS + motions + i
        wing += tables.lift_gust[0, i] * (x[j] - gust_edge)
        dx[j] = tables.lift_gust[1, i] * chords * (gust_edge - x[j])
    gust_tail = arctangent(x[W] + met.gust.w_tail, x[U] + met.gust.u_tail) - alpha_inertial
    return wing, from_trim + x[Q] * c.tail_arm / speed + gust_tail - c.downwash * met.past_wing


@njit(cache=True, error_model="numpy", inline="always")
def rates(c: Constants, tables: Tables, x: NDArray[np.float64], met: Met, dx: NDArray[np.float64]) -> Flow:
    """Time derivative of the state `x` into `dx`; returns the quantities on the way."""
    u, w, q, theta = x[U], x[W], x[Q], x[THETA]
    ua, wa = u + met.gust.u, w + met.gust.w
    speed = math.sqrt(ua * ua + met.side * met.side + wa * wa)
    alpha_inertial = arctangent(w, u)
    alpha = arctangent(wa, ua)
    pressure = 0.5 * (met.air.density + met.air.slope * (x[HEIGHT] - met.air.height)) * speed * speed
    qhat = 0.5 * q * c.chord / (c.reference_speed if c.fixed_rate_reference > 0.0 else speed)
    moved = min(max(met.surface, x[ELEVATOR] - c.elevator_backlash), x[ELEVATOR] + c.elevator_backlash)
    de = moved - c.trim_elevator
    faster = (speed - c.trim_speed) / c.reference_speed

    gust_edge = arctangent(w + met.gust.w_edge, u + met.gust.u_edge) - alpha_inertial
    if c.unsteady > 0.0:
        wing, tail = _incidences(c, tables, x, met, speed, alpha_inertial, gust_edge, dx)
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
    if c.separates > 0.0:
        cl += c.cl_lost_trim - c.cl_separating * (1.0 - lift_left(met.attached)) * (wing + c.trim_alpha - c.no_lift)
        cm += c.cm_separated * (1.0 - met.attached)
    cl += c.cl_trim + c.cl_v * faster + c.cl_de * de + c.cl_gust * from_gust
    cl += c.cl_alpha2 * square + c.cl_alpha3 * cube
    cm += c.cm_trim + c.cm_v * faster + c.cm_de * de + c.cm_gust * from_gust
    cm += c.cm_alpha2 * square + c.cm_alpha3 * cube
    cd = c.cd_0 + c.cd_v * speed / c.reference_speed + c.cd_alpha * alpha + c.cd_induced * cl * cl
    if c.separates > 0.0:
        cd += c.cd_separated * (1.0 - met.attached)

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
    wanted = min(max(met.command, -c.actuator_limit), c.actuator_limit)
    dx[ELEVATOR] = min(max((wanted - x[ELEVATOR]) / c.actuator_lag, -c.actuator_rate), c.actuator_rate)
    hold = c.hold_speed * (c.wanted_speed - speed) + c.hold_height * (c.trim_height - x[HEIGHT])
    thrust = min(max(c.trim_thrust + c.mass * hold, 0.0), _MOST_THRUST * c.trim_thrust)
    dx[THRUST] = (thrust - x[THRUST]) / c.hold_lag
    return Flow(speed, pressure, cl, cd, cm, fx, fz, wing, alpha, alpha_inertial, gust_edge, moved)
