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
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import G0
from station.model.physical_signals import WIND_S
from station.numerics.angles import wrap

Array = NDArray[np.float64]

RING: Final = 256
"""Past states kept, ticks: 5 s."""
COAST_S: Final = 2.0
"""A velocity stream silent for longer is replaced by the air data."""
READY_S: Final = 2.0
"""After a start the velocity and attitude have settled to the noise of their streams."""

# State, one float64 each: where a group of three (NED or roll, pitch, yaw) begins.
_COUNT, _VEL, _ATT, _VEL_FIX, _ATT_FIX, _BIAS, _VEL_AT, _ATT_AT = 0, 1, 4, 7, 10, 13, 16, 19
_ACC, _ATT_RATE, _WIND, _WIND_COUNT, _RATE, _MEASURED, _HELD = 22, 25, 28, 31, 32, 35, 38
HOLD: Final = 41
"""Where the state says, not 0, that the mean wind which motion is relative to does not follow the average."""
_ACC_BEFORE, _ATT_RATE_BEFORE, STATE = 42, 45, 48
OUT: Final = 9
"""alpha_i, beta_i, inertial speed relative to the mean horizontal wind, wind NED (3), phi, theta, ready (1 or 0)."""


@njit(cache=True)
def _rotate(att: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Body vector into NED for roll, pitch, yaw."""
    cph, sph = math.cos(att[0]), math.sin(att[0])
    cth, sth = math.cos(att[1]), math.sin(att[1])
    cps, sps = math.cos(att[2]), math.sin(att[2])
    north = cth * cps * x + (sph * sth * cps - cph * sps) * y + (cph * sth * cps + sph * sps) * z
    east = cth * sps * x + (sph * sth * sps + cph * cps) * y + (cph * sth * sps - sph * cps) * z
    down = -sth * x + sph * cth * y + cph * cth * z
    return north, east, down


@njit(cache=True)
def _unrotate(att: Array, n: float, e: float, d: float) -> tuple[float, float, float]:
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
    bend = now - 2.0 * before + before_that if ticks > 1 else 0.0
    return 0.5 * (before + now) - bend / 12.0


@njit(cache=True)
def _then(ring: Array, count: int, t: float, column: int, now: float) -> float:
    """An integral's value at time `t`, linear between ticks; NaN from before the ring, `now` after its end."""
    newest = (count - 1) % ring.shape[0]
    if t >= ring[newest, 0]:
        return now
    for back in range(1, min(count, ring.shape[0])):
        i = (count - 1 - back) % ring.shape[0]
        if ring[i, 0] <= t:
            j = (i + 1) % ring.shape[0]
            share = (t - ring[i, 0]) / (ring[j, 0] - ring[i, 0])
            return float(ring[i, column] + share * (ring[j, column] - ring[i, column]))
    return math.nan


@njit(cache=True)
def step(
    s: Array,
    ring: Array,
    t: float,
    dt: float,
    motion: Array,
    attitude: Array,
    attitude_age: Array,
    velocity: Array,
    velocity_age: Array,
    air: Array,
    arm: Array,
    out: Array,
) -> None:
    """One tick.

    `motion`: p q r ax ay az at the IMU, (6,), all finite. `attitude`: phi theta psi (3,), `velocity`: NED (3,), NaN
    where missing, with their ages in s. `air`: true airspeed, angle of attack and sideslip at the CG from the vanes.
    `arm`: IMU from the CG (3,). Edits `s` (STATE,), `ring` (RING, 7) and `out` (OUT,).
    """
    p, q, r = motion[0], motion[1], motion[2]
    count = int(s[_COUNT])
    speed, alpha, beta = air[0], air[1], air[2]
    ux = speed * math.cos(alpha) * math.cos(beta)
    uy = speed * math.sin(beta)
    uz = speed * math.sin(alpha) * math.cos(beta)
    track = math.nan
    if math.isfinite(velocity[0]) and math.isfinite(velocity[1]):
        track = math.atan2(velocity[1], velocity[0])
    att = np.empty(3)

    if count == 0:
        if not math.isfinite(attitude[1]):
            out[:] = math.nan
            out[8] = 0.0
            return
        for i in range(3):
            s[_ATT_FIX + i] = 0.0
            s[_VEL_FIX + i] = 0.0
            s[_MEASURED + i] = -math.inf
            s[_ATT + i] = attitude[i] if math.isfinite(attitude[i]) else 0.0
            s[_ATT_AT + i] = t
            s[_VEL_AT + i] = t
            s[_RATE + i] = motion[i]
        if not math.isfinite(attitude[2]) and math.isfinite(track):
            s[_ATT + 2] = track
        for i in range(3):
            att[i] = s[_ATT + i]
        vn, ve, vd = _rotate(att, ux, uy, uz)
        s[_VEL] = velocity[0] if math.isfinite(velocity[0]) else vn
        s[_VEL + 1] = velocity[1] if math.isfinite(velocity[1]) else ve
        s[_VEL + 2] = velocity[2] if math.isfinite(velocity[2]) else vd
    for i in range(3):
        att[i] = s[_ATT + i] + s[_ATT_FIX + i]

    # Attitude: Euler angle rates.
    secant = 1.0 / max(math.cos(att[1]), 0.1)
    turn = q * math.sin(att[0]) + r * math.cos(att[0])
    rates = (p + math.sin(att[1]) * secant * turn, q * math.cos(att[0]) - r * math.sin(att[0]), turn * secant)
    if count == 0:
        for i in range(3):
            s[_ATT_RATE + i] = rates[i]
    for i in range(3):
        if count > 0:
            s[_ATT + i] += dt * _mean(rates[i], s[_ATT_RATE + i], s[_ATT_RATE_BEFORE + i], count)
        s[_ATT_RATE_BEFORE + i], s[_ATT_RATE + i] = s[_ATT_RATE + i], rates[i]
        att[i] = s[_ATT + i] + s[_ATT_FIX + i]

    # Specific force at the CG: a_cg = a - wdot x r - w x (w x r).
    pdot, qdot, rdot = (p - s[_RATE]) / dt, (q - s[_RATE + 1]) / dt, (r - s[_RATE + 2]) / dt
    s[_RATE], s[_RATE + 1], s[_RATE + 2] = p, q, r
    x, y, z = arm[0], arm[1], arm[2]
    wr = p * x + q * y + r * z
    ww = p * p + q * q + r * r
    fx = motion[3] - (qdot * z - rdot * y) - (p * wr - ww * x)
    fy = motion[4] - (rdot * x - pdot * z) - (q * wr - ww * y)
    fz = motion[5] - (pdot * y - qdot * x) - (r * wr - ww * z)
    an, ae, ad = _rotate(att, fx, fy, fz)
    acc = (an, ae, ad + G0)
    for i in range(3):
        if count > 0:
            s[_VEL + i] += dt * (_mean(acc[i], s[_ACC + i], s[_ACC_BEFORE + i], count) - s[_BIAS + i])
        s[_ACC_BEFORE + i], s[_ACC + i] = s[_ACC + i], acc[i]

    row = count % ring.shape[0]
    ring[row, 0] = t
    for i in range(3):
        ring[row, 1 + i] = s[_VEL + i]
        ring[row, 4 + i] = s[_ATT + i]
    count += 1
    s[_COUNT] = count

    # Draw the attitude to its stream, 0.5 s, as of the time the measurement was true.
    for i in range(3):
        measured, at = attitude[i], t - attitude_age[i]
        if i == 2 and not math.isfinite(measured):
            measured, at = track, t - velocity_age[0]
        if math.isfinite(measured) and at > s[_ATT_AT + i] + 1e-3:
            then = _then(ring, count, at, 4 + i, s[_ATT + i])
            if math.isfinite(then):
                gain = 1.0 - math.exp(-min(at - s[_ATT_AT + i], 1.0) / 0.5)
                s[_ATT_FIX + i] += gain * wrap(measured - then - s[_ATT_FIX + i])
            s[_ATT_AT + i] = at
        att[i] = s[_ATT + i] + s[_ATT_FIX + i]

    # Draw the velocity to its stream below 0.05 Hz, with an accelerometer bias; where there is no stream, to the air
    # velocity below 0.02 Hz (still air is assumed, and the wind then reads 0).
    vn, ve, vd = _rotate(att, ux, uy, uz)
    through_air = (vn, ve, vd)
    for i in range(3):
        measured, at, corner = velocity[i], t - velocity_age[i], 2.0 * math.pi * 0.05
        if math.isfinite(measured):
            s[_MEASURED + i] = t
        elif t - s[_MEASURED + i] < COAST_S:
            continue
        else:
            measured, at, corner = through_air[i] + s[_WIND + i], t, 2.0 * math.pi * 0.02
        if math.isfinite(measured) and at > s[_VEL_AT + i] + 1e-3:
            then = _then(ring, count, at, 1 + i, s[_VEL + i])
            if math.isfinite(then):
                span = min(at - s[_VEL_AT + i], 2.0)
                error = measured - then - s[_VEL_FIX + i]
                s[_VEL_FIX + i] += (1.0 - math.exp(-1.4 * corner * span)) * error
                s[_BIAS + i] -= corner * corner * span * error
            s[_VEL_AT + i] = at

    # Mean wind: ground velocity less air velocity, averaged from the start, then over a minute.
    if math.isfinite(through_air[2]):
        s[_WIND_COUNT] += 1.0
        gain = max(dt / WIND_S, 1.0 / s[_WIND_COUNT])
        for i in range(3):
            if t - s[_MEASURED + i] >= COAST_S:
                continue
            s[_WIND + i] += gain * (s[_VEL + i] + s[_VEL_FIX + i] - through_air[i] - s[_WIND + i])

    # The mean vertical wind stays in: it is nil but for the gusts, and a changing share of them taken out here would be
    # called motion and not carried from boom to tail.
    if s[HOLD] == 0.0:
        s[_HELD], s[_HELD + 1] = s[_WIND], s[_WIND + 1]
    u, v, w = _unrotate(
        att,
        s[_VEL] + s[_VEL_FIX] - s[_HELD],
        s[_VEL + 1] + s[_VEL_FIX + 1] - s[_HELD + 1],
        s[_VEL + 2] + s[_VEL_FIX + 2],
    )
    total = math.sqrt(u * u + v * v + w * w)
    out[0] = math.atan2(w, u)
    out[1] = math.asin(v / total) if total > 1e-6 else 0.0
    out[2] = total
    out[3], out[4], out[5] = s[_WIND], s[_WIND + 1], s[_WIND + 2]
    out[6], out[7] = att[0], att[1]
    out[8] = 1.0 if count * dt >= READY_S else 0.0


@njit(cache=True)
def restart(s: Array, out: Array) -> None:
    """Begin anew from the next measurements; the mean wind is kept."""
    s[_COUNT] = 0.0
    out[:] = math.nan
    out[8] = 0.0


class Inertial:
    """The state of `step`, and what it last gave (`out`, see OUT)."""

    def __init__(self, arm: tuple[float, float, float], dt: float) -> None:
        self._arm = np.array(arm, dtype=np.float64)
        self._dt = dt
        self._state = np.zeros(STATE)
        self._ring = np.zeros((RING, 7))
        self.out = np.full(OUT, math.nan)
        self.out[8] = 0.0
        self.arrays = (self._state, self._ring, self._arm, self.out)
        """As tick.advance takes them."""

    def restart(self) -> None:
        """Begin anew from the next measurements; the mean wind is kept."""
        restart(self._state, self.out)

    def hold(self, is_held: bool) -> None:
        """Whether motion stays relative to the mean wind as it is now, while that is averaged on."""
        self._state[HOLD] = float(is_held)

    def step(self, t: float, motion: Array, streams: tuple[Any, Any, Any, Any], air: Array) -> None:
        """One tick at `t` s. `streams`: attitude and its ages, velocity and its ages, (3,) each."""
        attitude, attitude_age, velocity, velocity_age = streams
        step(
            self._state,
            self._ring,
            t,
            self._dt,
            motion,
            attitude,
            attitude_age,
            velocity,
            velocity_age,
            air,
            self._arm,
            self.out,
        )
