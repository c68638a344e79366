"""How far two sides of a relation between signals are apart, as a share: 0 where they are equal, 1 where they are
opposite or of quite another size."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.numerics.differentiation import derivative

Array = NDArray[np.float64]

SMOOTH_S: Final = 0.2
UNRELATED: Final = 0.5
"""Mismatch of sides that have nothing in common: it is the same with either sign and in any unit."""


def share(one: Array, *others: Array) -> float:
    """Size of `one` - sum(others) over the sum of their sizes."""
    n = min(len(a) for a in (one, *others))
    rest = one[:n] - sum((o[:n] for o in others), np.zeros(n))
    size = math.sqrt(float(one @ one)) + sum(math.sqrt(float(o @ o)) for o in others)
    return math.sqrt(float(rest @ rest)) / size if size > 0 else 0.0


def agreement(one: Array, other: Array) -> float:
    """The same, as far as the two go together: noise and gusts in either do not count for its size."""
    first, second, both = float(one @ one), float(other @ other), float(one @ other)
    if not (first > 0 and second > 0 and both):
        return UNRELATED
    # From all noise in the first side to all of it in the second, the ratio nearest to 1.
    least, most = sorted((both / second, first / both))
    return _certain(min(max(1.0, least), most), both**2 / (first * second))


def proportional(one: Array, other: Array, factor: float, within: float) -> float:
    """The same of `one` and `factor` times `other`, of which only `one` has noise, with a factor that may be `within`
    times larger or smaller."""
    first, second, both = float(one @ one), float(other @ other), float(one @ other)
    if not (first > 0 and second > 0 and factor):
        return UNRELATED
    gain = both / second / factor
    return _certain(gain / min(max(abs(gain), 1 / within), within) if gain else 0.0, both**2 / (first * second))


def _certain(gain: float, determined: float) -> float:
    return determined * abs(1 - gain) / (1 + abs(gain)) + (1 - determined) * UNRELATED


def mean(x: Array) -> Array:
    return np.atleast_1d(np.mean(x))


def moved(x: Array, dt: float) -> Array:
    """Smoothed, mean and trend removed."""
    width = max(1, round(SMOOTH_S / dt))
    sums = np.cumsum(np.concatenate(([0.0], x - x.mean())))
    y = (sums[width:] - sums[:-width]) / width
    t = np.linspace(-0.5, 0.5, len(y))
    y = y - y.mean()
    return np.asarray(y - float((y * t).sum() / (t * t).sum()) * t)


def rate(x: Array, dt: float) -> Array:
    """Smoothed rate of change, mean and trend removed."""
    return moved(derivative(x, dt), dt)
