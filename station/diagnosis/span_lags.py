"""How a span follows gusts that its parts meet one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import special

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

LEAST_CUT: Final = 0.1
"""Below it a span's lags are mixed of those that end there and those without end: nodes are too few for longer ones."""
SPAN_NODES: Final = 48
"""Exact to 1e-6 for lags that turn a gust by up to 60 rad."""


def span_response(length: float, shape: float, cut: float, wave: Array) -> Complex:
    """What a span makes of gusts of `wave` rad/m: the transform of a beta distribution of lags (Pearson 1895, type I)
    with the mean `length` (m), the longest length/`cut`, and `shape` of the variance of lags that thin out from the
    first on; without end a gamma distribution. Each may be a column, (p, 1) or (p, 1, 1)."""
    if wave.ndim > 1 or any(isinstance(x, np.ndarray) for x in (length, shape, cut)):
        return _by_row((length, shape, cut), wave)
    endless = (1 + 1j * wave * length * shape) ** (-1 / shape)
    end = max(cut, LEAST_CUT)
    share = min(cut / end, 1.0)
    if not share or not length:
        return np.asarray(endless, dtype=complex)
    a = (1 + end) / shape - end
    lags, weights = _beta_nodes(a, a * (1 - end) / end)
    ended = np.exp(-1j * wave[..., None] * (length / end) * lags) @ weights
    return np.asarray((1 - share) * endless + share * ended, dtype=complex)


def _by_row(columns: Sequence[float | Array], wave: Array) -> Complex:
    """Rows that are the same, as most are, once."""
    lead = np.broadcast_shapes(wave.shape, *(np.shape(x) for x in columns))[:-1]
    numbers = [np.broadcast_to(np.asarray(x), (*lead, 1)).ravel().tolist() for x in columns]
    waves = np.broadcast_to(wave, (*lead, wave.shape[-1])).reshape(-1, wave.shape[-1])
    made: dict[tuple[float, ...], Complex] = {}
    out = np.empty(waves.shape, dtype=complex)
    for k, (length, shape, cut) in enumerate(zip(*numbers, strict=True)):
        key = (length, shape, cut, float(waves[k, -1]))  # all are multiples of the same frequencies
        if key not in made:
            made[key] = span_response(length, shape, cut, waves[k])
        out[k] = made[key]
    return out.reshape(*lead, -1)


@lru_cache(maxsize=64)
def _beta_nodes(a: float, b: float) -> tuple[Array, Array]:
    """Gauss-Jacobi nodes of 0 to 1, and weights of sum 1."""
    x, weights = special.roots_jacobi(SPAN_NODES, b - 1, a - 1)
    return 0.5 * (1 + x), weights / weights.sum()
