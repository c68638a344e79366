"""Which effects: every one alone, every pair, then more, each refitted; accepted by the deviance reduction."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.effects import BY_ID, Term
from station.diagnosis.fit import Fit, Problem, price

Array = NDArray[np.float64]
Start = tuple[float, tuple[str, ...], dict[str, float]]
"""The deviance reduction of a candidate's linear model, its effects and their values."""

FIRST: Final = 18.0
"""Deviance reduction asked for one effect: one false alarm in 200 clean flights."""
FURTHER: Final = 18.0
FURTHER_SHARE: Final = 0.03
"""A further effect must also gain this share of what the first did: large corrections are never perfect."""
CONFOUNDED: Final = 6.0
"""Candidates of one size within this deviance of the best are confounded with it."""
SINGLES: Final = 7
PAIRS: Final = 12
PARTNERS: Final = 4
HOPEFUL: Final = 0.5
"""Share of the deviance reduction asked of a second effect that a pair's linear model must reach to be refitted."""
MOST: Final = 4
"""Effects at once."""
LEAST_TIME: Final = 0.05
"""Delays and lags below this share of the sampling interval are not judged: large corrections leave such traces."""


@dataclass(frozen=True, slots=True)
class Found:
    """Outcome of a search: what is accepted, what could be instead, and everything refitted on the way."""

    null: Fit
    accepted: Fit
    alternatives: tuple[Fit, ...]
    singles: tuple[Fit, ...]
    """Each effect alone, the best first; those not refitted have their linear estimate."""
    refitted: Mapping[frozenset[str], Fit] = field(default_factory=dict)
    screened: float = 0.0
    """Cost without effects, that the singles compare with."""

    @property
    def reduction(self) -> float:
        return self.null.cost - self.accepted.cost

    def not_accepted(self) -> list[tuple[str, float, float]]:
        """Effects that were not accepted: id, the value that each takes alone, and its deviance reduction then."""
        return [
            (f.ids[0], f.values[f.ids[0]], max(self.screened - f.cost, 0.0))
            for f in self.singles
            if f.ids[0] not in self.accepted.values and math.isfinite(f.cost)
        ]


def least_judged(problem: Problem, terms: Sequence[Term]) -> dict[str, float]:
    """The sizes below which effects are not judged, SI."""
    tick = LEAST_TIME * max(r.record.dt for r in problem.references)

    def least(t: Term) -> float:
        noise = max(r.noise.get(t.target, 0.0) for r in problem.references)
        return max(t.least, tick if t.unit == "s" else 0.0, t.least_in_noise * noise)

    return {t.id: least(t) for t in terms}


class _Refits:
    """Candidates refitted so far, each once; those of a size that is not judged cost infinitely much."""

    def __init__(self, problem: Problem, terms: Sequence[Term]) -> None:
        self.problem, self.fits = problem, dict[frozenset[str], Fit]()
        self._least = least_judged(problem, terms)

    def add(self, ids: tuple[str, ...], start: Mapping[str, float], gust: Sequence[float]) -> None:
        key = frozenset(ids)
        if key not in self.fits:
            found = self.problem.refit(ids, start, gust)
            small = any(abs(found.values[i]) < self._least.get(i, 0.0) for i in ids)
            self.fits[key] = replace(found, cost=math.inf) if small else found

    def of_size(self, size: int) -> list[Fit]:
        """Those of so many effects, the best first."""
        fits = [f for ids, f in self.fits.items() if len(ids) == size and math.isfinite(f.cost)]
        return sorted(fits, key=lambda f: (f.cost, f.ids))


def search(
    problem: Problem,
    terms: Sequence[Term],
    progress: Callable[[str], None] = lambda _: None,
    asked: float = FIRST,
) -> Found:
    """Names of the effects that the records ask for, or none; `asked` is the deviance reduction asked of the first
    effect, and at least of each further one."""
    null = problem.null()
    base = problem.at({})
    refits = _Refits(problem, terms)
    progress(f"screening {len(terms)} effects")
    linear = [_screened(problem, term, base, null) for term in terms]
    for fit in sorted(linear, key=lambda f: f.cost)[:SINGLES]:
        refits.add(fit.ids, fit.values, fit.gust)
    singles = sorted((refits.fits.get(frozenset(f.ids), f) for f in linear), key=lambda f: (f.cost, f.ids))
    accepted = null
    if singles and frozenset(singles[0].ids) in refits.fits and null.cost - singles[0].cost > asked:
        progress("pairs of effects")
        screened = max(null.cost - fit.cost for fit in linear)
        pairs = [(gain - screened, ids, start) for gain, ids, start in _pairs(problem, terms, null, base)[:PAIRS]]
        accepted = _one_or_two(refits, terms, singles, pairs, max(asked, FURTHER_SHARE * (null.cost - singles[0].cost)))
        while 1 < len(accepted.values) < MOST:
            progress(f"{len(accepted.values) + 1} effects")
            for _, ids, start in _partners(problem, terms, accepted)[:PARTNERS]:
                refits.add(ids, start, accepted.gust)
            more = refits.of_size(len(accepted.values) + 1)
            threshold = max(asked, FURTHER_SHARE * (null.cost - accepted.cost))
            if not more or accepted.cost - more[0].cost <= threshold:
                break
            accepted = more[0]
    alternatives: tuple[Fit, ...] = ()
    if accepted.values:
        # How rare an effect is decides what is named first, not what is confounded.
        best_bare = accepted.cost - price(accepted.ids)
        alternatives = tuple(
            f
            for f in refits.of_size(len(accepted.values))
            if f is not accepted and f.cost - price(f.ids) - best_bare < CONFOUNDED
        )
    return Found(null, accepted, alternatives, tuple(singles), refits.fits, null.cost)


def _one_or_two(
    refits: _Refits, terms: Sequence[Term], singles: Sequence[Fit], pairs: list[Start], asked: float
) -> Fit:
    """The best single effect, or the best pair where it explains more by what is `asked` of a second effect. `pairs` by
    what they promise beyond the best single."""
    best = singles[0]
    for single in [s for s in singles[:2] if frozenset(s.ids) in refits.fits]:
        behind = single.cost - best.cost
        partners = _partners(refits.problem, terms, single)[:PARTNERS]
        pairs = [*pairs, *((gain - behind, ids, start) for gain, ids, start in partners)]
    for gain, ids, start in pairs:
        if gain > HOPEFUL * asked:
            refits.add(ids, start, best.gust)
    doubles = refits.of_size(2)
    if not doubles or best.cost - doubles[0].cost <= asked:
        return best
    for _, ids, start in pairs:  # it may have alternatives
        refits.add(ids, start, best.gust)
    return doubles[0]


def _screened(problem: Problem, term: Term, base: list[Array], null: Fit) -> Fit:
    """One effect's linear estimate from nothing, the gust re-estimated."""
    columns = [c[None] for c in problem.effect_columns(term, {}, base)]
    x, inverse, gust, cost = problem.solve(base, columns, problem.nuisance_columns({}, base), null.gust, 3)
    cost += term.price
    value = min(max(float(x[0]), term.low), term.high)
    if value != float(x[0]) and term.low == 0:
        cost = max(cost, null.cost)  # an effect of one sign only, and the data want the other
    return Fit({term.id: value}, {term.id: math.sqrt(max(inverse[0, 0], 0.0))}, x[1:], gust, cost)


def _pairs(problem: Problem, terms: Sequence[Term], null: Fit, base: list[Array]) -> list[Start]:
    """Every pair by the deviance reduction of its linear model, the largest first, with both values."""
    columns = [problem.effect_columns(t, {}, base) for t in terms]
    nuisances = problem.nuisance_columns({}, base)
    normal, right = _projected(problem, base, columns, nuisances, null.gust)
    found: list[Start] = []
    for i, j in itertools.combinations(range(len(terms)), 2):
        pick = np.array([i, j])
        a, b = normal[np.ix_(pick, pick)], right[pick]
        determinant = a[0, 0] * a[1, 1] - a[0, 1] ** 2
        if determinant <= 1e-4 * a[0, 0] * a[1, 1]:
            continue
        x = np.linalg.solve(a, b)
        found.append((float(b @ x), (terms[i].id, terms[j].id), {terms[i].id: x[0], terms[j].id: x[1]}))
    found.sort(key=lambda f: (-f[0], f[1]))
    return found


def _projected(
    problem: Problem, y: list[Array], columns: list[list[Array]], nuisances: list[Array], gust: Sequence[float]
) -> tuple[Array, Array]:
    """Normal equations of effects with the nuisances eliminated."""
    e, a = len(columns), len(nuisances[0])
    whole, right = np.zeros((e + a, e + a)), np.zeros(e + a)
    for k, data in enumerate(y):
        stacked = np.concatenate([np.stack([c[k] for c in columns]), nuisances[k]])
        weighted = stacked * (problem.counts[k] / (1 + gust[k] ** 2 * problem.shares[k]))
        whole += weighted @ stacked.T
        right -= weighted @ data
    inner = whole[e:, e:] + np.eye(a)
    solved = np.linalg.solve(inner, np.concatenate([whole[e:, :e], right[e:, None]], axis=1))
    return whole[:e, :e] - whole[:e, e:] @ solved[:, :e], right[:e] - whole[:e, e:] @ solved[:, e]


def _partners(problem: Problem, terms: Sequence[Term], about: Fit) -> list[Start]:
    """What else, on top of a candidate, its columns made anew there: the largest further linear reduction first."""
    here = problem.at(about.values)
    own = [problem.effect_columns(BY_ID[i], about.values, here) for i in about.values]
    others = [t for t in terms if t.id not in about.values]
    columns = [problem.effect_columns(t, about.values, here) for t in others]
    nuisances = problem.nuisance_columns(about.values, here)
    normal, right = _projected(problem, here, own + columns, nuisances, about.gust)
    m = len(own)
    found: list[Start] = []
    for j in range(len(others)):
        pick = np.array([*range(m), m + j])
        x = np.linalg.lstsq(normal[np.ix_(pick, pick)], right[pick], rcond=1e-10)[0]
        start = {i: v + float(x[n]) for n, (i, v) in enumerate(about.values.items())}
        start[others[j].id] = float(x[m])
        found.append((float(right[pick] @ x), (*about.values, others[j].id), start))
    found.sort(key=lambda f: (-f[0], f[1]))
    return [(gain, tuple(sorted(ids)), start) for gain, ids, start in found]
