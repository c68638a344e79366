"""Angles that wrap."""

from __future__ import annotations

import math

from numba import njit


@njit(cache=True)
def wrap(angle: float) -> float:
    """The same direction within -pi..pi, rad."""
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)
