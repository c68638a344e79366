"""Lagrange's cubic through four samples, its slope, and the value of a signal some ticks ago in a ring of past ones.

The formulas take numbers in compiled code and arrays elsewhere.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

Array = NDArray[np.float64]
Quantity = Any
"""A number or an array."""


@register_jitable
def cubic(a: Quantity, b: Quantity, c: Quantity, d: Quantity, f: Quantity) -> Quantity:
    """At the place f of the cubic through a, b, c and d at -1, 0, 1 and 2."""
    return (
        -a * f * (f - 1.0) * (f - 2.0) / 6.0
        + b * (f + 1.0) * (f - 1.0) * (f - 2.0) / 2.0
        - c * (f + 1.0) * f * (f - 2.0) / 2.0
        + d * (f + 1.0) * f * (f - 1.0) / 6.0
    )


@register_jitable
def quintic(a: Quantity, b: Quantity, c: Quantity, d: Quantity, e: Quantity, g: Quantity, f: Quantity) -> Quantity:
    """At the place f of the quintic through a, b, c, d, e and g at -2, -1, 0, 1, 2 and 3."""
    inner = (f + 1.0) * f * (f - 1.0) * (f - 2.0)
    left, right = (f + 2.0) * (f + 1.0), (f - 2.0) * (f - 3.0)
    return (
        -a * inner * (f - 3.0) / 120.0
        + b * (f + 2.0) * f * (f - 1.0) * right / 24.0
        - c * left * (f - 1.0) * right / 12.0
        + d * left * f * right / 12.0
        - e * left * f * (f - 1.0) * (f - 3.0) / 24.0
        + g * (f + 2.0) * inner / 120.0
    )


@register_jitable
def cubic_slope(a: Quantity, b: Quantity, c: Quantity, d: Quantity, f: Quantity) -> Quantity:
    """Slope of `cubic` per place."""
    return (
        -a * (3.0 * f * f - 6.0 * f + 2.0) / 6.0
        + b * (3.0 * f * f - 4.0 * f - 1.0) / 2.0
        - c * (3.0 * f * f - 2.0 * f - 2.0) / 2.0
        + d * (3.0 * f * f - 1.0) / 6.0
    )


@register_jitable
def uneven_cubic(
    times: tuple[float, float, float, float], values: tuple[float, float, float, float], t: float
) -> float:
    """At `t` of the cubic through four values at any four times."""
    ta, tb, tc, td = times
    a, b, c, d = values
    x = a * (t - tb) * (t - tc) * (t - td) / ((ta - tb) * (ta - tc) * (ta - td))
    x += b * (t - ta) * (t - tc) * (t - td) / ((tb - ta) * (tb - tc) * (tb - td))
    x += c * (t - ta) * (t - tb) * (t - td) / ((tc - ta) * (tc - tb) * (tc - td))
    x += d * (t - ta) * (t - tb) * (t - tc) / ((td - ta) * (td - tb) * (td - tc))
    return x


@njit(cache=True)
def delayed(ring: Array, newest: int, ticks: float) -> float:
    """The value `ticks` ago in a `ring` (n,) whose newest is at `newest` % n: the cubic; within the last tick, where
    there is no sample ahead, the parabola through three."""
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
    return float(cubic(ring[(newest - whole + 1) % n], b, c, d, f))
