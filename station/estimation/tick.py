"""What one tick hands from kernel to kernel: conditioned inputs to the inertial and vane filters, and both to a row of
equation error. SI, radians."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.estimation import alpha as cg
from station.estimation import conditioning as cond

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
