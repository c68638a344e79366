"""Standard errors where a model is wrong by the same multiple over an octave: closed forms of one parameter."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from station.diagnosis.candidate import Slopes
from station.diagnosis.model_error import with_model_error
from station.diagnosis.score import WEIGHT

SHARE, NOISE = 0.02, 3.0
"""Missed of what moves; the noise's standard deviation."""


@dataclass(frozen=True)
class Solved:
    covariance: np.ndarray


@dataclass(frozen=True)
class Estimate:
    state: SimpleNamespace
    slopes: list[Slopes]
    solved: Solved


def standard_error(*manoeuvres: tuple[np.ndarray, np.ndarray], across: bool = False) -> float:
    """Of a parameter that is a multiple of what moves in one series, or of that a quarter turn on; a manoeuvre: its
    frequencies, and what moves there."""
    turned = 1j if across else 1.0
    made, slopes = [], []
    for f, moves in manoeuvres:
        here = moves.astype(complex)[:, None, None]
        made.append(SimpleNamespace(setting=SimpleNamespace(frequencies=f), moving=lambda _, here=here: here))
        none = np.zeros((1, 0, 1, 1), dtype=complex)
        slopes.append(Slopes((turned * moves).astype(complex)[None, None], np.zeros((1, 0)), none))
    roots = tuple(np.full((len(f), 1, 1), NOISE, dtype=complex) for f, _ in manoeuvres)
    nothing = (None,) * len(manoeuvres)
    state = SimpleNamespace(roots=roots, responses=nothing, levels=SimpleNamespace(missed=np.array([SHARE**2])))
    information = WEIGHT * sum(float((x**2).sum()) for _, x in manoeuvres) / NOISE**2
    told = with_model_error(SimpleNamespace(manoeuvres=made), Estimate(state, slopes, Solved(np.eye(1) / information)))
    return float(np.sqrt(told.solved.covariance[0, 0] - 1 / information))


def octave(low: float, n: int = 16) -> np.ndarray:
    return low * (1 + np.arange(n) / n)


@pytest.mark.parametrize("across", [False, True])
def test_within_an_octave_a_multiple_is_unknown_by_its_half_of_the_share_however_much_is_measured(across: bool) -> None:
    """In step and a quarter turn on have half of its variance each; no number of bins averages it out."""
    for n in (16, 1600):
        moves = np.random.default_rng(n).standard_normal(n)
        assert standard_error((octave(1.0, n), moves), across=across) == pytest.approx(SHARE / np.sqrt(2))


def test_octaves_that_weigh_alike_average() -> None:
    f = np.concatenate([octave(0.25), octave(0.5), octave(1.0), octave(2.0)])
    assert standard_error((f, np.ones(len(f)))) == pytest.approx(SHARE / np.sqrt(2) / 2)


def test_more_manoeuvres_do_not() -> None:
    """Of other lengths, and so of other frequencies."""
    flown = [(octave(1.0, n), np.full(n, 0.7)) for n in (16, 23, 40)]
    assert standard_error(*flown) == pytest.approx(standard_error(flown[0]))
