"""Whether a residual holds a share of something that is not fitted, beside all that is (a score test: Rao 1948)."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.variances import INDEPENDENT

Array = NDArray[np.float64]

FALSE_ALARM: Final = 2e-4
"""Chance that one of the shares asked for at once is told where there is none."""
LEAST_APART: Final = 0.01
"""Of a share's footprint, that nothing else which is fitted can show, a tenth of its amplitude: less may be what finite
differences leave of slopes that show it all."""
_WEIGHT: Final = 2 * INDEPENDENT


class Scores(NamedTuple):
    """Of each share, (k,)."""

    gained: Array
    """What -2 log likelihood falls by, chi-square with one degree of freedom where there is none; 0 where what is
    fitted can show it."""
    share: Array
    told: NDArray[np.bool_]
    """Whether it can be told from what is fitted."""


def scores(white: tuple[Array, Array, Array], effects: int, at: Array, known: Array) -> Scores:
    """Of whitened residuals (n,), slopes of what is fitted (p, n), and what shares of 1 would be (k, n). Fitted are
    first `effects` without a prior, then parameters that are `at`, in standard deviations, of priors of information
    `known`."""
    residuals, fitted, shares = white
    none = np.zeros(effects)
    matrix = _WEIGHT * (fitted @ fitted.T) + np.diag(np.concatenate([none, known]))
    own = _WEIGHT * (fitted @ residuals) + np.concatenate([none, known * at])
    both = _WEIGHT * (fitted @ shares.T)
    scale = 1 / np.sqrt(np.diag(matrix) + 1e-30)
    moved = scale[:, None] * np.linalg.solve(
        matrix * scale[:, None] * scale + 1e-9 * np.eye(len(scale)), scale[:, None] * np.column_stack([both, own])
    )
    alone = _WEIGHT * (shares**2).sum(1)
    left = alone - (both * moved[:, :-1]).sum(0)
    gradient = _WEIGHT * (shares @ residuals) - both.T @ moved[:, -1]
    told = (left > LEAST_APART * alone) & (alone > 0)
    left = np.where(told, left, 1.0)
    return Scores(np.where(told, gradient**2 / left, 0.0), gradient / left, told)
