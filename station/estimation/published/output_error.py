"""Output error: maximum likelihood by Gauss-Newton (method oe), and what filter error shares with it.

z = y(p) + e, y from integrating the equations of motion; assumes no process noise. The diagonal residual covariance is
estimated in turn with the parameters; SI, rad. Sources: Klein and Morelli 2006, section 6.1; Jategaonkar 2015, chapter
4; errors for coloured residuals Morelli and Klein 1997.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matmul_toeplitz
from scipy.signal import correlate

from station.numerics.regression import NotIdentifiable

Array = NDArray[np.float64]
SINGULAR: Final = 1e12
"""Condition number of the scaled information matrix from which it counts as singular."""
Simulate = Callable[[Array], Array]
"""Parameters (m,) -> outputs (n, k)."""


@dataclass(frozen=True, slots=True)
class Convergence:
    """When to stop. SIDPAC's output error stops the search over residual variances at 5 %; 0.1 % is converged."""

    step: float = 1e-3
    """Largest change of a parameter, in standard errors."""
    noise: float = 1e-3
    """Relative change of the residual variances; after it one more search runs with the newest ones."""
    searches: int = 40
    iterations: int = 30


CONVERGED = Convergence()


@dataclass(frozen=True, slots=True)
class OutputFit:
    """Estimates (m,) with standard errors for white and coloured residuals; model and residual (n, k)."""

    estimate: Array
    se_white: Array
    se_coloured: Array
    covariance: Array
    """(m, m), white residuals."""
    noise: Array
    """(k,) residual variances."""
    model: Array
    residual: Array
    iterations: int
    converged: bool


def gauss_newton(
    simulate: Simulate,
    measured: Array,
    start: Array,
    convergence: Convergence = CONVERGED,
    relative_step: float = 0.01,
    *,
    symmetric_correlation: bool = False,
) -> OutputFit:
    """Fit outputs to `measured` (n, k), NaN where missing.

    Sensitivities by central differences of `relative_step`. A step to a higher cost or none is halved.
    `symmetric_correlation` takes the correlation of two outputs at a lag for the one at the opposite lag too, as SIDPAC
    does, for comparison with its coloured errors. Raises NotIdentifiable if the start cannot be simulated or the
    parameters are not determined.
    """
    used = np.isfinite(measured)
    count = used.sum(axis=0)
    if (count <= len(start)).any():
        raise NotIdentifiable("an output has fewer samples than there are parameters")
    p = np.asarray(start, dtype=np.float64).copy()

    def residual(parameters: Array) -> Array:
        return np.where(used, measured - simulate(parameters), 0.0)

    e = residual(p)
    if not np.isfinite(e).all():
        raise NotIdentifiable("the start values do not give a finite simulation")
    noise = variances(e, count)
    settled = converged = False
    total = 0
    for _ in range(convergence.searches):
        p, e, steps, converged = _search(simulate, residual, used, p, e, noise, convergence, relative_step)
        total += steps
        latest = variances(e, count)
        change = float(np.max(np.abs(latest / noise - 1)))
        noise = latest
        if settled:
            break
        settled = change < convergence.noise
    sensitivity = sensitivities(simulate, p, relative_step, used)
    covariance = invert(information_of(sensitivity, noise))
    se_white = np.sqrt(np.diag(covariance))
    return OutputFit(
        estimate=p,
        se_white=se_white,
        se_coloured=coloured_errors(sensitivity, e, noise, covariance, symmetric_correlation),
        covariance=covariance,
        noise=noise,
        model=simulate(p),
        residual=np.where(used, e, np.nan),
        iterations=total,
        converged=converged and settled,
    )


def variances(e: Array, count: NDArray[np.int64]) -> Array:
    """Mean squares of the residuals (n, k). Raises NotIdentifiable where there are none."""
    variances: Array = (e * e).sum(axis=0) / count
    if not (variances > 0).all():
        raise NotIdentifiable("an output is fitted without residual: it cannot have been measured")
    return variances


def _search(
    simulate: Simulate,
    residual: Simulate,
    used: NDArray[np.bool_],
    p: Array,
    e: Array,
    noise: Array,
    convergence: Convergence,
    relative_step: float,
) -> tuple[Array, Array, int, bool]:
    """Minimise the cost at fixed residual variances."""
    cost = 0.5 * float((e * e / noise).sum())
    for i in range(convergence.iterations):
        sensitivity = sensitivities(simulate, p, relative_step, used)
        covariance = invert(information_of(sensitivity, noise))
        step = covariance @ np.einsum("aij,ij,j->a", sensitivity, e, 1 / noise)
        small = bool(np.max(np.abs(step) / np.sqrt(np.diag(covariance))) < convergence.step)
        for _halving in range(12):
            e_new = residual(p + step)
            cost_new = 0.5 * float((e_new * e_new / noise).sum())
            # Difference quotients may miss the minimum by a little: 0.01 of a log-likelihood is negligible.
            if np.isfinite(cost_new) and cost_new <= cost + 0.01:
                break
            step = step / 2
        else:
            return p, e, i + 1, small
        p, e, cost = p + step, e_new, cost_new
        if small:
            return p, e, i + 1, True
    return p, e, convergence.iterations, False


def sensitivities(simulate: Simulate, p: Array, relative_step: float, used: NDArray[np.bool_]) -> Array:
    """dy/dp, (m, n, k), 0 where nothing was measured."""
    rows = []
    for j, value in enumerate(p):
        step = np.zeros(len(p))
        step[j] = relative_step * abs(value) if value != 0 else relative_step
        rows.append(np.where(used, (simulate(p + step) - simulate(p - step)) / (2 * step[j]), 0.0))
    found = np.array(rows)
    if not np.isfinite(found).all():
        raise NotIdentifiable("the simulation diverges")
    return found


def information_of(sensitivity: Array, noise: Array) -> Array:
    """Fisher information matrix (m, m)."""
    m = len(sensitivity)
    weighted = (sensitivity / np.sqrt(noise)).reshape(m, -1)
    information: Array = weighted @ weighted.T
    return information


def invert(information: Array) -> Array:
    """Its inverse. Raises NotIdentifiable where it is singular."""
    scale = np.sqrt(np.diag(information))
    if not (scale > 0).all():
        raise NotIdentifiable("an output that depends on no parameter, or a parameter that changes no output")
    scaled = information / np.outer(scale, scale)
    if np.linalg.cond(scaled) > SINGULAR:
        raise NotIdentifiable("parameters that are collinear in this record")
    inverse: Array = np.linalg.inv(scaled) / np.outer(scale, scale)
    return inverse


def coloured_errors(sensitivity: Array, e: Array, noise: Array, covariance: Array, symmetric: bool) -> Array:
    """Standard errors (m,) with the residuals' own correlation."""
    variance = np.diag(covariance @ _coloured_scores(sensitivity, e, noise, symmetric) @ covariance)
    # The unbiased autocorrelation may give a negative variance: then the white one is all there is.
    white: Array = np.diag(covariance)
    return np.sqrt(np.where(variance > 0, variance, white))


def _coloured_scores(sensitivity: Array, e: Array, noise: Array, symmetric: bool) -> Array:
    """Sum over i, j of S(i)' R^-1 Rvv(j - i) R^-1 S(j), with the unbiased auto- and cross-correlations Rvv."""
    m, n, k = sensitivity.shape
    middle = np.zeros((m, m))
    overlap = n - np.arange(n)
    for a in range(k):
        for b in range(k):
            both = correlate(e[:, b], e[:, a])
            behind = both[n - 1 :: -1] / overlap
            ahead = behind if symmetric else both[n - 1 :] / overlap
            left, right = sensitivity[:, :, a] / noise[a], sensitivity[:, :, b].T / noise[b]
            middle += left @ matmul_toeplitz((behind, ahead), right, check_finite=False)
    return middle
