"""What an error of the model leaves unknown of the parameters.

Sigma has the shares that the model misses as if every frequency missed its own: right as a weight, for nobody knows
where they are. But a model is wrong by much the same from one frequency to the next, and in every manoeuvre: that does
not average out, and standard errors that are told count it. They are those of the scores' covariance, between inverses
of the information that weighed them (Huber 1967, The Behavior of Maximum Likelihood Estimates under Nonstandard
Conditions).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.candidate import Estimate
from station.diagnosis.likelihood import Problem
from station.diagnosis.score import WEIGHT

Array = NDArray[np.float64]


def with_model_error(problem: Problem, e: Estimate) -> Estimate:
    """An estimate whose covariance has the shares that the model misses as one multiple, complex, of what moves, over
    each octave: what lags, memories of another shape and slopes that bend make changes over no less."""
    s = e.state
    scores: dict[int, NDArray[np.complex128]] = {}
    for m, root, response, slopes in zip(problem.manoeuvres, s.roots, s.responses, e.slopes, strict=True):
        changed = np.linalg.solve(root, slopes.bins.transpose(2, 1, 0))
        missed = np.linalg.solve(root, m.moving(response) * np.sqrt(s.levels.missed))
        each = WEIGHT * np.conj(changed).swapaxes(-1, -2) @ missed
        octaves = np.floor(np.log2(m.setting.frequencies)).astype(int)
        for octave in np.unique(octaves).tolist():
            scores[octave] = scores.get(octave, 0.0) + each[octaves == octave].sum(0)
    # Half of a share's variance is in step with what moves, half across.
    both = np.concatenate([x for score in scores.values() for x in (score.real, score.imag)], axis=-1) / np.sqrt(2)
    moved = e.solved.covariance @ both
    return replace(e, solved=replace(e.solved, covariance=e.solved.covariance + moved @ moved.T))
