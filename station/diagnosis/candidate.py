"""A candidate of a diagnosis: its state, its slopes, its normal equations, and what is left where it is best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.free_parameters import BEYOND
from station.diagnosis.series_spectra import Spectra
from station.diagnosis.variances import Levels
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

SUBTRACTED: Final = (1.0, 0.8, 0.6, 0.4, 0.2, 0.0)
"""Share of the slopes' noise that is taken out of the information: the first that leaves every parameter at least as
well known as by its prior (Fuller 1987 subtracts less for the same reason)."""
LEAST_KNOWN: Final = 0.5
UNSEEN: Final = 1e-9
"""Information of an effect that shows nowhere, per its unit squared: that the equations can be solved."""


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
    """Free parameters, then what is unseen, in prior standard deviations."""
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
    """Effects, then free parameters and what is unseen."""
    covariance: Array
    gained: float
    """What Q falls by along the step, if all is linear."""


class Normal(NamedTuple):
    """Of p parameters: information as measured, what noise in the slopes put into it, what of that scatters the score,
    and the gradient of Q/2 without priors."""

    seen: Array
    noise: Array
    scatter: Array
    gradient: Array


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """A state at its best, with its last normal equations. The same only where it is the same object."""

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


def without_first(slopes: Sequence[Slopes], n: int) -> list[Slopes]:
    """Slopes without their first `n` parameters."""
    return [Slopes(x.bins[n:], x.steady[n:], x.response[n:]) for x in slopes]


def numbers(x: Complex) -> Array:
    """(p, ...) -> (p, n) real and imaginary parts: their products are the real part of one times the other's
    conjugate."""
    return x.reshape(len(x), -1).view(np.float64)


def solution(at: Array, normal: Normal, known: Array, ends: Array, damping: float = 0.0) -> Solved:
    """The step of all parameters, effects first, that are `at`, of priors of information `known` about 0; those at one
    of their `ends`, (2, parameters), do not go beyond it."""
    gradient = normal.gradient + known * at
    own = np.diag(known) + 1e-12 * np.diag(np.diag(normal.seen)) + UNSEEN * np.eye(len(known))
    for share in SUBTRACTED:
        matrix = normal.seen - share * normal.noise + own
        scale = 1 / np.sqrt(np.abs(np.diag(matrix)) + 1e-30)
        values = np.linalg.eigvalsh(matrix * scale[:, None] * scale)
        # No parameter may become less known than by its prior.
        if values[0] > 0 and np.linalg.eigvalsh(matrix - (1 - LEAST_KNOWN) * np.diag(known))[0] > 0:
            break
    inverse = np.linalg.inv(matrix)
    damped = matrix + damping * np.diag(np.diag(normal.seen) + known)
    step, goes = np.zeros(len(at)), np.ones(len(at), dtype=bool)
    while True:
        step[:] = 0.0
        step[goes] = -np.linalg.solve(damped[np.ix_(goes, goes)], gradient[goes])
        beyond = ((at <= ends[0]) & (step < 0)) | ((at >= ends[1]) & (step > 0))
        if not beyond.any():
            break
        goes &= ~beyond
    covariance = inverse @ (matrix + share * normal.scatter) @ inverse
    return Solved(step, covariance, float(-gradient @ step))
