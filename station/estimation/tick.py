"""One tick of all live filters, compiled as one: conditioned inputs to inertial flow angles, the split of the vane, the
signals of wing and tail, and a sample of equation error. Estimator and campaign take the same ticks. SI, radians.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.estimation import alpha as cg
from station.estimation import conditioning as cond
from station.estimation import equation_error as ee
from station.estimation import inertial as flow
from station.model import physical_signals as gusts
from station.numerics.named_state import Element, packed
from station.profile import Aircraft

UNEXPLAINED_S: Final = 5.0
"""Over which it is averaged what the motion leaves of the vane."""
MADE, SPLIT = 1, 2
"""What `advance` returns, added: a sample of equation error was made; there is a split angle of attack."""

Array = NDArray[np.float64]


class Constants(NamedTuple):
    """What `advance` goes by."""

    dt: float
    """s"""
    bias: float
    """Of the vane, rad."""
    calibration: float
    """Steady, of the vane: angle of attack per angle shown."""
    arm: float
    """From the CG to the vane, m."""
    density: float
    """Of the air by the profile, kg/m3; NaN: not known."""
    mass: float
    """Of the profile, kg."""
    has_signals: bool
    """Whether the signals of wing and tail are wanted."""
    inertial: flow.Constants
    vane: cg.Constants
    signals: gusts.Constants


class State:
    """What `advance` edits, and what it gives: inertial.flow, vane.seen, signals.signals and the scalars here."""

    inertial: flow.State
    vane: cg.State
    signals: gusts.State
    unexplained_mean: float
    unexplained: float
    """Of what the motion leaves of the vane: mean, rad, and mean square, rad2."""
    wind_sd: float
    """Standard error of the mean wind along the path, m/s."""


@njit(cache=True)
def prepare(c: Constants, u: Array) -> tuple[flow.Motion, flow.Air]:
    """From inputs `u` (cond.INPUTS) the motion, a rate or ay that is missing counted as 0, and the air at the CG."""
    p, q, r, ay, beta = u[cond.P], u[cond.Q], u[cond.R], u[cond.AY], u[cond.BETA]
    p = 0.0 if math.isnan(p) else p
    r = 0.0 if math.isnan(r) else r
    ay = 0.0 if math.isnan(ay) else ay
    speed = u[cond.AIRSPEED]
    alpha = c.calibration * (u[cond.VANE] - c.bias) + c.arm * q / speed
    beta = 0.0 if math.isnan(beta) else beta - c.arm * r / speed
    return flow.Motion(p, q, r, u[cond.AX], ay, u[cond.AZ]), flow.Air(speed, alpha, beta)


@njit(cache=True)
def is_finite(m: flow.Motion) -> bool:
    """Whether nothing of it is missing."""
    rates = math.isfinite(m.p) and math.isfinite(m.q) and math.isfinite(m.r)
    return rates and math.isfinite(m.ax) and math.isfinite(m.ay) and math.isfinite(m.az)


@njit(cache=True)
def assemble(u: Array, motion: flow.Motion, pressure: float, mass: float, seen: cg.Seen, row: Array) -> None:
    """A `row` (equation_error.ROW,) from a tick's inputs, motion and what the vane's filter gave.

    `pressure`: dynamic, Pa; `mass`: kg.
    """
    row[0], row[1], row[2], row[3], row[4], row[5] = motion
    row[6] = u[cond.AIRSPEED]
    row[7] = pressure
    row[8] = mass
    row[9] = u[cond.THRUST]
    row[10] = u[cond.ELEVATOR]
    row[11] = seen.split if seen.is_ready else seen.steady
    row[12] = seen.steady
    row[13] = seen.scaled_late
    row[14] = seen.rate_late
    row[15] = seen.split if seen.is_ready else 0.0
    row[16] = seen.gust_step if seen.is_ready else 0.0


@njit(cache=True)
def advance(
    constants: Element, state: Element, sides: tuple[Array, Array, Array, Array], t: float, u: Array, age: Array
) -> int:
    """One tick of all filters at `t`, s, from inputs `u` with their `age`, (inputs,); returns MADE and SPLIT.

    `constants` and `state`, one element each, are of Constants and State; `sides` as equation_error.Sides has them.
    """
    c: Constants = constants[0]
    s: State = state[0]
    row = np.empty(ee.ROW)
    motion, air = prepare(c, u)
    if is_finite(motion):
        a, v = cond.ATTITUDE, cond.VELOCITY
        flow.step(c.inertial, s.inertial, t, motion, air, flow.Streams(u[a:v], age[a:v], u[v:], age[v:]))
    else:
        flow.restart(s.inertial)
    inertial, seen = s.inertial.flow, s.vane.seen
    alpha_i = inertial.alpha if inertial.is_ready else math.nan
    cg.step(c.vane, s.vane, u[cond.VANE], motion.p, motion.q, air.speed, alpha_i)
    if not seen.is_ready:
        gusts.restart(s.signals)
    else:
        fade = c.dt / UNEXPLAINED_S
        error = c.calibration * seen.residual - s.unexplained_mean
        s.unexplained_mean += fade * error
        s.unexplained += fade * (error * error - s.unexplained)
        if c.has_signals:
            gust, upwash = seen.boom_gust, seen.upwash
            gusts.step(c.signals, s.signals, gust, upwash, alpha_i, air.speed, inertial.speed, inertial.theta)
        else:
            gusts.watch_wind(c.signals, s.signals, air.speed, inertial.speed)
            s.signals.count += 1
    s.wind_sd = gusts.wind_sd(c.signals, s.signals)
    mass = u[cond.MASS] if u[cond.MASS] > 0.0 else c.mass
    assemble(u, motion, cond.dynamic_pressure(u, c.density), mass, seen, row)
    constant, history, means, made = sides
    good = ee.sides(constant, history, means, c.dt, row, made)
    for i in range(made.shape[0]):
        good = good and math.isfinite(made[i])
    return (MADE if good else 0) + (SPLIT if seen.is_ready else 0)


@njit(cache=True)
def restart(state: Element) -> None:
    """Begin anew from the next measurements; the mean wind is kept."""
    s: State = state[0]
    flow.restart(s.inertial)
    cg.restart(s.vane)
    gusts.restart(s.signals)


def constants(
    aircraft: Aircraft, imu: tuple[float, float, float], dt: float, high_hz: float = 2.0, has_signals: bool = True
) -> Element:
    """Constants for an aircraft, packed. `imu`: from the CG, m; `high_hz`: up to where the signals are analysed."""
    boom = aircraft.boom
    return packed(
        Constants(
            dt=dt,
            bias=boom.zero if boom else 0.0,
            calibration=boom.steady_calibration if boom else 1.0,
            arm=boom.vane_x if boom else 0.0,
            density=aircraft.air_density if aircraft.air_density is not None else math.nan,
            mass=aircraft.inertia.mass,
            has_signals=has_signals,
            inertial=flow.Constants(dt, np.array(imu, dtype=np.float64)),
            vane=cg.constants(aircraft, dt),
            signals=gusts.constants(aircraft, dt, high_hz),
        )
    )
