"""Whether an effect has one value: in every manoeuvre, at low and at high frequencies, in every series.

What is there acts everywhere by the same value; what only acts like it has one value here and another there. Each part
of an effect's footprint is given a value of its own, beside all else that is fitted (a score test of homogeneity: Rao
1948): what that gains is chi-square distributed where one value is enough.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from station.diagnosis.candidate import Estimate, Slopes
from station.diagnosis.effects import BY_ID
from station.diagnosis.likelihood import Problem

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

FALSE_ALARM: Final = 2e-4
"""Chance that an effect is called inhomogeneous that is not, over all effects and ways of parting them."""
MUCH: Final = 0.1
"""Of its value, by which the parts differ (root mean square) where that is of consequence: the linear model of a small
change, from which the parts are told, is off by some per cent where effects are large."""
LEAST_SEEN: Final = 0.02
"""Share of what is known of an effect, that a series must show to be a part."""


class Inhomogeneous(NamedTuple):
    """An effect that is not the same everywhere."""

    effect: str
    parts: tuple[tuple[str, float], ...]
    """Where, and the value there, SI."""
    log_p: float
    """Of parts that differ as much by chance."""

    @property
    def words(self) -> str:
        values = ", ".join(f"{BY_ID[self.effect].signed(x)} by {where}" for where, x in self.parts)
        return f"{self.effect} is not the same everywhere ({values})"


def inhomogeneous(problem: Problem, e: Estimate) -> tuple[Inhomogeneous, ...]:
    """Which of an estimate's effects have not one value, and the way of parting that shows it best."""
    tests = [test for i in range(len(e.state.values)) for test in _tests(problem, e, i)]
    worst: dict[str, Inhomogeneous] = {}
    for test, spread in tests:
        here = worst.get(test.effect)
        if spread > MUCH and test.log_p < math.log(FALSE_ALARM / len(tests)) and (not here or test.log_p < here.log_p):
            worst[test.effect] = test
    return tuple(worst.values())


def _tests(problem: Problem, e: Estimate, i: int) -> Iterator[tuple[Inhomogeneous, float]]:
    """Of the i-th effect, in each way of parting it: how unlikely the parts are, and their spread over the value."""
    s, name = e.state, e.state.ids[i]
    others = [_some(x, [j for j in range(len(x.bins)) if j != i]) for x in e.slopes]
    for names, parts in _partings(problem, e, i):
        count = len(names)
        made = [rest.after(own) for rest, own in zip(others, parts, strict=True)]
        solved = problem.solve(s, problem.normal(s, made), len(s.values) - 1 + count)
        values = s.values[name] + solved.step[:count]
        weights = 1 / np.diag(solved.covariance)[:count]
        centre = float(np.average(values, weights=weights))
        spread = math.sqrt(float(np.average((values - centre) ** 2, weights=weights)))
        shown = tuple(zip(names, values.tolist(), strict=True))
        log_p = float(chi2.logsf(solved.gained, count - 1))
        yield Inhomogeneous(name, shown, log_p), spread / abs(s.values[name] - BY_ID[name].null)


def _some(x: Slopes, which: Sequence[int]) -> Slopes:
    return Slopes(x.bins[which], x.steady[which], x.response[which])


def _partings(problem: Problem, e: Estimate, i: int) -> Iterator[tuple[list[str], list[Slopes]]]:
    """Names of parts, and slopes of each for every manoeuvre."""
    manoeuvres, axis = problem.manoeuvres, problem.axis
    if len(manoeuvres) > 1:
        every = [[np.full(len(m.setting.judged), k == part) for part in range(len(manoeuvres))]
                 for k, m in enumerate(manoeuvres)]  # fmt: skip
        yield (
            [m.record.name for m in manoeuvres],
            [_by_series(x, i, own) for x, own in zip(e.slopes, every, strict=True)],
        )
    shown = [
        np.abs(np.linalg.solve(root, x.bins[i].T[..., None])[..., 0]) ** 2
        for root, x in zip(e.state.roots, e.slopes, strict=True)
    ]
    f = np.concatenate([m.setting.frequencies for m in manoeuvres])
    order = np.argsort(f)
    known = np.cumsum(np.concatenate(shown).sum(1)[order])
    middle = float(f[order][np.searchsorted(known, 0.5 * known[-1])])
    names = [f"what is below {middle:.2g} Hz", "what is above it"]
    yield names, [_by_frequency(x, i, m.setting.frequencies < middle, m.grouped.pick)
                  for m, x in zip(manoeuvres, e.slopes, strict=True)]  # fmt: skip
    own = np.zeros(len(axis.series))
    for m, root, x in zip(manoeuvres, e.state.roots, e.slopes, strict=True):
        for row, j in enumerate(m.setting.judged):
            alone = np.linalg.inv(root)[:, :, row] * x.bins[i, row][:, None]
            own[j] += float((np.abs(alone) ** 2).sum())
    seen = np.flatnonzero(own > LEAST_SEEN * own.sum())
    if len(seen) > 1:
        yield (
            [axis.series[j] for j in seen],
            [
                _by_series(x, i, [np.array(m.setting.judged) == j for j in seen])
                for m, x in zip(manoeuvres, e.slopes, strict=True)
            ],
        )


def _by_series(x: Slopes, i: int, parts: Sequence[Bools]) -> Slopes:
    """The i-th slopes in parts, each of some of the series."""
    which = np.array(parts)
    return Slopes(which[:, :, None] * x.bins[i], which * x.steady[i], which[:, None, :, None] * x.response[i])


def _by_frequency(x: Slopes, i: int, low: Bools, pick: NDArray[np.int64]) -> Slopes:
    """The i-th slopes in two parts; what is steady is of the lower."""
    which = np.array([low, ~low])
    return Slopes(
        which[:, None, :] * x.bins[i],
        np.array([[1.0], [0.0]]) * x.steady[i],
        which[:, pick, None, None] * x.response[i],
    )
