"""A free oscillation's period and damping, as the tolerances of phugoid and Dutch roll are stated."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

Array = NDArray[np.float64]

PERIOD_SHARE: Final = 0.10
HALF_SHARE: Final = 0.10
DAMPING: Final = 0.02
"""Tolerances of 14 CFR part 60, table A2A: of the period; of the time to half or double amplitude, or of the damping
ratio, of which the less restrictive counts."""
LEAST_SHOWN: Final = 0.9
"""Share of a signal's variance that an oscillation must be, for its period to be that of the signal."""


@dataclass(frozen=True, slots=True)
class Oscillation:
    """Of one pair of roots: period (s), damping ratio, and the share of the signal's variance that it is."""

    period: float
    damping: float
    share: float

    @property
    def to_half(self) -> float:
        """Time to half amplitude, s; to double, negative, where it grows."""
        rate = self.damping * 2 * math.pi / (self.period * math.sqrt(1 - self.damping**2))
        return math.log(2) / rate if rate else math.inf


def oscillation(t: Array, x: Array, period: float) -> Oscillation:
    """The oscillation about a straight line that fits a signal (n,) best, from a guess of its period (s)."""
    t = t - t[0]

    def columns(rate: float, omega: float) -> Array:
        fading = np.exp(-rate * t)
        return np.stack([fading * np.cos(omega * t), fading * np.sin(omega * t), np.ones(len(t)), t], axis=1)

    def remaining(p: Array) -> Array:
        a = columns(p[0], p[1])
        return np.asarray(x - a @ np.linalg.lstsq(a, x, rcond=None)[0])

    omega = 2 * math.pi / period
    made = least_squares(
        remaining,
        [0.05 * omega, omega],
        x_scale=[0.1 * omega, omega],
        bounds=([-omega, 0.3 * omega], [omega, 3 * omega]),
    )
    rate, omega = (float(v) for v in made.x)
    share = 1 - float(np.var(made.fun) / max(np.var(x - np.polyval(np.polyfit(t, x, 1), t)), 1e-30))
    return Oscillation(2 * math.pi / omega, rate / math.hypot(rate, omega), share)


def apart(one: Oscillation, measured: Oscillation) -> float:
    """How far two oscillations are apart, in tolerances."""
    period = abs(one.period / measured.period - 1) / PERIOD_SHARE
    half = abs(one.to_half / measured.to_half - 1) / HALF_SHARE
    return max(period, min(half, abs(one.damping - measured.damping) / DAMPING))
