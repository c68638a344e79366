"""Least squares of what is dear to evaluate: slopes made once, and kept in step by what each trial shows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP: Final = 0.01
"""Over which slopes are taken, in standard deviations of the prior: curvature and rounding are both far below."""
SETTLED: Final = 0.01
"""Share of the sum of squares below which a step by slopes made there need not be taken."""
TRIALS: Final = 40
"""At most: twice what the farthest of some thirty flights needed."""
MARQUARDT: Final = (0.01, 10.0)
"""First share of its diagonal added to the Hessian after a step that failed, and the factor of the next; Marquardt
1963."""


def secant_fit(differences: Callable[[Array], Array], n: int, slopes: Array | None = None) -> tuple[Array, Array]:
    """Parameters (n,), from 0 on, and slopes (m, n) there, with the least |differences|^2 + |parameters|^2: in standard
    deviations of errors and priors.

    Steps are Levenberg and Marquardt's. Slopes (m, n) follow each step taken by Broyden's first update (1965), which
    needs no evaluation of its own; the fit ends only where slopes made anew promise no more, or after TRIALS. `slopes`:
    those of a problem like this one, to begin with. A trial whose differences (m,) are no numbers counts as failed."""
    unit, x = np.eye(n), np.zeros(n)
    here = differences(x)

    def made() -> Array:
        return np.stack([(differences(x + STEP * row) - here) / STEP for row in unit], axis=1)

    slopes, exact = (made(), True) if slopes is None else (slopes, False)
    damping = 0.0
    for _ in range(TRIALS):
        hessian, gradient = slopes.T @ slopes + unit, slopes.T @ here + x
        step = -np.linalg.solve(hessian + damping * np.diag(np.diag(hessian)), gradient)
        cost = here @ here + x @ x
        if -(2 * gradient + hessian @ step) @ step < SETTLED * cost:
            if exact:
                break
            slopes, exact, damping = made(), True, 0.0
            continue
        there = differences(x + step)
        if there @ there + (x + step) @ (x + step) < cost:
            slopes = slopes + np.outer(there - here - slopes @ step, step) / (step @ step)
            x, here, exact, damping = x + step, there, False, damping / MARQUARDT[1]
        else:
            damping = max(MARQUARDT[1] * damping, MARQUARDT[0])
    return x, slopes
