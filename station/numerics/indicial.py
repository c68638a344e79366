"""Indicial responses: what an unsteady lift or upwash makes of an input sampled at every tick."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True)
def respond(
    s: Array, at: int, amplitudes: Array, rates: Array, n: int, before: float, now: float, chords: float
) -> float:
    """Indicial response 1 - sum a exp(-b t): exact first-order lags of an input linear between ticks."""
    value = now
    for j in range(n):
        x = rates[j] * chords
        decay = math.exp(-x)
        mean = (1.0 - decay) / x
        s[at + j] = decay * s[at + j] + (mean - decay) * before + (1.0 - mean) * now
        value += amplitudes[j] * (s[at + j] - now)
    return value
