"""Multisines: sums of equal-power harmonics of 1/period, for several surfaces at once without correlation.

Harmonics that several share are dealt out in turn, so that over a period every surface's input is orthogonal to every
other's; each one's phases, at first Schroeder's, are optimised for a small relative peak factor by minimising rising
p-norms (Guillaume et al. 1991) and then shifted in time to begin and end at zero, which leaves it orthogonal. Source:
Morelli 2003, AIAA 2003-5498 and Morelli 2012, J. Aircraft 49(6): orthogonal phase-optimised multisines.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from station.rows import ProfileError

Array = NDArray[np.float64]

_GOOD_PEAK_FACTOR = 1.08
"""Relative peak factor at which the search for phases ends."""
_ATTEMPTS = 6
_FAIR_PEAK_FACTOR = 1.12
"""Above it the search goes on, for so many attempts more: few harmonics, unevenly spaced, have many poor optima."""
_MORE_ATTEMPTS = 34


@dataclass(frozen=True, slots=True)
class Wave:
    """sum of sin(2 pi k t/period + phase) over the harmonics k, divided by `peak`, its largest size: within 1."""

    harmonics: tuple[int, ...]
    phases: tuple[float, ...]
    """rad"""
    peak: float
    relative_peak_factor: float
    """(max - min) / (2 sqrt2 rms); 1 for a sine."""

    def at(self, t: Array, period: float) -> Array:
        """At times t (n,) since its start."""
        out = np.zeros_like(t)
        for k, phase in zip(self.harmonics, self.phases, strict=True):
            out += np.sin(2 * math.pi * k / period * t + phase)
        return out / self.peak


def harmonics_between(period: float, low: float, high: float) -> tuple[int, ...]:
    """Numbers of the harmonics of 1/period (s) from low to high (Hz). Raises ProfileError where there is none."""
    found = range(max(1, math.ceil(low * period - 1e-9)), math.floor(high * period + 1e-9) + 1)
    if not found:
        raise ProfileError(f"multisine: no harmonic of 1/{period:g} s lies between {low:g} and {high:g} Hz")
    return tuple(found)


def interleaved(wanted: Sequence[tuple[int, ...]]) -> list[tuple[int, ...]]:
    """Each harmonic to one of those that want it: the one that has fewest so far, the first of equals. Raises
    ProfileError where one gets none."""
    given: list[list[int]] = [[] for _ in wanted]
    for k in sorted(set().union(*wanted)):
        min((own for own, of in zip(given, wanted, strict=True) if k in of), key=len).append(k)
    if not all(given):
        raise ProfileError(
            f"multisine: {len(set().union(*wanted))} harmonics for {len(wanted)} inputs that begin together: one gets\n"
            "none; make them last longer, or their bands wider"
        )
    return [tuple(own) for own in given]


@lru_cache(maxsize=64)
def wave(harmonics: tuple[int, ...]) -> Wave:
    """Sum of sines of these harmonics with a small relative peak factor, from zero upwards."""
    from scipy.optimize import minimize

    numbers = np.array(harmonics)
    n = len(numbers)
    points = 16 * int(numbers[-1])

    def signal(phases: Array, points: int = points) -> Array:
        spectrum = np.zeros(points // 2 + 1, dtype=complex)
        spectrum[numbers] = -0.5j * points * np.exp(1j * phases)
        out: Array = np.fft.irfft(spectrum, points)
        return out

    def log_norm(phases: Array, p: int) -> tuple[float, Array]:
        x = signal(phases)
        top = float(np.abs(x).max())
        powered = np.abs(x / top) ** (p - 1)
        total = float((powered * np.abs(x / top)).sum())
        weights = np.conj(np.fft.rfft(powered * np.sign(x)))[numbers]
        gradient = np.real(np.exp(1j * phases) * weights) / (top * total)
        return math.log(top) + math.log(total) / p, gradient

    def peak_factor(phases: Array, points: int = points) -> float:
        return float(np.ptp(signal(phases, points))) / (2 * math.sqrt(n))

    rng = np.random.default_rng(n)
    best = -math.pi * np.arange(n) * np.arange(1, n + 1) / n  # Schroeder
    for attempt in range(_ATTEMPTS + _MORE_ATTEMPTS):
        phases = best if attempt == 0 else rng.uniform(-math.pi, math.pi, n)
        for p in (4, 8, 16, 32, 64):
            phases = minimize(log_norm, phases, args=(p,), jac=True, method="L-BFGS-B", options={"maxiter": 60}).x
        if peak_factor(phases) < peak_factor(best):
            best = phases
        if peak_factor(best) < (_GOOD_PEAK_FACTOR if attempt + 1 < _ATTEMPTS else _FAIR_PEAK_FACTOR):
            break
    phases = np.remainder(best + numbers * _rising_zero(numbers, best), 2 * math.pi)
    peak = float(np.abs(signal(phases, 16 * points)).max())
    return Wave(tuple(harmonics), tuple(phases.tolist()), peak, peak_factor(phases, 16 * points))


def _rising_zero(harmonics: NDArray[np.int64], phases: Array) -> float:
    """Angle of the fundamental, rad, where the sum of sines crosses zero going up."""

    def value(a: float) -> float:
        return float(np.sin(harmonics * a + phases).sum())

    grid = np.linspace(0, 2 * math.pi, 16 * int(harmonics[-1]) + 1)
    x = np.array([value(float(a)) for a in grid])
    i = int(np.flatnonzero((x[:-1] <= 0) & (x[1:] > 0))[0])
    a, b = float(grid[i]), float(grid[i + 1])
    for _ in range(60):
        middle = 0.5 * (a + b)
        a, b = (middle, b) if value(middle) <= 0 else (a, middle)
    return b
