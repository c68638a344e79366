"""Gain and delay of one signal on another, and the level between two, from means a tenth of a second apart.

    y(t) = gain x(t - delay) + error, in differences from one mean to the next

An instrument z, which moves x but has nothing to do with the error, keeps gain and delay right where the error moves x
too, or where x is noisy: its noise, taken for motion, would make the gain too small. Where x is all noise, nothing is
told. Standard errors allow for coloured residuals.

Source: Soderstrom and Stoica 1989, chapter 8 (instrumental variables); Klein and Morelli 2006, section 5.2.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.numerics.lagrange import cubic, cubic_slope

Array = NDArray[np.float64]

STEP_S: Final = 0.1
"""From one mean to the next."""
LEAST: Final = 200
"""Means with both signals, before anything is said."""
RECENT: Final = 200
LAGS: Final = 25
BLOCK: Final = 50
DELAYS_S: Final = (-0.3, 0.6)
WEAK: Final = 0.1
"""Correlation with the instrument below which nothing can be told,"""
BY_CHANCE: Final = 6.0
"""and over sqrt(n): four standard deviations of what noise has with an instrument made of itself (1.5/sqrt(n): what is
before one mean is after another, and means overlap)."""
BESIDE: Final = 2
"""Means between a signal and its own instrument: a mean of an integral has a rate's noise in common with the next, not
with the one after that."""
LEAST_GAIN: Final = 0.2
"""Below it there is no delay."""
_ROUNDS: Final = 8
_SINGULAR: Final = 1e-6
"""Determinant over the product of its diagonal, below which gain and delay are not told apart."""
_SETTLED_S: Final = 1e-3
"""A delay that moves by less has been found."""
_SIDE_BY_SIDE: Final = 1.5
"""Blocks side by side are not independent: their mean's error is larger by it."""


@njit(cache=True, error_model="numpy")
def _later(x: Array, ticks: float, i: int) -> tuple[float, float]:
    """x at place i - ticks by the cubic through four points, and its slope per place; NaN beyond the ends."""
    at = i - ticks
    k = math.floor(at)
    if k < 1 or k + 2 >= x.shape[0]:
        return math.nan, math.nan
    f = at - k
    a, b, c, d = x[k - 1], x[k], x[k + 1], x[k + 2]
    return cubic(a, b, c, d, f), cubic_slope(a, b, c, d, f)


@njit(cache=True, error_model="numpy")
def _differences(y: Array, x: Array, z: Array, ticks: float, columns: Array, good: NDArray[np.bool_]) -> int:
    """Differences from one place to the next without their means: z and its slope, x and its slope (per s of delay),
    all `ticks` ago, and y; (n, 5). Edits `columns` and `good`; returns how many there are."""
    n = y.shape[0]
    was = (math.nan, math.nan, math.nan, math.nan, math.nan)
    used = 0
    mean = np.zeros(5)
    for i in range(n):
        xv, xs = _later(x, ticks, i)
        zv, zs = _later(z, ticks, i)
        now = (zv, -zs / STEP_S, xv, -xs / STEP_S, y[i])
        good[i] = True
        for j in range(5):
            columns[i, j] = now[j] - was[j]
            good[i] = good[i] and math.isfinite(columns[i, j])
        was = now
        if good[i]:
            used += 1
            for j in range(5):
                mean[j] += columns[i, j]
    # By element: numba takes seconds to compile the check of two arrays' shapes.
    for i in range(n):
        for j in range(5):
            columns[i, j] = columns[i, j] - mean[j] / used if good[i] else 0.0
    return used


class Match(NamedTuple):
    """Gain and delay (s) of one signal on another, with their standard deviations; NaN where they cannot be told."""

    gain: float
    gain_sd: float
    delay: float
    delay_sd: float


def beside(x: Array) -> Array:
    """What `x` (n,) shows a little before and after: its own instrument, which has its motion and not its noise. NaN at
    the ends."""
    z = np.full(x.shape, math.nan)
    z[BESIDE:-BESIDE] = 0.5 * (x[: -2 * BESIDE] + x[2 * BESIDE :])
    return z


@njit(cache=True, error_model="numpy")
def compare(y: Array, x: Array, z: Array, guess: float) -> Match:
    """Gain and delay of `y` on `x`, with instrument `z`, (n,) each in time's order, NaN where missing.

    `guess`: delay to begin at, s.
    """
    n = y.shape[0]
    unknown = Match(math.nan, math.nan, math.nan, math.nan)
    delay, gain = guess, 1.0
    columns = np.zeros((n, 5))
    good = np.zeros(n, dtype=np.bool_)
    e = np.zeros(n)
    a00 = a01 = a10 = a11 = size = 0.0
    used = 0
    settled = False
    for _ in range(_ROUNDS):
        used = _differences(y, x, z, delay / STEP_S, columns, good)
        if used < LEAST:
            return unknown
        a00 = a01 = a10 = a11 = b0 = b1 = own = instrument = 0.0
        for i in range(n):
            w0, w1, dx, slope, dy = columns[i]
            a00 += w0 * dx
            a01 += w0 * slope
            a10 += w1 * dx
            a11 += w1 * slope
            b0 += w0 * dy
            b1 += w1 * dy
            own += dx * dx
            instrument += w0 * w0
        size = a00 * a11 - a01 * a10
        if own == 0.0 or instrument == 0.0 or a00 * a00 < max(WEAK**2, BY_CHANCE**2 / used) * own * instrument:
            return unknown
        if abs(size) < _SINGULAR * abs(a00 * a11):
            return unknown
        gain = (a11 * b0 - a01 * b1) / size
        shift = (a00 * b1 - a10 * b0) / size
        for i in range(n):
            e[i] = columns[i, 4] - gain * columns[i, 2] - shift * columns[i, 3]
        if settled or abs(gain) <= LEAST_GAIN:
            break
        move = min(max(shift / gain, -STEP_S), STEP_S)
        delay = min(max(delay + move, DELAYS_S[0]), DELAYS_S[1])
        settled = abs(move) < _SETTLED_S
    if abs(gain) > LEAST_GAIN and not settled:
        return unknown
    m00, m01, m11 = _covariance(columns, good, e, used)
    i00, i01, i10, i11 = a11 / size, -a01 / size, -a10 / size, a00 / size
    var_gain = i00 * i00 * m00 + 2.0 * i00 * i01 * m01 + i01 * i01 * m11
    var_shift = i10 * i10 * m00 + 2.0 * i10 * i11 * m01 + i11 * i11 * m11
    gain_sd = math.sqrt(max(var_gain, 0.0))
    if abs(gain) <= LEAST_GAIN:
        return Match(gain, gain_sd, math.nan, math.nan)
    return Match(gain, gain_sd, delay, math.sqrt(max(var_shift, 0.0)) / abs(gain))


@njit(cache=True, error_model="numpy")
def _covariance(columns: Array, good: NDArray[np.bool_], e: Array, used: int) -> tuple[float, float, float]:
    """Of the instruments' sums with the errors `e`, coloured as their own autocorrelation says."""
    n = e.shape[0]
    m00 = m01 = m11 = 0.0
    power = np.zeros(LAGS)
    for lag in range(LAGS):
        total = 0.0
        for i in range(lag, n):
            total += e[i] * e[i - lag]
        power[lag] = total / used * (1.0 - lag / LAGS)
    for i in range(n):
        w0, w1 = columns[i, 0], columns[i, 1]
        if not good[i]:
            continue
        m00 += w0 * w0 * power[0]
        m01 += w0 * w1 * power[0]
        m11 += w1 * w1 * power[0]
        for lag in range(1, min(LAGS, i + 1)):
            c = power[lag]
            m00 += 2.0 * c * w0 * columns[i - lag, 0]
            m01 += c * (w0 * columns[i - lag, 1] + w1 * columns[i - lag, 0])
            m11 += 2.0 * c * w1 * columns[i - lag, 1]
    return m00, m01, m11


@njit(cache=True, error_model="numpy")
def level(y: Array, x: Array, moving: bool) -> tuple[float, float]:
    """Mean of y - x, or of its rate of change per second where `moving`, and its sd from means of 5 s; NaN
    where there are too few."""
    n = y.shape[0]
    total = squares = 0.0
    blocks = 0
    for first in range(0, n - BLOCK + 1, BLOCK):
        inside = 0.0
        count = 0
        for i in range(first, first + BLOCK):
            value = y[i] - x[i]
            if moving:
                value = (value - (y[i - 1] - x[i - 1])) / STEP_S if i > 0 else math.nan
            if math.isfinite(value):
                inside += value
                count += 1
        if count >= BLOCK // 2:
            total += inside / count
            squares += (inside / count) ** 2
            blocks += 1
    if blocks < RECENT // BLOCK:
        return math.nan, math.nan
    mean = total / blocks
    return mean, _SIDE_BY_SIDE * math.sqrt(max(squares / blocks - mean * mean, 0.0) / (blocks - 1))
