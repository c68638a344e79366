"""Whether an effect has one value: in every manoeuvre, at low and at high frequencies, in every series.

What is there acts everywhere by the same value; what only acts like it has one value here and another there. Each part
of an effect's footprint is given a value of its own, beside all else that is fitted (a score test of homogeneity: Rao
1948): how far these are apart, over their covariance, is chi-square distributed where one value is enough.
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
from station.diagnosis.residuals import VANE

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Complex = NDArray[np.complex128]

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


class _Part(NamedTuple):
    """Of an effect in one manoeuvre: the series judged and the bins that it is of, and whether the steady part is."""

    rows: Bools
    bins: Bools
    steady: bool


def inhomogeneous(problem: Problem, e: Estimate, model_errs: bool) -> tuple[Inhomogeneous, ...]:
    """Which of an estimate's effects have not one value, and the way of parting that shows it best. `model_errs`:
    whether the model misses a share of a force: then what instruments say of each other is compared by itself."""
    tests = [test for i in range(len(e.state.values)) for test in _tests(problem, e, i, model_errs)]
    worst: dict[str, Inhomogeneous] = {}
    for test, spread in tests:
        here = worst.get(test.effect)
        if spread > MUCH and test.log_p < math.log(FALSE_ALARM / len(tests)) and (not here or test.log_p < here.log_p):
            worst[test.effect] = test
    return tuple(worst.values())


def _tests(problem: Problem, e: Estimate, i: int, model_errs: bool) -> Iterator[tuple[Inhomogeneous, float]]:
    """Of the i-th effect, in each way of parting it: how unlikely the parts are, and their spread over the value."""
    s, name = e.state, e.state.ids[i]
    others = [_some(x, [j for j in range(len(x.bins)) if j != i]) for x in e.slopes]
    known = [_known(root, x, i) for root, x in zip(s.roots, e.slopes, strict=True)]
    for names, parts in _partings(problem, known, model_errs and not BY_ID[name].aerodynamic):
        count = len(names)
        made = [
            rest.after(_parted(x, i, own, m.grouped.pick))
            for m, rest, x, own in zip(problem.manoeuvres, others, e.slopes, parts, strict=True)
        ]
        solved = problem.solve(s, problem.normal(s, made))
        values = s.values[name] + solved.step[:count]
        # What a value is uncertain by for the drive's sake, it is in each part for itself.
        inverse = np.linalg.inv(solved.covariance[:count, :count] + problem.unsure(BY_ID[name]) ** 2 * np.eye(count))
        apart = values - float(inverse.sum(0) @ values / inverse.sum())
        weights = np.diag(inverse)
        spread = math.sqrt(float(np.average((values - np.average(values, weights=weights)) ** 2, weights=weights)))
        shown = tuple(zip(names, values.tolist(), strict=True))
        log_p = float(chi2.logsf(apart @ inverse @ apart, count - 1))
        yield Inhomogeneous(name, shown, log_p), spread / abs(s.values[name] - BY_ID[name].null)


def _some(x: Slopes, which: Sequence[int]) -> Slopes:
    return Slopes(x.bins[which], x.steady[which], x.response[which])


def _known(root: Complex, x: Slopes, i: int) -> Array:
    """(bins, series) information of each series on the i-th effect."""
    alone = np.linalg.inv(root) * x.bins[i].T[:, None, :]
    return np.asarray((np.abs(alone) ** 2).sum(1))


def _partings(
    problem: Problem, known: Sequence[Array], by_instruments: bool
) -> Iterator[tuple[list[str], list[list[_Part]]]]:
    """Names of parts, and the parts for every manoeuvre. `by_instruments`: what shows in what instruments say of each
    other is compared there; the forces have parts that are not, the last, one for each manoeuvre."""
    manoeuvres, axis = problem.manoeuvres, problem.axis
    own = np.zeros(len(axis.series))
    for m, x in zip(manoeuvres, known, strict=True):
        own[list(m.setting.judged)] += x.sum(0)
    inertial = by_instruments and own[:VANE].sum() > LEAST_SEEN * own.sum()
    compared = np.arange(len(own)) < VANE if inertial else np.full(len(own), True)
    rows = [np.array(m.setting.judged) for m in manoeuvres]
    bins = [np.full(len(x), True) for x in known]
    rest = [
        [_Part(~compared[j] & (k == part), f, True) for part in range(len(manoeuvres)) if inertial]
        for k, (j, f) in enumerate(zip(rows, bins, strict=True))
    ]
    if len(manoeuvres) > 1:
        yield (
            [m.record.name for m in manoeuvres],
            [
                [*(_Part(compared[j] & (k == part), f, True) for part in range(len(manoeuvres))), *last]
                for k, (j, f, last) in enumerate(zip(rows, bins, rest, strict=True))
            ],
        )
    f = np.concatenate([m.setting.frequencies for m in manoeuvres])
    order = np.argsort(f)
    so_far = np.cumsum(np.concatenate([x[:, compared[j]].sum(1) for x, j in zip(known, rows, strict=True)])[order])
    middle = float(f[order][np.searchsorted(so_far, 0.5 * so_far[-1])])
    low = [m.setting.frequencies < middle for m in manoeuvres]
    yield (
        [f"what is below {middle:.2g} Hz", "what is above it"],
        [
            [_Part(compared[j], x, True), _Part(compared[j], ~x, False), *last]
            for j, x, last in zip(rows, low, rest, strict=True)
        ],
    )
    seen = np.flatnonzero(compared & (own > LEAST_SEEN * own.sum()))
    if len(seen) > 1:
        yield (
            [axis.series[j] for j in seen],
            [[*(_Part(of == j, f, True) for j in seen), *last] for of, f, last in zip(rows, bins, rest, strict=True)],
        )


def _parted(x: Slopes, i: int, parts: Sequence[_Part], pick: NDArray[np.int64]) -> Slopes:
    """The i-th slopes in parts."""
    rows, bins = np.array([p.rows for p in parts]), np.array([p.bins for p in parts])
    steady = np.array([[p.steady] for p in parts])
    return Slopes(
        rows[:, :, None] * bins[:, None, :] * x.bins[i],
        rows * steady * x.steady[i],
        bins[:, pick, None, None] * rows[:, None, :, None] * x.response[i],
    )
