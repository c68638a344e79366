"""Equation error in the time domain: least squares with errors for white and for coloured residuals (method I).

Equation: z = X p + e, where z is a measured coefficient and the columns of X are measured flow angles, normalised
rates and surface deflections. Assumes noise-free regressors and an unbiased model; units per radian.
Sources: Klein and Morelli 2006, sections 5.1 and 5.2.1 (least squares), equation 5.133 (coloured residuals);
Morelli and Klein, Journal of Aircraft 34(2), 1997.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray
from scipy.linalg import matmul_toeplitz

Array = NDArray[np.float64]


class NotIdentifiable(ValueError):
    """The record does not determine the parameters; the message says why."""


@dataclass(frozen=True, slots=True)
class Fit:
    """A least-squares fit of n samples by m parameters."""

    estimate: Array
    """(m,)"""
    se_white: Array
    """(m,) standard errors if the residuals are white."""
    se_coloured: Array
    """(m,) standard errors with the residuals' own autocorrelation."""
    covariance: Array
    """(m, m) with the residuals' own autocorrelation."""
    s: float
    """Residual standard deviation, sqrt(e'e / (n - m))."""
    r2: float
    model: Array
    """(n,)"""
    residual: Array
    """(n,) measured minus model."""


MAX_CONDITION: Final = 1e8
"""Condition number of the scaled regressors beyond which they are called collinear."""
SMOOTHED_LEAST: Final = 12
LEAST_PIVOT: Final = 1e-10
"""Of a matrix with unit diagonal, below which it is singular."""


def least_squares(regressors: Array, measured: Array) -> Fit:
    """Fit `measured` (n,) by `regressors` (n, m), no column added.

    Raises NotIdentifiable for non-finite values, fewer samples than parameters, and collinear or unexcited regressors.
    """
    x, z = np.asarray(regressors, dtype=float), np.asarray(measured, dtype=float)
    n, m = x.shape
    if n <= m:
        raise NotIdentifiable(f"{n} samples for {m} parameters")
    if not (np.isfinite(x).all() and np.isfinite(z).all()):
        raise NotIdentifiable("missing or non-finite samples")
    scale = np.sqrt(np.mean(x * x, axis=0))
    if (scale == 0).any():
        raise NotIdentifiable(f"regressor {int(np.argmin(scale)) + 1} of {m} is zero throughout")
    u, singular, vt = np.linalg.svd(x / scale, full_matrices=False)
    if singular[-1] * MAX_CONDITION < singular[0]:
        raise NotIdentifiable("collinear regressors")
    estimate = (vt.T / singular) @ (u.T @ z) / scale
    inverse = (vt.T / singular**2) @ vt / np.outer(scale, scale)
    model = x @ estimate
    residual = z - model
    s2 = float(residual @ residual) / (n - m)
    covariance = coloured_covariance(x, residual, inverse)
    spread = z - z.mean()
    total = float(spread @ spread)
    return Fit(
        estimate=estimate,
        se_white=np.sqrt(s2 * np.diag(inverse)),
        se_coloured=np.sqrt(np.maximum(np.diag(covariance), 0.0)),
        covariance=covariance,
        s=float(np.sqrt(s2)),
        r2=1.0 - float(residual @ residual) / total if total > 0 else float("nan"),
        model=model,
        residual=residual,
    )


def coloured_covariance(x: Array, residual: Array, inverse: Array) -> Array:
    """(X'X)^-1 X' R X (X'X)^-1, R Toeplitz in the residual's biased autocorrelation at all lags."""
    correlation = autocorrelation(residual)
    coloured: Array = inverse @ (x.T @ matmul_toeplitz(correlation, x, check_finite=False)) @ inverse
    return coloured


def autocorrelation(residual: Array, unbiased: bool = False) -> Array:
    """r(k) = sum e(i) e(i+k) / n, or / (n - k) if unbiased, for k = 0..n-1."""
    n = len(residual)
    total: Array = np.correlate(residual, residual, "full")[n - 1 :]
    return total / (n - np.arange(n)) if unbiased else total / n


def smoothed_start(x: Array, cutoff_hz: float, dt: float) -> Array:
    """The first row of x (n, m) without its noise, as SIDPAC removes trim from regressors.

    The three samples after the first are low-passed by one half of a symmetric filter folded onto the later side, and
    a straight line through them is continued to the first sample. The filter falls from 1 at the cut-off to 0 along
    half a cosine (Graham, NASA TR R-179, 1963), its half-length half the record, the width of the fall
    pi / (half-length). Raises NotIdentifiable below SMOOTHED_LEAST samples.
    """
    x = np.asarray(x, dtype=float)
    n = len(x)
    half = int(np.floor(n / 2.0 - 0.1 + 0.5))
    if n < SMOOTHED_LEAST:
        raise NotIdentifiable(f"{n} samples are too few to smooth an end of the record")
    stop_hz = cutoff_hz + np.pi / (half * dt)
    t = np.arange(1, half + 1) * dt
    wide, narrow = 2 * np.pi * stop_hz * t, 2 * np.pi * cutoff_hz * t
    weights = np.pi / (2 * t) * (np.sin(wide) + np.sin(narrow)) / (np.pi**2 - (wide - narrow) ** 2)
    weights = np.concatenate([[cutoff_hz + stop_hz], 2 * weights])
    weights /= weights.sum()
    near = np.array([weights[: n - i] @ x[i : i + half + 1] for i in (1, 2, 3)])
    # Line through abscissae 1, 2, 3 taken at 0.
    start: Array = near.mean(axis=0) - (near[2] - near[0])
    return start


@register_jitable
def _clear(work: Array, n: int, k: int) -> None:
    """Column k of n rows becomes that of the unit matrix."""
    pivot = work[k, k]
    for j in range(2 * n):
        work[k, j] /= pivot
    for i in range(n):
        if i != k:
            f = work[i, k]
            for j in range(2 * n):
                work[i, j] -= f * work[k, j]


@register_jitable
def _eliminate(work: Array, n: int) -> bool:
    """Gauss-Jordan on n rows: the first n columns become the unit matrix. False if a pivot is too small."""
    for k in range(n):
        if not work[k, k] > LEAST_PIVOT:
            return False
        _clear(work, n, k)
    return True


@register_jitable
def _eliminate_by_rows(work: Array, n: int) -> bool:
    """The same, each pivot the largest of its column."""
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(work[i, k]) > abs(work[best, k]):
                best = i
        if not abs(work[best, k]) > LEAST_PIVOT:
            return False
        for j in range(2 * n):
            work[k, j], work[best, j] = work[best, j], work[k, j]
        _clear(work, n, k)
    return True


@register_jitable
def _scaled(m: Array, n: int, work: Array, scale: Array) -> bool:
    """m, its diagonal scaled to one, and the unit matrix -> `work` (n, 2n). False where the diagonal has a zero."""
    for i in range(n):
        size = abs(m[i, i])
        if not (size > 0.0 and math.isfinite(size)):
            return False
        scale[i] = 1.0 / math.sqrt(size)
    for i in range(n):
        for j in range(n):
            work[i, j] = m[i, j] * scale[i] * scale[j]
        work[i, n + i] = 1.0
    return True


@register_jitable
def _unscaled(work: Array, n: int, scale: Array, inverse: Array) -> None:
    for i in range(n):
        for j in range(n):
            inverse[i, j] = work[i, n + j] * scale[i] * scale[j]


@njit(cache=True, error_model="numpy")
def invert(m: Array, n: int, inverse: Array) -> bool:
    """inverse <- m^-1, the first n rows and columns of either, m symmetric and positive; False if singular.

    Gauss-Jordan on the matrix scaled to a unit diagonal.
    """
    work, scale = np.zeros((n, 2 * n)), np.empty(n)
    for i in range(n):
        if not m[i, i] > 0.0:
            return False
    if not (_scaled(m, n, work, scale) and _eliminate(work, n)):
        return False
    _unscaled(work, n, scale, inverse)
    return True


@njit(cache=True, error_model="numpy")
def invert_general(m: Array, n: int, inverse: Array) -> bool:
    """inverse <- m^-1, the first n rows and columns of either; False if singular. Gauss-Jordan with pivots by rows, on
    the matrix with rows and columns scaled by the roots of its diagonal's sizes."""
    work, scale = np.zeros((n, 2 * n)), np.empty(n)
    if not (_scaled(m, n, work, scale) and _eliminate_by_rows(work, n)):
        return False
    _unscaled(work, n, scale, inverse)
    return True


def attenuation(inverse: Array, share: Array, value: Array) -> Array:
    """What noise in the regressors does to least squares' parameters (m,): each shrinks by its own noise's `share` of
    what the regressor has for itself, and what it loses goes to those that it moves along with (Fuller 1987).

    `inverse`: of the normal matrix M with the noise N in it. The true ones are (M - N)^-1 M value.
    """
    lost = inverse * (share / np.maximum(np.diag(inverse), 1e-300))
    return np.asarray(np.linalg.solve(np.eye(len(value)) - lost, lost @ value))
