"""The value of a signal some time ago: third-order Lagrange interpolation in a ring of past ticks."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True)
def delayed(ring: Array, newest: int, ticks: float) -> float:
    """The value `ticks` ago in a `ring` (n,) whose newest is at `newest` % n: 3rd-order
    Lagrange; 2nd within the last tick, where there is no sample ahead."""
    n = ring.shape[0]
    ticks = min(max(ticks, 0.0), n - 4.0)
    whole = math.floor(ticks)
    f = ticks - whole
    if f == 0.0:
        return float(ring[(newest - whole) % n])
    b = ring[(newest - whole) % n]
    c = ring[(newest - whole - 1) % n]
    d = ring[(newest - whole - 2) % n]
    if whole == 0:
        return float(b * (1 - f) * (2 - f) / 2 + c * f * (2 - f) - d * f * (1 - f) / 2)
    a = ring[(newest - whole + 1) % n]
    return float(
        -a * f * (f - 1) * (f - 2) / 6
        + b * (f + 1) * (f - 1) * (f - 2) / 2
        - c * (f + 1) * f * (f - 2) / 2
        + d * (f + 1) * f * (f - 1) / 6
    )
