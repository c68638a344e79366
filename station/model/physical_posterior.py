"""What `physical` knows after a fit: its normal equations, the estimate, and the errors of derivatives and nuisances.

The statistical error is what the residuals do to the estimate, the larger of the parametric one and a sum of score
products over neighbouring lines (Newey and West 1987): repeatability. The total one holds what the priors leave.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from station.model.physical_constants import FIRST_NUISANCE, PARAMETERS, N
from station.numerics.products import product, weighted_squares

Array = NDArray[np.float64]

SMALL_RECORD: Final = 1.2
"""On standard errors: weights come from the residuals of the record itself, of some 40 independent lines. From Monte
Carlo with known constants, so that 95 % intervals cover 95 %."""


class Sums(NamedTuple):
    """Over closed segments."""

    normal: Array
    """Normal matrix, (PARAMETERS, PARAMETERS)."""
    scores: Array
    """Score products of neighbouring lines, (PARAMETERS, PARAMETERS)."""
    right: Array
    """(PARAMETERS,)"""
    cross: Array
    """Normal matrix of parameters and nuisances without what noise adds to it, (PARAMETERS, N)."""


class Found(NamedTuple):
    """What `fit` makes of a segment and those before."""

    theta: Array
    """Derivatives and nuisances, (PARAMETERS,)."""
    statistical: Array
    """Standard errors by the residuals alone, (PARAMETERS,)."""
    total: Array
    """With what the priors leave, (PARAMETERS,)."""
    covariance: Array
    """Of the whole errors of derivatives and nuisances, (PARAMETERS, PARAMETERS)."""
    residual: Array
    """Energy of both equations' residuals, (2,), of this segment, as the next two."""
    signal: Array
    """And of CL and Cm themselves, (2,)."""
    summary: Array
    """How far the gust's spectrum stands out of the vane's noise, 0 calm to 1 turbulent; deviance of both equations
    for this model; and for the quasi-steady one on the same angle of attack; and what this model's constants, in all
    segments together, cost it, (4,)."""
    rho: Array
    """Share of the gust's spectrum that is not noise, (frequencies,)."""


class Solved(NamedTuple):
    """The segment's own normal equations, less the sensors' noise, and the solution with segments before and prior."""

    matrix: Array
    right: Array
    inverse: Array
    """Of the whole normal matrix."""


@register_jitable
def no_sums() -> Sums:
    """Before the first segment is closed."""
    n = PARAMETERS
    return Sums(np.zeros((n, n)), np.zeros((n, n)), np.zeros(n), np.zeros((n, N)))


@register_jitable
def nothing_found(lines: int) -> Found:
    """Zeros, to be filled."""
    n = PARAMETERS
    energies = np.zeros(2), np.zeros(2), np.zeros(4)
    return Found(np.zeros(n), np.zeros(n), np.zeros(n), np.zeros((n, n)), *energies, np.zeros(lines))


@njit(cache=True, error_model="numpy")
def errors(
    solved: Solved, past: Sums, cloud: Array, cross: Array, prior: Array, considered: Array, found: Found
) -> None:
    """Standard errors -> `found`. `cross` (PARAMETERS, N): see Sums."""
    n, inverse = PARAMETERS, solved.inverse
    scores, crossed = np.empty((n, n)), np.empty((n, N))
    for a in range(n):
        for b in range(n):
            scores[a, b] = cloud[a, b] + past.scores[a, b]
        for j in range(N):
            crossed[a, j] = cross[a, j] + past.cross[a, j]
    spread = product(product(inverse, scores), inverse)
    effect = product(inverse, crossed)
    data = np.empty((n, n))
    for a in range(n):
        for b in range(n):
            data[a, b] = solved.matrix[a, b] + past.normal[a, b]
    parametric = product(product(inverse, data), inverse)
    size = np.empty(n)
    for a in range(n):
        smallest = max(parametric[a, a], 0.0)
        square = SMALL_RECORD**2 * max(smallest, spread[a, a])
        size[a] = math.sqrt(square / smallest) if smallest > 0.0 else 0.0
        found.statistical[a] = math.sqrt(square)
        for b in range(n):
            square += inverse[a, b] ** 2 * prior[b] * SMALL_RECORD**2
        for j in range(N):
            square += effect[a, j] ** 2 * considered[j]
        found.total[a] = math.sqrt(square)
    _covariance(parametric, inverse, effect, prior, considered, size, found.covariance)


@njit(cache=True, error_model="numpy")
def _covariance(
    parametric: Array,
    inverse: Array,
    effect: Array,
    prior: Array,
    considered: Array,
    size: Array,
    covariance: Array,
) -> None:
    """Of the whole errors; `size` (PARAMETERS,): statistical errors over parametric ones."""
    for j in range(N):
        # What is only considered of a nuisance is not in its estimate.
        effect[FIRST_NUISANCE + j, j] -= 1.0
    by_prior = weighted_squares(inverse, prior)
    by_considered = weighted_squares(effect, considered)
    for a in range(PARAMETERS):
        for b in range(PARAMETERS):
            total = size[a] * size[b] * parametric[a, b] + SMALL_RECORD**2 * by_prior[a, b]
            covariance[a, b] = total + by_considered[a, b]
