"""A candidate of a diagnosis: its state, its slopes, its normal equations, and what is left where it is best."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.free_parameters import BEYOND
from station.diagnosis.series_spectra import Spectra
from station.diagnosis.variances import Levels
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class Slopes:
    """Changes per unit of each parameter of one manoeuvre."""

    bins: Complex
    """(p, series, bins)"""
    steady: Array
    """(p, integrated and mean parts)"""
    response: Complex
    """(p, groups, series, sensors + 1): at the bins that stand for their neighbours, see Manoeuvre.grouped."""

    def after(self, first: Slopes) -> Slopes:
        """Parameters `first`, then these."""
        return Slopes(
            np.concatenate([first.bins, self.bins]),
            np.concatenate([first.steady, self.steady]),
            np.concatenate([first.response, self.response]),
        )


@dataclass(frozen=True, slots=True)
class State:
    """A candidate: effects and free parameters, the noise's variances, and what the data say of it."""

    values: Mapping[str, float]
    """Of the effects, by id, SI."""
    a: Array
    """Free parameters, then drifts, in prior standard deviations."""
    flown: Aircraft
    """What answers the gusts that nothing measures."""
    levels: Levels
    spectra: tuple[Spectra, ...]
    responses: tuple[Complex, ...]
    roots: tuple[Complex, ...]
    """(bins, k, k) Cholesky factors of Sigma."""
    white: tuple[Complex, ...]
    """(bins, k) whitened residuals, of variance 1."""
    steady: tuple[Array, ...]
    q: float
    """Weighted squares and priors."""

    @property
    def ids(self) -> tuple[str, ...]:
        return tuple(self.values)


@dataclass(frozen=True, slots=True)
class Solved:
    """Normal equations of a state."""

    step: Array
    """Effects, then free parameters and drifts."""
    covariance: Array
    gained: float
    """What Q falls by along the step, if all is linear."""


@dataclass(frozen=True, slots=True)
class Normal:
    """Of p parameters: information as measured, what noise in the slopes put into it, what of that scatters the score,
    and the gradient of Q/2 without priors."""

    seen: Array
    noise: Array
    scatter: Array
    gradient: Array


@dataclass(frozen=True, slots=True)
class Estimate:
    """A state at its best, with its last normal equations."""

    state: State
    solved: Solved
    slopes: list[Slopes]
    normal: Normal
    cost: float

    @property
    def strained(self) -> bool:
        """Whether its constants, or one of them, are farther from the profile's than its doubt lets expect."""
        a = self.state.a
        return bool(a @ a > len(a) or np.abs(a).max() > BEYOND)


def numbers(x: Complex) -> Array:
    """(p, ...) -> (p, n) real and imaginary parts: their products are the real part of one times the other's
    conjugate."""
    return x.reshape(len(x), -1).view(np.float64)
