"""What one tick hands from kernel to kernel: conditioned inputs to the inertial and vane filters, and both to a row of
equation error; and a whole tick of them, compiled as one. SI, radians."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.estimation import alpha as cg
from station.estimation import conditioning as cond
from station.estimation import equation_error as ee
from station.estimation import inertial as flow
from station.model import physical_signals as gusts

UNEXPLAINED_S: Final = 5.0
"""Over which it is averaged what the motion leaves of the vane."""
MADE, SPLIT = 1, 2
"""What `advance` returns, added: a sample of equation error was made; there is a split angle of attack."""

Array = NDArray[np.float64]


@njit(cache=True)
def prepare(u: Array, zero: float, scale: float, arm: float, motion: Array, air: Array) -> None:
    """From inputs `u` (cond.INPUTS) the `motion` p q r ax ay az (6,), a rate or ay that is missing counted as 0, and
    `air` (3,): true airspeed, angle of attack and sideslip at the CG as the calibrated vanes have them.

    `zero`, `scale`, `arm`: the boom's zero (rad), steady calibration and length (m).
    """
    p, r, ay, beta = u[cond.P], u[cond.R], u[cond.AY], u[cond.BETA]
    motion[0] = 0.0 if math.isnan(p) else p
    motion[1] = u[cond.Q]
    motion[2] = 0.0 if math.isnan(r) else r
    motion[3] = u[cond.AX]
    motion[4] = 0.0 if math.isnan(ay) else ay
    motion[5] = u[cond.AZ]
    speed = u[cond.AIRSPEED]
    air[0] = speed
    air[1] = scale * (u[cond.VANE] - zero) + arm * motion[1] / speed
    air[2] = 0.0 if math.isnan(beta) else beta - arm * motion[2] / speed


@njit(cache=True)
def assemble(u: Array, motion: Array, pressure: float, mass: float, out: Array, row: Array) -> bool:
    """A `row` (equation_error.ROW,) from a tick's inputs, motion and what alpha.step gave (`out`).

    `pressure`: dynamic, Pa; `mass`: kg. Returns whether there is a split angle of attack.
    """
    is_split = bool(out[cg.READY] > 0.0)
    for i in range(6):
        row[i] = motion[i]
    row[6] = u[cond.AIRSPEED]
    row[7] = pressure
    row[8] = mass
    row[9] = u[cond.THRUST]
    row[10] = u[cond.ELEVATOR]
    row[11] = out[cg.SPLIT] if is_split else out[cg.STEADY]
    row[12] = out[cg.STEADY]
    row[13] = out[cg.SCALED_LATE]
    row[14] = out[cg.RATE_LATE]
    row[15] = out[cg.SPLIT] if is_split else 0.0
    row[16] = out[cg.GUST_STEP] if is_split else 0.0
    return is_split


@njit(cache=True)
def advance(
    t: float,
    dt: float,
    u: Array,
    age: Array,
    boom: tuple[float, float, float],
    body: tuple[float, float],
    inertial: tuple[Array, Array, Array, Array],
    vane: tuple[Array, Array, Array, Array],
    signals: tuple[Array, Array, Array, Array, Array],
    sides: tuple[Array, Array, Array, Array],
    unexplained: Array,
) -> int:
    """One tick of all filters from inputs `u` with their `age`, (inputs,); returns MADE and SPLIT.

    `boom`: zero, steady calibration, length; `body`: air density (NaN: not known) and mass of the profile. Then the
    `arrays` of Inertial, Vane, Signals and Sides, which are edited, and `unexplained` (2,): mean and mean square of
    what the motion leaves of the vane, rad.
    """
    motion, air, row = np.empty(6), np.empty(3), np.empty(ee.ROW)
    zero, scale, arm = boom
    prepare(u, zero, scale, arm, motion, air)
    state, ring, imu, seen = inertial
    usable = True
    for i in range(6):
        usable = usable and math.isfinite(motion[i])
    if usable:
        a, v = cond.ATTITUDE, cond.VELOCITY
        flow.step(state, ring, t, dt, motion, u[a:v], age[a:v], u[v:], age[v:], air, imu, seen)
    else:
        flow.restart(state, seen)
    alpha_i = seen[0] if seen[8] > 0.0 else math.nan
    par, state, ring, out = vane
    cg.step(par, state, ring, dt, u[cond.VANE], motion[0], motion[1], air[0], alpha_i, out)
    is_split = out[cg.READY] > 0.0
    par, table, state, ring, gust = signals
    if is_split:
        fade = dt / UNEXPLAINED_S
        off = scale * out[cg.RESIDUAL] - unexplained[0]
        unexplained[0] += fade * off
        unexplained[1] += fade * (off * off - unexplained[1])
        gusts.step(par, table, state, ring, dt, out[cg.BOOM_GUST], alpha_i, air[0], seen[2], seen[7], gust)
    else:
        gusts.restart(state, gust)
    density, mass = body
    mass = u[cond.MASS] if u[cond.MASS] > 0.0 else mass
    assemble(u, motion, cond.dynamic_pressure(u, density), mass, out, row)
    constant, history, means, made = sides
    good = ee.sides(constant, history, means, dt, row, made)
    for i in range(made.shape[0]):
        good = good and math.isfinite(made[i])
    return (MADE if good else 0) + (SPLIT if is_split else 0)
