"""Inertial flow angles at the CG and the mean wind, from attitude, body rates, specific force and a velocity stream.

The velocity of the CG is integrated from the IMU at every tick and drawn to the velocity stream below 0.05 Hz
(a held 1 Hz velocity alone is worse than none). A measurement is known by its own time, the frame's
less its age, and is compared with what was believed at that time, so a slow or late stream delays nothing. Roll, pitch
and yaw are integrated from the rates in the same way. SI, radians; body axes x forward, z down; earth NED.

Sources: Klein and Morelli 2006, equations 3.29-3.32 (kinematics) and 10.6 (lever arm of an accelerometer); Lenschow
1986, Probing the Atmospheric Boundary Layer (wind as ground velocity less air velocity, lever arms included).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import G0
from station.model.coefficients import specific_force_at_cg
from station.model.physical_signals import WIND_S
from station.numerics.angles import wrap
from station.numerics.named_state import Vector

Array = NDArray[np.float64]
Triple = tuple[float, float, float]

PSI: Final = 2
"""Place of the heading in an attitude."""
RING: Final = 256
"""Past states kept, ticks: 5 s."""
COAST_S: Final = 2.0
"""A velocity stream silent for longer is replaced by the air data."""
READY_S: Final = 2.0
"""After a start the velocity and attitude have settled to the noise of their streams."""
ATTITUDE_S: Final = 0.5
"""Time constant with which the attitude is drawn to its stream."""
VELOCITY_HZ: Final = 0.05
AIR_HZ: Final = 0.02
"""Below these the velocity is drawn to its stream and, without one, to the air velocity."""
DAMPING: Final = 1.4
"""Twice the damping ratio with which velocity and accelerometer bias are drawn together."""
NEW_S: Final = 1e-3
"""A measurement that is not newer than the last one by this is the same."""
LONGEST_STEP_S: Final = 1.0
LONGEST_SPAN_S: Final = 2.0
"""Of an attitude's and a velocity's stream: a longer wait for a measurement gives it no more weight."""
STEEPEST: Final = 0.1
"""Cosine of pitch, at least: Euler angle rates have no meaning at the vertical."""
LEAST_SPEED: Final = 1e-6


class Motion(NamedTuple):
    """Body rates, rad/s, and specific force at the IMU, m/s2; all finite."""

    p: float
    q: float
    r: float
    ax: float
    ay: float
    az: float


class Air(NamedTuple):
    """True airspeed, m/s, angle of attack and sideslip at the CG, rad, as the vanes have them."""

    speed: float
    alpha: float
    beta: float


class Streams(NamedTuple):
    """Measured phi theta psi (3,), rad, and velocity NED (3,), m/s, with their ages, s; NaN where missing."""

    attitude: Array
    attitude_age: Array
    velocity: Array
    velocity_age: Array


class Constants(NamedTuple):
    """What `step` goes by."""

    dt: float
    imu: Vector
    """From the CG, m."""


@dataclass(slots=True)
class Flow:
    """What `step` gives."""

    alpha: float
    beta: float
    """Inertial flow angles at the CG, rad."""
    speed: float
    """Relative to the mean horizontal wind, m/s."""
    wind_north: float
    wind_east: float
    wind_down: float
    """Mean wind, m/s."""
    phi: float
    theta: float
    is_ready: bool


class State:
    """What `step` edits. Vectors are NED, or phi theta psi."""

    count: int
    """Ticks since the start."""
    velocity: Vector
    attitude: Vector
    """Integrals of acceleration and Euler angle rates, m/s and rad."""
    velocity_fix: Vector
    attitude_fix: Vector
    """What the streams add to them."""
    attitude_now: Vector
    """Their sum, rad."""
    bias: Vector
    """Of the acceleration, m/s2."""
    velocity_at: Vector
    attitude_at: Vector
    """Time of each component's newest measurement, s."""
    measured_at: Vector
    """Time at which each component of the velocity was last there, s."""
    acceleration: Vector
    acceleration_before: Vector
    attitude_rate: Vector
    attitude_rate_before: Vector
    """Of the last two ticks, m/s2 and rad/s."""
    body_rate: Vector
    """p q r of the last tick, rad/s."""
    wind: Vector
    """Mean, m/s."""
    wind_count: int
    is_held: bool
    """Motion stays relative to the mean wind as it is now, while that is averaged on."""
    held_wind: Vector
    """Which motion is relative to, m/s."""
    past_t: Annotated[Array, RING]
    past_velocity: Annotated[Array, (RING, 3)]
    past_attitude: Annotated[Array, (RING, 3)]
    """The integrals at past ticks."""
    flow: Flow


@njit(cache=True)
def _rotate(att: Array, x: float, y: float, z: float) -> Triple:
    """Body vector into NED for roll, pitch, yaw."""
    cph, sph = math.cos(att[0]), math.sin(att[0])
    cth, sth = math.cos(att[1]), math.sin(att[1])
    cps, sps = math.cos(att[2]), math.sin(att[2])
    north = cth * cps * x + (sph * sth * cps - cph * sps) * y + (cph * sth * cps + sph * sps) * z
    east = cth * sps * x + (sph * sth * sps + cph * cps) * y + (cph * sth * sps - sph * cps) * z
    down = -sth * x + sph * cth * y + cph * cth * z
    return north, east, down


@njit(cache=True)
def _unrotate(att: Array, n: float, e: float, d: float) -> Triple:
    """NED vector into body axes."""
    cph, sph = math.cos(att[0]), math.sin(att[0])
    cth, sth = math.cos(att[1]), math.sin(att[1])
    cps, sps = math.cos(att[2]), math.sin(att[2])
    x = cth * cps * n + cth * sps * e - sth * d
    y = (sph * sth * cps - cph * sps) * n + (sph * sth * sps + cph * cps) * e + sph * cth * d
    z = (cph * sth * cps + sph * sps) * n + (cph * sth * sps - sph * cps) * e + cph * cth * d
    return x, y, z


@njit(cache=True)
def _mean(now: float, before: float, before_that: float, ticks: int) -> float:
    """Of the last tick, on the parabola through three samples, `ticks` of them before this one (Adams and Moulton).

    A straight line is too low at a peak, by (omega dt)^2/12: 0.5 % at 2 Hz.
    """
    curvature = now - 2.0 * before + before_that if ticks > 1 else 0.0
    return 0.5 * (before + now) - curvature / 12.0


@njit(cache=True)
def _then(s: State, past: Array, i: int, t: float, now: float) -> float:
    """Component `i` of an integral at time `t`, linear between ticks; NaN from before the ring, `now` after its end."""
    newest = (s.count - 1) % RING
    if t >= s.past_t[newest]:
        return now
    for back in range(1, min(s.count, RING)):
        a = (s.count - 1 - back) % RING
        if s.past_t[a] <= t:
            b = (a + 1) % RING
            share = (t - s.past_t[a]) / (s.past_t[b] - s.past_t[a])
            return float(past[a, i] + share * (past[b, i] - past[a, i]))
    return math.nan


@njit(cache=True)
def _begin(s: State, t: float, motion: Motion, through_air: Triple, streams: Streams, track: float) -> None:
    """Start at the measurements; what is missing of the velocity is `through_air`, body axes, in still air."""
    attitude, velocity = streams.attitude, streams.velocity
    for i in range(3):
        s.attitude_fix[i] = 0.0
        s.velocity_fix[i] = 0.0
        s.measured_at[i] = -math.inf
        s.attitude[i] = attitude[i] if math.isfinite(attitude[i]) else 0.0
        s.attitude_at[i] = t
        s.velocity_at[i] = t
    s.body_rate[0], s.body_rate[1], s.body_rate[2] = motion.p, motion.q, motion.r
    if not math.isfinite(attitude[PSI]) and math.isfinite(track):
        s.attitude[PSI] = track
    x, y, z = through_air
    still = _rotate(s.attitude, x, y, z)
    for i in range(3):
        s.velocity[i] = velocity[i] if math.isfinite(velocity[i]) else still[i]


@njit(cache=True)
def _turn(c: Constants, s: State, motion: Motion) -> None:
    """Integrate the Euler angle rates over the last tick."""
    for i in range(3):
        s.attitude_now[i] = s.attitude[i] + s.attitude_fix[i]
    att = s.attitude_now
    secant = 1.0 / max(math.cos(att[1]), STEEPEST)
    turn = motion.q * math.sin(att[0]) + motion.r * math.cos(att[0])
    rates = (
        motion.p + math.sin(att[1]) * secant * turn,
        motion.q * math.cos(att[0]) - motion.r * math.sin(att[0]),
        turn * secant,
    )
    for i in range(3):
        if s.count == 0:
            s.attitude_rate[i] = rates[i]
        else:
            s.attitude[i] += c.dt * _mean(rates[i], s.attitude_rate[i], s.attitude_rate_before[i], s.count)
        s.attitude_rate_before[i], s.attitude_rate[i] = s.attitude_rate[i], rates[i]
        att[i] = s.attitude[i] + s.attitude_fix[i]


@njit(cache=True)
def _accelerate(c: Constants, s: State, m: Motion) -> None:
    """Integrate over the last tick the acceleration of the CG."""
    p, q, r = m.p, m.q, m.r
    pdot, qdot, rdot = (p - s.body_rate[0]) / c.dt, (q - s.body_rate[1]) / c.dt, (r - s.body_rate[2]) / c.dt
    s.body_rate[0], s.body_rate[1], s.body_rate[2] = p, q, r
    arm = c.imu[0], c.imu[1], c.imu[2]
    fx, fy, fz = specific_force_at_cg((m.ax, m.ay, m.az), (p, q, r), (pdot, qdot, rdot), arm)
    an, ae, ad = _rotate(s.attitude_now, fx, fy, fz)
    acc = (an, ae, ad + G0)
    for i in range(3):
        if s.count > 0:
            mean = _mean(acc[i], s.acceleration[i], s.acceleration_before[i], s.count)
            s.velocity[i] += c.dt * (mean - s.bias[i])
        s.acceleration_before[i], s.acceleration[i] = s.acceleration[i], acc[i]


@njit(cache=True)
def _draw_attitude(s: State, t: float, streams: Streams, track: float) -> None:
    """Draw the attitude to its stream, as of the time the measurement was true; heading to the track without one."""
    for i in range(3):
        measured, at = streams.attitude[i], t - streams.attitude_age[i]
        if i == PSI and not math.isfinite(measured):
            measured, at = track, t - streams.velocity_age[0]
        if math.isfinite(measured) and at > s.attitude_at[i] + NEW_S:
            then = _then(s, s.past_attitude, i, at, s.attitude[i])
            if math.isfinite(then):
                gain = 1.0 - math.exp(-min(at - s.attitude_at[i], LONGEST_STEP_S) / ATTITUDE_S)
                s.attitude_fix[i] += gain * wrap(measured - then - s.attitude_fix[i])
            s.attitude_at[i] = at
        s.attitude_now[i] = s.attitude[i] + s.attitude_fix[i]


@njit(cache=True)
def _draw_velocity(s: State, t: float, streams: Streams, through_air: Triple) -> None:
    """Draw the velocity to its stream below VELOCITY_HZ, with an accelerometer bias; where there is no stream, to the
    air velocity (NED) below AIR_HZ: still air is assumed, and the wind then reads 0."""
    for i in range(3):
        measured, at, corner = streams.velocity[i], t - streams.velocity_age[i], 2.0 * math.pi * VELOCITY_HZ
        if math.isfinite(measured):
            s.measured_at[i] = t
        elif t - s.measured_at[i] < COAST_S:
            continue
        else:
            measured, at, corner = through_air[i] + s.wind[i], t, 2.0 * math.pi * AIR_HZ
        if math.isfinite(measured) and at > s.velocity_at[i] + NEW_S:
            then = _then(s, s.past_velocity, i, at, s.velocity[i])
            if math.isfinite(then):
                span = min(at - s.velocity_at[i], LONGEST_SPAN_S)
                error = measured - then - s.velocity_fix[i]
                s.velocity_fix[i] += (1.0 - math.exp(-DAMPING * corner * span)) * error
                s.bias[i] -= corner * corner * span * error
            s.velocity_at[i] = at


@njit(cache=True)
def _average_wind(c: Constants, s: State, t: float, through_air: Triple) -> None:
    """Mean wind: ground velocity less air velocity (NED), averaged from the start, then over a minute.

    The mean vertical wind stays in the motion: it is nil but for the gusts, and a changing share of them taken out here
    would be called motion and not carried from boom to tail.
    """
    if math.isfinite(through_air[2]):
        s.wind_count += 1
        gain = max(c.dt / WIND_S, 1.0 / s.wind_count)
        for i in range(3):
            if t - s.measured_at[i] >= COAST_S:
                continue
            s.wind[i] += gain * (s.velocity[i] + s.velocity_fix[i] - through_air[i] - s.wind[i])
    if not s.is_held:
        s.held_wind[0], s.held_wind[1] = s.wind[0], s.wind[1]


@njit(cache=True)
def step(c: Constants, s: State, t: float, motion: Motion, air: Air, streams: Streams) -> None:
    """One tick at `t`, s; edits `s` and gives `s.flow`."""
    ux = air.speed * math.cos(air.alpha) * math.cos(air.beta)
    uy = air.speed * math.sin(air.beta)
    uz = air.speed * math.sin(air.alpha) * math.cos(air.beta)
    track = math.nan
    if math.isfinite(streams.velocity[0]) and math.isfinite(streams.velocity[1]):
        track = math.atan2(streams.velocity[1], streams.velocity[0])
    if s.count == 0:
        if not math.isfinite(streams.attitude[1]):
            restart(s)
            return
        _begin(s, t, motion, (ux, uy, uz), streams, track)
    _turn(c, s, motion)
    _accelerate(c, s, motion)
    row = s.count % RING
    s.past_t[row] = t
    for i in range(3):
        s.past_velocity[row, i] = s.velocity[i]
        s.past_attitude[row, i] = s.attitude[i]
    s.count += 1
    _draw_attitude(s, t, streams, track)
    through_air = _rotate(s.attitude_now, ux, uy, uz)
    _draw_velocity(s, t, streams, through_air)
    _average_wind(c, s, t, through_air)
    u, v, w = _unrotate(
        s.attitude_now,
        s.velocity[0] + s.velocity_fix[0] - s.held_wind[0],
        s.velocity[1] + s.velocity_fix[1] - s.held_wind[1],
        s.velocity[2] + s.velocity_fix[2],
    )
    total = math.sqrt(u * u + v * v + w * w)
    flow = s.flow
    flow.alpha = math.atan2(w, u)
    flow.beta = math.asin(v / total) if total > LEAST_SPEED else 0.0
    flow.speed = total
    flow.wind_north, flow.wind_east, flow.wind_down = s.wind[0], s.wind[1], s.wind[2]
    flow.phi, flow.theta = s.attitude_now[0], s.attitude_now[1]
    flow.is_ready = s.count * c.dt >= READY_S


@njit(cache=True)
def restart(s: State) -> None:
    """Begin anew from the next measurements; the mean wind is kept."""
    s.count = 0
    flow = s.flow
    flow.alpha = flow.beta = flow.speed = flow.phi = flow.theta = math.nan
    flow.wind_north = flow.wind_east = flow.wind_down = math.nan
    flow.is_ready = False
