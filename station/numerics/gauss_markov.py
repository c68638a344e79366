"""Rows whose errors are white noise and Gauss-Markov processes together: whitened by the Kalman filter of those.

The innovations of the filter, divided by their standard deviations, are the rows times the inverse of the Cholesky
factor of the errors' covariance, at a cost that grows with the number of rows, not with its cube. Source: Durbin and
Koopman 2012, Time Series Analysis by State Space Methods, chapters 4 and 7.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True, error_model="numpy")
def whitened(time: Array, columns: Array, white: float, sds: Array, lengths: Array) -> tuple[Array, float]:
    """The columns (n, m) with rows at `time` (n,), s, increasing, whitened, and the logarithm of the determinant of the
    errors' covariance: `white` is the standard deviation of what is new in each row, above 0; `sds` and `lengths` (k,)
    those of the processes and their correlation times, s."""
    kept, gain, variance = _filtered(time, white, sds, lengths)
    out = np.empty(columns.shape)
    state, count = np.zeros((len(sds), columns.shape[1])), len(sds)
    for t in range(len(time)):
        for j in range(columns.shape[1]):
            new = columns[t, j]
            for i in range(count):
                state[i, j] *= kept[t, i]
                new -= state[i, j]
            out[t, j] = new / math.sqrt(variance[t])
            for i in range(count):
                state[i, j] += gain[t, i] * new
    return out, float(np.log(variance).sum())


@njit(cache=True, error_model="numpy")
def _filtered(time: Array, white: float, sds: Array, lengths: Array) -> tuple[Array, Array, Array]:
    """What each process keeps since the row before and takes of an innovation (n, k), and the innovations' variances
    (n,)."""
    n = len(time)
    kept, gain, variance = np.empty((n, len(sds))), np.empty((n, len(sds))), np.empty(n)
    spread = np.diag(sds**2)
    for t in range(n):
        kept[t] = np.exp((time[max(t - 1, 0)] - time[t]) / lengths)
        spread = spread * np.outer(kept[t], kept[t]) + np.diag(sds**2 * (1.0 - kept[t] ** 2))
        shared = spread.sum(axis=1)
        variance[t] = shared.sum() + white**2
        gain[t] = shared / variance[t]
        spread -= np.outer(gain[t], shared)
    return kept, gain, variance
