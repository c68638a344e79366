"""Frozen turbulence by its spectrum, and how a wing meets it: gusts as functions of the place along the path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tests.second_simulation.aircraft import CHORD, KUSSNER, SPAN, UPWASH_GUST, Drawn

Array = NDArray[np.float64]

STEP: Final = 0.2
"""Metres from one place of the field to the next: 3 ms of flight."""
BEHIND: Final = 120.0
"""Metres of air before the start, for what the wing remembers."""
KINDS: Final = ("dryden", "von_karman")


@dataclass(frozen=True)
class Air:
    """Gusts at every STEP from BEHIND metres before the start, m/s: updraughts, headwinds, from the left."""

    up: Array
    wing: Array
    """As the wing's lift follows it, met at the leading edge."""
    upwash: Array
    """As the wing's circulation does that turns the flow at the vane."""
    head: Array
    side: Array
    roll: Array
    """Of the updraught, across the span, rad/s."""


def spectrum(kind: str, axis: str, wave: Array, length: float) -> Array:
    """Of a gust of 1 m/s, one-sided, by rad/m (MIL-F-8785C, 3.7.1)."""
    x = length * wave
    if kind == "dryden":
        along, across = (2 / np.pi) / (1 + x**2), (1 / np.pi) * (1 + 3 * x**2) / (1 + x**2) ** 2
    else:
        x = 1.339 * x
        along, across = (2 / np.pi) / (1 + x**2) ** (5 / 6), (1 / np.pi) * (1 + 8 / 3 * x**2) / (1 + x**2) ** (11 / 6)
    return length * (along if axis == "along" else across)


def noise(rng: np.random.Generator, kind: str, axis: str, sigma: float, length: float, count: int) -> Array:
    """A draw of the spectrum, of `count` places, every STEP; the period is twice that, so that its ends do not meet."""
    n = 2 * count
    wave = 2 * np.pi * np.fft.rfftfreq(n, STEP)
    density = spectrum(kind, axis, wave, length)
    density[0] = 0.0
    lines = rng.standard_normal(len(wave)) + 1j * rng.standard_normal(len(wave))
    # Of real and imaginary parts: 4 sum amplitude2 / n2 is the variance.
    amplitude = 0.5 * n * np.sqrt(density * wave[1])
    return np.asarray(sigma * np.fft.irfft(amplitude * lines, n)[:count])


def indicial(met: Array, a: tuple[float, ...], b: tuple[float, ...]) -> Array:
    """What follows `met` along the path with 1 - sum a exp(-b s/c): each lag solved exactly for a linear change."""
    out = (1 - sum(a)) * met
    for share, rate in zip(a, b, strict=True):
        e = np.exp(-rate * STEP / CHORD)
        late = np.empty_like(met)
        x = met[0]
        for i, now in enumerate(met):
            before = met[i - 1] if i else now
            slope = (now - before) / (rate * STEP / CHORD)
            x = now - slope + (x - before + slope) * e
            late[i] = x
        out += share * late
    return out


def over_span(met: Array, lag: float, shape: str) -> Array:
    """A gust as a wing follows it whose span meets it `lag` b/2 late on average."""
    mean = lag * SPAN / 2
    if mean < STEP:
        return met
    far = np.arange(0.0, (8 if shape == "one lag" else 2) * mean + STEP, STEP)
    if shape == "one lag":
        kernel = np.exp(-far / mean)
    elif shape == "strips":
        kernel = np.ones_like(far)
    else:
        kernel = np.sqrt(np.clip(1 - (far / mean - 1) ** 2, 0, None))
    kernel /= kernel.sum()
    padded = np.concatenate((np.full(len(kernel) - 1, met[0]), met))
    return np.convolve(padded, kernel, "valid")


def air(rng: np.random.Generator, aircraft: Drawn, kind: str, sigma: float, length: float, metres: float) -> Air:
    """`sigma` of updraughts, m/s, headwinds as strong; `length` the scale, m; `metres` to be flown."""
    count = int((BEHIND + 1.3 * metres + 60.0) / STEP)
    if sigma:
        up, side = (noise(rng, kind, "across", sigma, length, count) for _ in range(2))
        head = noise(rng, kind, "along", sigma, length, count)
        # MIL-F-8785C, 3.7.5: the roll gusts' spectrum is that of a first-order lag of white noise; this its variance.
        lag = 4 * SPAN / np.pi
        sd = sigma * np.sqrt(0.8 / (length * SPAN)) * (np.pi * length / (4 * SPAN)) ** (1 / 6) * np.pi / np.sqrt(8)
        e, roll = np.exp(-STEP / lag), np.zeros(count)
        shocks = sd * np.sqrt(1 - e * e) * rng.standard_normal(count)
        for i in range(1, count):
            roll[i] = e * roll[i - 1] + shocks[i]
    else:
        up, side, head, roll = (np.zeros(count) for _ in range(4))
    met = over_span(up, aircraft.span_lag, aircraft.span_shape)
    share = aircraft.memory
    a = KUSSNER["a"] if share else (0.0, 0.0)
    wing = indicial(met, a, tuple(aircraft.memory_rate * b for b in KUSSNER["b"]))
    late = tuple(aircraft.upwash_rate * b for b in UPWASH_GUST["b"])
    upwash = indicial(met, UPWASH_GUST["a"], late)
    return Air(up, wing, upwash, head, side, roll)
