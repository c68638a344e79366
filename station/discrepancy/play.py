"""Play: what follows a moving part that has slack."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True)
def _play(x: NDArray[np.float64], half: float, out: NDArray[np.float64]) -> None:
    for i in range(x.shape[0]):
        at = x[i, 0]
        for k in range(x.shape[1]):
            at = min(max(at, x[i, k] - half), x[i, k] + half)
            out[i, k] = at - x[i, k]


def play(x: NDArray[np.float64], width: float) -> NDArray[np.float64]:
    """How far a part with that slack in all stands from x (..., n) that drives it; x starts in the middle."""
    flat = np.ascontiguousarray(x).reshape(-1, x.shape[-1])
    out = np.empty_like(flat)
    _play(flat, 0.5 * width, out)
    return out.reshape(x.shape)
