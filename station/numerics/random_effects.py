"""One number from several measurements of it, each with its own error and all of them scattered besides.

Random effects: y_i = mu + u_i + e_i, e_i of the known standard error, u_i of an unknown one, tau, which is the
restricted maximum likelihood's (Viechtbauer 2005; DerSimonian and Laird's moments underestimate it for a handful of
measurements). The mean's error is Hartung and Knapp's with Student's t for one measurement less than there are, never
less than the usual one (Roever, Knapp and Friede 2015).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.stats import norm, t

Array = NDArray[np.float64]

NORMAL_95: Final = float(norm.ppf(0.975))
_PRECISION: Final = 1e-6
"""Of tau, relative to the scatter of the measurements."""


class Pooled(NamedTuple):
    """The mean of `number` measurements."""

    value: float
    error: float
    """Its standard error."""
    between: float
    """tau: by how much a measurement lies off it beyond its own error, standard deviation; NaN for a single one."""
    number: int

    @property
    def widening(self) -> float:
        """Standard errors to either end of a 95 % interval."""
        return float(t.ppf(0.975, self.number - 1)) if self.number > 1 else NORMAL_95

    @property
    def interval(self) -> tuple[float, float]:
        """Of the mean, 95 %."""
        half = self.widening * self.error
        return self.value - half, self.value + half

    @property
    def of_another(self) -> float:
        """Standard error of what another measurement without error would give: the mean's, and the scatter."""
        return math.hypot(self.error, self.between if self.number > 1 else 0.0)


def pooled(values: Sequence[float], errors: Sequence[float]) -> Pooled:
    """The mean of measurements with their standard errors. Raises ValueError for none, or for an error that is not
    above 0."""
    y, s = np.asarray(values, dtype=np.float64), np.asarray(errors, dtype=np.float64)
    if not len(y) or len(y) != len(s) or not (np.isfinite(y).all() and (s > 0).all() and np.isfinite(s).all()):
        raise ValueError("measurements with standard errors above 0 are needed")
    if len(y) == 1:
        return Pooled(float(y[0]), float(s[0]), math.nan, 1)
    between = _between(y, s)
    w = 1.0 / (s**2 + between**2)
    mean = float(np.sum(w * y) / np.sum(w))
    chi2 = float(np.sum(w * (y - mean) ** 2)) / (len(y) - 1)
    return Pooled(mean, math.sqrt(max(1.0, chi2) / float(np.sum(w))), between, len(y))


def _between(y: Array, s: Array) -> float:
    """tau by restricted maximum likelihood."""

    def deviance(tau: float) -> float:
        variance = s**2 + tau**2
        w = 1.0 / variance
        mean = np.sum(w * y) / np.sum(w)
        return float(np.sum(np.log(variance)) + np.log(np.sum(w)) + np.sum(w * (y - mean) ** 2))

    scatter = float(np.std(y, ddof=1))
    if scatter == 0.0:
        return 0.0
    found = minimize_scalar(
        deviance, bounds=(0.0, 3.0 * scatter), method="bounded", options={"xatol": _PRECISION * scatter}
    )
    return float(found.x) if deviance(float(found.x)) < deviance(0.0) else 0.0
