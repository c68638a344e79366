"""Which effects might be there, and how large: the linear model about an estimate."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.candidate import Estimate, Normal, Slopes, State, without_first
from station.diagnosis.effects import BY_ID
from station.diagnosis.likelihood import Problem
from station.diagnosis.term import Term

Array = NDArray[np.float64]

LEAST_SHARE: Final = 0.015
"""Of what moves in a series: an effect that changes none by as much is within what any linear model misses in step with
the motion, and which no length of record averages out."""
LEAST_TIME: Final = 0.05
"""Delays and lags below this share of the sampling interval are not judged: large corrections leave such traces."""


ALIKE: Final = 0.98
"""Correlation of two effects' slopes beside all else, from which one may stand in the other's place: it then costs a
twenty-fifth of what the other explains."""


Start = tuple[float, tuple[str, ...], dict[str, float], Array]
"""Reduction of the linear model, effects, their values, and the free parameters then."""


def own_first(s: State, terms: Sequence[Term]) -> list[Term]:
    """A state's effects, then the others."""
    return [*(BY_ID[i] for i in s.ids), *(t for t in terms if t.id not in s.values)]


def screened(
    problem: Problem, about: Estimate, terms: Sequence[Term], made: Sequence[Slopes]
) -> tuple[list[tuple[float, str, float]], dict[int, list[Start]]]:
    """On top of an estimate, by the linear model there: every further effect alone, and every pair where the estimate
    has none. `made`: slopes of its effects, then of the others."""
    s = about.state
    every = own_first(s, terms)
    m, n = len(s.values), len(every)
    normal = problem.normal(s, [f.after(e) for f, e in zip(free_slopes_of(about), made, strict=True)])
    matrix, gradient = _regular(problem, normal, s, n)
    free = np.arange(n, len(gradient))
    inner = matrix[np.ix_(free, free)]
    solved = np.linalg.solve(inner, np.concatenate([matrix[free, :n], gradient[free, None]], axis=1))
    schur = matrix[:n, :n] - matrix[:n, free] @ solved[:, :n]
    right = gradient[:n] - matrix[:n, free] @ solved[:, n]
    found: dict[int, list[Start]] = {1: [], 2: []}
    values = np.array([s.values.get(t.id, t.null) for t in every])

    def start(picked: tuple[int, ...]) -> Start:
        pick = np.array([*range(m), *picked])
        part, slope = schur[np.ix_(pick, pick)], right[pick]
        # A bent effect is as large as its probe: of others the linear model says nothing.
        bent = np.array([i >= m and bool(every[i].probes) for i in pick])
        x = np.where(bent, [every[i].step for i in pick], 0.0)
        rest = np.flatnonzero(~bent)
        if len(rest):
            x[rest] = -np.linalg.lstsq(part[np.ix_(rest, rest)], (slope + part @ x)[rest], rcond=1e-10)[0]
        there = {every[i].id: float(v) for i, v in zip(pick, values[pick] + x, strict=True)}
        moved = -solved[:, n] - solved[:, pick] @ x
        return float(-(2 * slope + part @ x) @ x), tuple(there), there, s.a + moved

    found[1] = _best(start((m + j,)) for j in range(n - m))
    if not m:
        couples = itertools.combinations(range(n), 2)
        found[2] = _best(start((i, j)) for i, j in couples if every[i].id != every[j].id)
    singles = [(gain, ids[-1], there[ids[-1]]) for gain, ids, there, _ in found[1]]
    return singles, found


def substitutes(
    problem: Problem, about: Estimate, terms: Sequence[Term], made: Sequence[Slopes]
) -> list[tuple[tuple[str, ...], dict[str, float], Array]]:
    """An estimate's effects with one of them replaced by another that acts as it does beside the rest, by the linear
    model there; with values and free parameters. `made` as of `screened`."""
    s = about.state
    every = own_first(s, terms)
    m, n = len(s.values), len(every)
    matrix, _ = _regular(
        problem, problem.normal(s, [f.after(e) for f, e in zip(free_slopes_of(about), made, strict=True)]), s, n
    )
    out = []
    for i in range(m):
        rest = np.array([*(k for k in range(m) if k != i), *range(n, len(matrix))])
        both = np.array([i, *range(m, n)])
        beside = np.linalg.solve(matrix[np.ix_(rest, rest)], matrix[np.ix_(rest, both)])
        alone = matrix[np.ix_(both, both)] - matrix[np.ix_(both, rest)] @ beside
        for j, t in enumerate(every[m:], 1):
            if t.probes or alone[0, j] ** 2 <= ALIKE**2 * alone[0, 0] * alone[j, j]:  # or it shows nowhere
                continue
            values = {k: v for k, v in s.values.items() if k != every[i].id}
            values[t.id] = t.null + (s.values[every[i].id] - every[i].null) * float(alone[0, j] / alone[j, j])
            out.append((tuple(values), values, s.a))
    return out


def hopeful(starts: Sequence[Start], count: int) -> list[Start]:
    """The first `count`, and what is too bent for the linear model to tell how much it gains."""
    return [s for k, s in enumerate(starts) if k < count or BY_ID[s[1][-1]].probes]


def _best(starts: Iterable[Start]) -> list[Start]:
    """The best first, each set of effects once."""
    made: dict[frozenset[str], Start] = {}
    for start in sorted(starts, key=lambda f: (-f[0], f[1])):
        made.setdefault(frozenset(start[1]), start)
    return list(made.values())


def free_slopes_of(e: Estimate) -> list[Slopes]:
    """The slopes of an estimate's free parameters alone."""
    return without_first(e.slopes, len(e.state.values))


def _regular(problem: Problem, normal: Normal, s: State, effects: int) -> tuple[Array, Array]:
    """Normal matrix and gradient with the priors; the noise in the slopes left in: a screening may be blunt."""
    penalty = np.concatenate([np.zeros(effects), problem.known])
    gradient = normal.gradient + penalty * np.concatenate([np.zeros(effects), s.a])
    return normal.seen + np.diag(penalty) + 1e-9 * np.diag(np.diag(normal.seen)), gradient


def changes(problem: Problem, s: State, slopes: Sequence[Slopes]) -> Array:
    """(p, series) by how much of what moves in each series a unit of each parameter of `slopes` changes it, the most of
    all manoeuvres."""
    found = np.zeros((len(slopes[0].bins), len(problem.manoeuvres[0].setting.judged)))
    for m, response, own in zip(problem.manoeuvres, s.responses, slopes, strict=True):
        changed = np.sqrt((np.abs(own.bins) ** 2).mean(-1))
        found = np.maximum(found, changed / np.maximum(m.motion(response), 1e-12))
    return found


def whole_changes(problem: Problem, s: State, terms: Sequence[Term]) -> Array:
    """(effects, series) by how much of what moves in each series effects of a state change it, all of them."""
    # A bent effect changes where it is by more than it did on the way there.
    whole = [replace(t, step=t.null - s.values[t.id]) for t in terms]
    return changes(problem, s, problem.effect_slopes(s, whole)) * np.abs([[t.step] for t in whole])


def least_judged(problem: Problem, s: State, terms: Sequence[Term], slopes: Sequence[Slopes]) -> dict[str, float]:
    """The sizes below which effects, of `slopes`, are not judged, SI."""
    tick = LEAST_TIME * max(m.recorded.dt for m in problem.manoeuvres)
    shares = changes(problem, s, slopes).max(-1)

    def least(t: Term, share: float) -> float:
        if t.probes:
            return t.least
        noise = max(m.noise(t.target) for m in problem.manoeuvres) if t.least_in_noise else 0.0
        return max(t.least, tick if t.unit == "s" else 0.0, t.least_in_noise * noise, LEAST_SHARE / max(share, 1e-12))

    return {t.id: least(t, float(x)) for t, x in zip(terms, shares, strict=True)}
