"""Levels of flying qualities: MIL-F-8785C, Military Specification: Flying Qualities of Piloted Airplanes, 1980."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.model.flying_qualities import Qualities

Array = NDArray[np.float64]


class Limits(NamedTuple):
    """Of one level: of CAP (omega^2 over n/alpha, 1/s2 per g), of the short period's damping, and the least n/alpha
    (g/rad) and frequency (rad/s), 0 where none is asked."""

    cap: tuple[float, float]
    damping: tuple[float, float]
    n_per_alpha: float = 0.0
    frequency: float = 0.0


_ANY: Final = math.inf
LEVELS: Final[Mapping[str, tuple[Limits, Limits, Limits]]] = {
    "B": (
        Limits((0.085, 3.6), (0.30, 2.00)),
        Limits((0.038, 10.0), (0.20, 2.00)),
        Limits((0.038, _ANY), (0.15, _ANY)),
    ),
    "C": (
        Limits((0.16, 3.6), (0.35, 1.30), 2.0, 0.7),
        Limits((0.096, 10.0), (0.25, 2.00), 1.0, 0.4),
        Limits((0.096, _ANY), (0.15, _ANY)),
    ),
}
"""Levels 1 to 3 of flight phase categories B (climb, cruise, descent) and C (approach, landing): figures 2 and 3, and
table IV, of MIL-F-8785C; n/alpha and frequency in C are those of classes II-L and III."""
PHUGOID_DAMPING: Final = (0.04, 0.0)
"""Least of levels 1 and 2 (3.2.1.2)."""


def level(category: str, omega: Array, zeta: Array, n_alpha: Array) -> NDArray[np.int64]:
    """The best level whose limits of frequency and damping are all kept; 4 beyond the last."""
    out = np.full(np.shape(omega), 4)
    cap = np.asarray(omega) ** 2 / n_alpha
    for k, limits in reversed(list(enumerate(LEVELS[category], start=1))):
        good = (cap >= limits.cap[0]) & (cap <= limits.cap[1])
        good &= (zeta >= limits.damping[0]) & (zeta <= limits.damping[1])
        good &= (n_alpha >= limits.n_per_alpha) & (omega >= limits.frequency)
        out = np.where(good, k, out)
    return np.asarray(out)


def levels_of(q: Qualities) -> dict[str, tuple[int, int, int]]:
    """Level by category, at the estimate, and the best and worst that the interval leaves open; empty where the short
    period is not known."""
    names = ("short_period_frequency", "short_period_damping", "n_per_alpha")
    if any(q.quantities[n].why for n in names):
        return {}
    made: dict[str, tuple[int, int, int]] = {}
    omega, zeta, n_alpha = (np.append(q.quantities[n].estimate, q.draws[n]) for n in names)
    for category in LEVELS:
        found = level(category, omega, zeta, n_alpha)
        best, worst = np.percentile(found[1:], (2.5, 97.5), method="nearest")
        made[category] = int(found[0]), int(best), int(worst)
    return made
