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
    out = np.empty(columns.shape)
    state, spread, logarithm = np.zeros((len(sds), columns.shape[1])), np.diag(sds**2), 0.0
    for t in range(len(time)):
        kept = np.exp((time[max(t - 1, 0)] - time[t]) / lengths)
        state *= kept.reshape(-1, 1)
        spread = spread * np.outer(kept, kept) + np.diag(sds**2 * (1.0 - kept**2))
        gain = spread.sum(axis=1)
        variance = gain.sum() + white**2
        new = columns[t] - state.sum(axis=0)
        out[t] = new / math.sqrt(variance)
        state += np.outer(gain / variance, new)
        spread -= np.outer(gain, gain) / variance
        logarithm += math.log(variance)
    return out, logarithm
