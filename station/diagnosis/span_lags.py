"""How a span follows gusts that its parts meet one after the other."""

from __future__ import annotations

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


def span_response(length: float | Array, shape: float | Array, cut: float | Array, wave: Array) -> Complex:
    """What a span makes of gusts of `wave` rad/m: the transform of a beta distribution of lags (Pearson 1895, type I)
    with the mean `length` (m), the longest length/`cut`, and `shape` of the variance of lags that thin out from the
    first on; without end a gamma distribution. `wave` (..., n); the others numbers or columns (..., 1)."""
    lead = np.broadcast_shapes(wave.shape, *(np.shape(x) for x in (length, shape, cut)))[:-1]
    columns = [np.broadcast_to(np.asarray(x), (*lead, 1)).ravel().tolist() for x in (length, shape, cut)]
    waves = np.broadcast_to(wave, (*lead, wave.shape[-1])).reshape(-1, wave.shape[-1])
    made: dict[tuple[float, float, float, bytes], Complex] = {}
    rows = []
    for mean, spread, least, row in zip(*columns, waves, strict=True):
        key = (mean, spread, least, row.tobytes())  # most rows are the same
        if key not in made:
            made[key] = _response(mean, spread, least, row)
        rows.append(made[key])
    return np.stack(rows).reshape(*lead, -1)


def _response(length: float, shape: float, cut: float, wave: Array) -> Complex:
    endless = (1 + 1j * wave * length * shape) ** (-1 / shape)
    end = max(cut, LEAST_CUT)
    share = min(cut / end, 1.0)
    if not share or not length:
        return np.asarray(endless, dtype=complex)
    a = (1 + end) / shape - end
    lags, weights = _beta_nodes(a, a * (1 - end) / end)
    ended = np.exp(-1j * wave[..., None] * (length / end) * lags) @ weights
    return np.asarray((1 - share) * endless + share * ended, dtype=complex)


@lru_cache(maxsize=64)
def _beta_nodes(a: float, b: float) -> tuple[Array, Array]:
    """Gauss-Jacobi nodes of 0 to 1, and weights of sum 1."""
    x, weights = special.roots_jacobi(SPAN_NODES, b - 1, a - 1)
    return 0.5 * (1 + x), weights / weights.sum()
