"""Test inputs: what the pilot adds to the trimmed elevator.

Multisines are of equal-power harmonics of 1/duration, so their components are orthogonal over it, with phases optimised
for a small relative peak factor (Morelli 2003) by minimising rising p-norms (Guillaume et al. 1991), then shifted in
time to begin and end at zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from station.profile import Doublet, Manoeuvre, Multisine, Pulse, Sweep, ThreeTwoOneOne
from station.rows import ProfileError

_EDGE = 1e-9
"""Seconds by which an edge may miss its sample and still fall on it."""
_GOOD_PEAK_FACTOR = 1.08
"""Relative peak factor ((max - min) / 2 sqrt2 rms; 1 for a sine) at which the search for phases ends."""
_ATTEMPTS = 6


def elevator_input(manoeuvres: Sequence[Manoeuvre], time: NDArray[np.float64]) -> NDArray[np.float64]:
    """What the manoeuvres add to the trimmed elevator at times of flight (s), rad. See `surface_input`."""
    return surface_input(manoeuvres, time, "elevator")


def surface_input(manoeuvres: Sequence[Manoeuvre], time: NDArray[np.float64], surface: str) -> NDArray[np.float64]:
    """What the manoeuvres add to a trimmed surface at times of flight (s), rad. Inputs that overlap add up; one
    repeated before its end starts anew.

    A positive amplitude moves the surface to its positive side first. Raises ProfileError for a multisine
    without a harmonic in its band.
    """
    total = np.zeros_like(time)
    for m in manoeuvres:
        if m.surface != surface:
            continue
        since = time - m.start + _EDGE
        if m.repeat is not None:
            since = np.where(since >= 0, np.mod(since, m.repeat), since)
        active = np.flatnonzero((since >= 0) & (since < duration(m)))
        if len(active):
            total[active] += m.amplitude * _shape(m, since[active] - _EDGE)
    return total


def duration(m: Manoeuvre) -> float:
    """How long one run of the input lasts, s."""
    match m:
        case Doublet():
            return 2 * m.width
        case ThreeTwoOneOne():
            return 7 * m.unit
        case Pulse():
            return m.width
        case Multisine() | Sweep():
            return m.duration


def _shape(m: Manoeuvre, t: NDArray[np.float64]) -> NDArray[np.float64]:
    """The input for amplitude 1 at times since its start."""
    match m:
        case Doublet():
            return np.where(t + _EDGE < m.width, 1.0, -1.0)
        case ThreeTwoOneOne():
            edges = np.array([3.0, 5.0, 6.0]) * m.unit
            return np.where(np.searchsorted(edges, t + _EDGE, side="right") % 2 == 0, 1.0, -1.0)
        case Pulse():
            return np.ones_like(t)
        case Multisine():
            harmonics, phases, peak = multisine(m.duration, m.low, m.high)
            out = np.zeros_like(t)
            for k, phase in zip(harmonics, phases, strict=True):
                out += np.sin(2 * math.pi * k / m.duration * t + phase)
            return out / peak
        case Sweep():
            rate = (m.high - m.low) / m.duration
            swept: NDArray[np.float64] = np.sin(2 * math.pi * (m.low * t + 0.5 * rate * t**2))
            return swept


@lru_cache(maxsize=64)
def multisine(duration: float, low: float, high: float) -> tuple[tuple[int, ...], tuple[float, ...], float]:
    """Harmonics of 1/duration between low and high (Hz), a phase of each (rad), and the peak of the sum of sines."""
    harmonics = np.arange(max(1, math.ceil(low * duration - 1e-9)), math.floor(high * duration + 1e-9) + 1)
    if not len(harmonics):
        raise ProfileError(f"multisine: no harmonic of 1/{duration:g} s lies between {low:g} and {high:g} Hz")
    n = len(harmonics)
    points = 16 * int(harmonics[-1])

    def signal(phases: NDArray[np.float64]) -> NDArray[np.float64]:
        spectrum = np.zeros(points // 2 + 1, dtype=complex)
        spectrum[harmonics] = -0.5j * points * np.exp(1j * phases)
        out: NDArray[np.float64] = np.fft.irfft(spectrum, points)
        return out

    def log_norm(phases: NDArray[np.float64], p: int) -> tuple[float, NDArray[np.float64]]:
        x = signal(phases)
        top = float(np.abs(x).max())
        powered = np.abs(x / top) ** (p - 1)
        total = float((powered * np.abs(x / top)).sum())
        weights = np.conj(np.fft.rfft(powered * np.sign(x)))[harmonics]
        gradient = np.real(np.exp(1j * phases) * weights) / (top * total)
        return math.log(top) + math.log(total) / p, gradient

    def peak_factor(phases: NDArray[np.float64]) -> float:
        return float(np.ptp(signal(phases))) / (2 * math.sqrt(n))

    rng = np.random.default_rng(n)
    best = -math.pi * np.arange(n) * np.arange(1, n + 1) / n  # Schroeder
    for attempt in range(_ATTEMPTS):
        phases = best if attempt == 0 else rng.uniform(-math.pi, math.pi, n)
        for p in (4, 8, 16, 32, 64):
            phases = minimize(log_norm, phases, args=(p,), jac=True, method="L-BFGS-B", options={"maxiter": 60}).x
        if peak_factor(phases) < peak_factor(best):
            best = phases
        if peak_factor(best) < _GOOD_PEAK_FACTOR:
            break
    shift = _rising_zero(harmonics, best)
    phases = np.remainder(best + harmonics * shift, 2 * math.pi)
    spectrum = np.zeros(8 * points + 1, dtype=complex)
    spectrum[harmonics] = -8j * points * np.exp(1j * phases)
    peak = float(np.abs(np.fft.irfft(spectrum, 16 * points)).max())
    return tuple(int(k) for k in harmonics), tuple(float(p) for p in phases), peak


def _rising_zero(harmonics: NDArray[np.int64], phases: NDArray[np.float64]) -> float:
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
