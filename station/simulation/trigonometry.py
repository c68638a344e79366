"""Arctangent, sine and cosine of the small angles of flight: their series, where it is exact to the last bits.

The equations of motion spend most of their time in these; the general functions are taken only for large angles.
"""

from __future__ import annotations

import math
from typing import Final

from numba import njit

_STEEP: Final = 0.25
"""tan of an angle up to which the arctangent's series of 12 terms is exact to 1e-16."""
_LARGE: Final = 0.5
"""rad: up to which 8 terms of the sine and cosine are."""


@njit(cache=True, error_model="numpy")
def arctangent(y: float, x: float) -> float:
    """atan2(y, x)."""
    if not abs(y) <= _STEEP * x:
        return math.atan2(y, x)
    t = y / x
    s = t * t
    even = 1.0 / 21.0 - s * (1.0 / 23.0)
    even = 1.0 / 17.0 - s * (1.0 / 19.0 - s * even)
    even = 1.0 / 13.0 - s * (1.0 / 15.0 - s * even)
    even = 1.0 / 9.0 - s * (1.0 / 11.0 - s * even)
    even = 1.0 / 5.0 - s * (1.0 / 7.0 - s * even)
    out: float = t * (1.0 - s * (1.0 / 3.0 - s * even))
    return out


@njit(cache=True, error_model="numpy")
def sine_cosine(x: float) -> tuple[float, float]:
    """sin(x), cos(x)."""
    if not abs(x) <= _LARGE:
        return math.sin(x), math.cos(x)
    s = x * x
    odd = 1.0 / 362880.0 - s * (1.0 / 39916800.0 - s * (1.0 / 6227020800.0))
    odd = 1.0 / 6.0 - s * (1.0 / 120.0 - s * (1.0 / 5040.0 - s * odd))
    even = 1.0 / 40320.0 - s * (1.0 / 3628800.0 - s * (1.0 / 479001600.0 - s * (1.0 / 87178291200.0)))
    even = 0.5 - s * (1.0 / 24.0 - s * (1.0 / 720.0 - s * even))
    return x * (1.0 - s * odd), 1.0 - s * even
