"""Fourier transforms of a stretch through a smooth window: of a delayed signal, and of its time derivatives.

    X_m(f) = integral of phi(t) x^(m)(t + lag) dt = (-1)^m integral of phi^(m)(t - lag) x(t) dt,
    phi(t) = w(t) exp(-j 2 pi f t)

Window and derivative fall on the modulating function phi, which is known exactly: a derivative needs no differences of
noisy samples and no values at the ends, and a lag needs no interpolation. w rises and falls by a polynomial with three
continuous derivatives; the integral of w^2 is 1, so white noise of density S (two-sided) gives every line a mean
square of S. Lines are 1/(length of the stretch) apart.

Source: Shinbrot 1957, NACA TN 3935 (modulating functions); Pearson and Lee 1985, Journal of Guidance 8(2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

EDGE: Final = 0.2
"""Share of the stretch over which the window rises, and falls: lines stay apart, and little of the record is lost."""
KEPT: Final = 50
"""Windows of other lags that are kept."""
_RISE: Final = np.array(
    [np.pad(np.polynomial.Polynomial([0, 0, 0, 0, 35, -84, 70, -20]).deriv(m).coef, (0, m)) for m in range(4)]
)
"""Coefficients of a rise from 0 to 1 with three continuous derivatives, and of its derivatives, lowest power first."""
MOST: Final = len(_RISE) - 1
"""Highest derivative that can be had."""


def _window(u: Array, length: float) -> Array:
    """w and its derivatives, (MOST + 1, n), at even times `u` (n,) within a stretch of `length` s."""
    made = np.zeros((MOST + 1, len(u)))
    made[0] = 1.0
    edge = EDGE * length
    powers = np.arange(_RISE.shape[1])
    orders = np.arange(MOST + 1)[:, None]
    rising, falling = u < edge, u > length - edge
    made[:, rising] = _RISE @ (u[rising] / edge) ** powers[:, None] / edge**orders
    made[:, falling] = _RISE @ ((length - u[falling]) / edge) ** powers[:, None] / (-edge) ** orders
    return made


@dataclass(frozen=True)
class Stretch:
    """`count` samples, `dt` s apart, of a record, the first at `start`; lines from 0 Hz, `lines` of them."""

    start: int
    count: int
    dt: float
    lines: int

    @property
    def length(self) -> float:
        """s"""
        return self.count * self.dt

    @cached_property
    def _times(self) -> Array:
        return np.asarray(np.arange(self.count) * self.dt)

    @cached_property
    def frequencies_hz(self) -> Array:
        return np.asarray(np.arange(self.lines) / self.length)

    @cached_property
    def _norm(self) -> float:
        w = _window(self._times, self.length)[0]
        return 1.0 / math.sqrt(float(w @ w) * self.dt)

    @cached_property
    def correlation(self) -> Complex:
        """Of the transforms of white noise at lines 0, 1, 2 ... apart, (lines,)."""
        w = _window(self._times, self.length)[0] * self._norm
        return np.asarray(np.fft.fft(w * w)[: self.lines] * self.dt)

    @cached_property
    def _windows(self) -> dict[float, Array]:
        """By the time of the first sample in the stretch."""
        return {}

    def transform(self, x: Array, lag: float, orders: int) -> list[Complex]:
        """Of x(t + lag) and its derivatives up to `orders`, (lines,) each; x the whole record's (n,)."""
        first = math.ceil(lag / self.dt - 1e-9)
        rows = x[self.start + first : self.start + first + self.count]
        after = max(round(first * self.dt - lag, 12), 0.0)
        if after not in self._windows:
            if len(self._windows) > KEPT:
                self._windows.clear()
            self._windows[after] = _window(self._times + after, self.length)
        back = -2j * np.pi * self.frequencies_hz
        parts = np.fft.rfft(self._windows[after][: orders + 1] * rows)[:, : self.lines]
        parts = parts * (np.exp(back * after) * self.dt * self._norm)
        made = [parts[0]]
        for m in range(1, orders + 1):
            total = sum(math.comb(m, j) * back ** (m - j) * parts[j] for j in range(m + 1))
            made.append(np.asarray((-1) ** m * total))
        return made
