"""Which effects: every one alone, every pair, then more, each refitted; accepted by the deviance reduction."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.candidate import Estimate, Slopes, State
from station.diagnosis.effects import BY_ID
from station.diagnosis.free_parameters import BEYOND
from station.diagnosis.likelihood import Problem
from station.diagnosis.screening import (
    LEAST_SHARE,
    hopeful,
    least_judged,
    own_first,
    screened,
    substitutes,
    whole_changes,
)
from station.diagnosis.term import Term

Array = NDArray[np.float64]

ASKED: Final = 13.4
"""Deviance reduction asked of each effect: by chance one of some forty that are about independent gains as much in one
clean flight of a hundred; what is named must besides lower the error of data held out."""
FURTHER_SHARE: Final = 0.03
"""A further effect must also gain this share of what the first did, and a rival be worse by as much: large corrections
are never perfect, and what a model misses takes one side or the other."""
CONFOUNDED: Final = 6.0
"""Candidates of one size within this deviance of the best are confounded with it, at least."""
HUGE: Final = 1000.0
"""Deviance reduction of an effect without which the first fit may have ended in a minimum of its own: it is fitted from
the profile on too, as are the best where that fit has constants farther from the profile's than its doubt lets expect.
"""
SHORT: Final = 4 * CONFOUNDED
"""Of the accepted's deviance: as near, a candidate that was left after few steps may yet be confounded with it (the
slopes it steps by are those of no effect)."""
RIVAL_SHARE: Final = 0.1
"""Of the best's deviance reduction: candidates nearer than this may yet overtake it when fitted to the end."""
SINGLES: Final = 5
PAIRS: Final = 5
MORE: Final = 3
MOST: Final = 4
"""Effects at once."""
REFITS: Final = 4
WHOLE: Final = 4
"""Steps of a candidate with the free parameters' slopes of none, and of the accepted with its own."""
HOPEFUL: Final = 0.5
"""Share of the deviance asked of a second effect that a pair's linear model must reach to be refitted."""


@dataclass(frozen=True, slots=True)
class Found:
    """Outcome of a search: what is accepted, what could be instead, and every effect alone."""

    null: Estimate
    accepted: Estimate
    alternatives: tuple[Estimate, ...]
    singles: tuple[tuple[float, str, float], ...]
    """Deviance reduction, effect and value, the largest first."""
    tried: dict[frozenset[str], Estimate]
    slopes: Sequence[Slopes]
    """Of every effect that is not bent, at `null`'s first fit, by manoeuvre."""
    terms: tuple[Term, ...] = ()
    """What was looked for."""
    beyond: tuple[tuple[str, float], ...] = ()
    """Effects, and the end of their range there, that explain clearly more than what is accepted, but only beyond what
    is physical."""

    @property
    def reduction(self) -> float:
        return self.null.cost - self.accepted.cost


class _Refits:
    """Candidates refitted so far, each once; those of a size that is not judged, or not physical, cost infinitely
    much."""

    def __init__(self, problem: Problem, null: Estimate, least: Mapping[str, float]) -> None:
        self.problem, self.null, self._least = problem, null, least
        self.done: dict[frozenset[str], Estimate] = {}
        self._ended: dict[frozenset[str], Estimate] = {}
        """As they were when fitted to the end."""
        self._from_profile: set[frozenset[str]] = set()
        self._at_end: dict[str, tuple[float, int, float]] = {}
        """Cost, effects in all, and value of those at an end of their range, each at its best."""

    def add(self, ids: Sequence[str], values: Mapping[str, float], a: Array, again: bool = False) -> Estimate:
        """A candidate from a start; `again`: even if it was refitted before, and the better of both."""
        key = frozenset(ids)
        before = self.done.get(key) if ids else self.null
        if before is not None and not again:
            return before
        p, free = self.problem, self.null.slopes
        terms = [BY_ID[i] for i in ids]
        start = {t.id: min(max(values[t.id], t.low), t.high) for t in terms}

        def slopes(s: State) -> tuple[list[Slopes], Sequence[Term]]:
            if not terms:
                return free, terms
            return [f.after(e) for f, e in zip(p.renewed(s, free), p.effect_slopes(s, terms), strict=True)], terms

        # A candidate that can be neither the best of its size nor a rival need not be fitted to the end.
        rivals = [] if again else [e.cost for e in self.of_size(len(ids))]
        beaten = min(rivals, default=math.inf) + CONFOUNDED
        here = self._start(terms, start, a)
        if here is None:
            if before is None:
                before = self.done[key] = replace(self.null, cost=math.inf)
            return before
        found = p.estimate(here, REFITS, slopes, beaten=beaten)
        found = self._judged(found)
        if before is not None and before.cost < found.cost:
            found = before
        if ids:
            self.done[key] = found
        return found

    def _start(self, terms: Sequence[Term], values: Mapping[str, float], a: Array) -> State | None:
        """The linear model's state; or where that is worse than the best with fewer of the effects, that, from which
        steps are damped as far as they must be; None where neither can be had."""
        p, ids = self.problem, {t.id for t in terms}
        fewer = min(
            (e for e in (self.null, *self.done.values()) if ids > set(e.state.ids)), key=lambda e: e.cost, default=None
        )
        try:
            here = p.relevelled(p.state(values, a, self.null.state.levels))
        except np.linalg.LinAlgError:  # so far off that its noise cannot be told
            here = None
        if fewer is None or (here is not None and p.cost(here) < fewer.cost):
            return here
        added = [t for t in terms if t.id not in fewer.state.values]
        if any(t.probes for t in added):  # at nothing, a bent effect has no slope
            return here
        there = {t.id: fewer.state.values.get(t.id, t.null) for t in terms}
        return p.state(there, fewer.state.a, fewer.state.levels)

    def without(self, name: str, whole: Estimate) -> Estimate:
        """A candidate fitted without one of its effects, and without those that are nothing then."""
        left = tuple(i for i in whole.state.ids if i != name)
        while True:
            fewer = self.add(left, dict(whole.state.values), whole.state.a, again=True)
            if math.isfinite(fewer.cost):
                return fewer
            left = tuple(i for i in fewer.state.ids if not self._is_nothing(BY_ID[i], fewer.state))

    def fit_to_the_end(self, e: Estimate) -> None:
        """A candidate again from where it is, all slopes made anew, but once."""
        key = frozenset(e.state.ids)
        if self._ended.get(key) is not e:
            self.done[key] = self._ended[key] = self._judged(self.problem.estimate(e.state, WHOLE, self.problem.whole))

    def fit_from_profile(self, values: Mapping[str, float]) -> None:
        """A candidate fitted from the profile on, from these values, in place of the one there if it is better. To the
        end: on the way there the truth too promises less than constants that have taken its place."""
        key = frozenset(values)
        self._from_profile.add(key)
        start = {i: min(max(x, BY_ID[i].low), BY_ID[i].high) for i, x in values.items()}
        try:
            found = self._judged(self.problem.from_profile(start))
        except np.linalg.LinAlgError:  # so far off that its noise cannot be told
            return
        if key not in self.done or found.cost < self.done[key].cost:
            self.done[key] = found

    def was_from_profile(self, e: Estimate) -> bool:
        """Whether a candidate was fitted from the profile on."""
        return frozenset(e.state.values) in self._from_profile

    def beyond(self, accepted: Estimate) -> tuple[tuple[str, float], ...]:
        """Effects at an end of their range that explain clearly more than what is accepted: whatever that is, it is not
        what the data hold."""
        size = len(accepted.state.values)
        return tuple(
            (name, value)
            for name, (cost, more, value) in sorted(self._at_end.items())
            if accepted.cost - cost > CONFOUNDED + ASKED * max(more - size, 0)
        )

    def _judged(self, found: Estimate) -> Estimate:
        for i, value in found.state.values.items():
            if BY_ID[i].at_end(value) and found.cost < self._at_end.get(i, (math.inf,))[0]:
                self._at_end[i] = found.cost, len(found.state.values), value
        if any(self._is_nothing(BY_ID[i], found.state) for i in found.state.ids):
            return replace(found, cost=math.inf)
        return found

    def _is_nothing(self, t: Term, s: State) -> bool:
        """Whether an effect is of a size that is not judged."""
        value = s.values[t.id]
        small = abs(value - t.null) < self._least.get(t.id, 0.0)
        return small or t.at_end(value) or bool(t.probes and whole_changes(self.problem, s, [t]).max() < LEAST_SHARE)

    def of_size(self, size: int) -> list[Estimate]:
        found = [e for ids, e in self.done.items() if len(ids) == size and math.isfinite(e.cost)]
        return sorted(found, key=lambda e: (e.cost, e.state.ids))


def search(problem: Problem, terms: Sequence[Term], progress: Callable[[str], None] = lambda _: None) -> Found:
    """Names of the effects that the records ask for, or none."""
    progress("fitting the aircraft")
    null = problem.null()
    progress(f"screening {len(terms)} effects")
    terms = [x for t in terms for x in t.tried]
    slopes = problem.effect_slopes(null.state, terms)
    refits = _Refits(problem, null, least_judged(problem, null.state, terms, slopes))
    singles = _one_and_two(problem, refits, terms, slopes, progress)
    accepted = _settled(problem, refits, _several(problem, refits, terms, progress), progress)
    if accepted.state.values:
        accepted = _rivalled(problem, refits, accepted, terms, progress)
    alternatives = tuple(e for e in _others(refits, accepted) if e.cost - accepted.cost < _apart(refits, accepted))
    beyond = refits.beyond(accepted)
    accepted = problem.answered(accepted)
    plain = [k for k, t in enumerate(terms) if not t.probes]
    slopes = [Slopes(x.bins[plain], x.steady[plain], x.response[plain]) for x in slopes]
    return Found(refits.null, accepted, alternatives, tuple(singles), refits.done, slopes, tuple(terms), beyond)


def _one_and_two(
    problem: Problem,
    refits: _Refits,
    terms: Sequence[Term],
    slopes: Sequence[Slopes],
    progress: Callable[[str], None],
) -> list[tuple[float, str, float]]:
    """Refit the hopeful among single effects and pairs; every effect alone by the linear model."""
    null = refits.null
    singles, starts = screened(problem, null, terms, slopes)
    for _, ids, values, a in hopeful(starts[1], SINGLES):
        refits.add(ids, values, a)
    if null.strained:
        # Constants that have taken an effect's place do not give it back step by step, and hide which one it is.
        there = problem.at_profile()
        own = screened(problem, there, terms, problem.effect_slopes(there.state, terms))[1][1]
        for _, _, values, _ in (*own[:MORE], *starts[1][:1]):
            refits.fit_from_profile(values)
    likely = [s for s in starts[2] if s[0] > 2 * ASKED and s[0] - singles[0][0] > HOPEFUL * ASKED]
    if likely:
        progress("pairs of effects")
    for _, ids, values, a in likely[:PAIRS]:
        refits.add(ids, values, a)
    return singles


def _several(problem: Problem, refits: _Refits, terms: Sequence[Term], progress: Callable[[str], None]) -> Estimate:
    """As many effects as gain what is asked of each."""
    null = accepted = refits.null
    for size in range(1, MOST + 1):
        if size > 1 and len(accepted.state.values) == size - 1:
            progress(f"{size} effects")
            made = problem.effect_slopes(accepted.state, own_first(accepted.state, terms))
            for _, ids, values, a in hopeful(screened(problem, accepted, terms, made)[1][1], MORE):
                refits.add(ids, values, a)
        best = _contended(refits, size, accepted.cost)[:1]
        steps = size - len(accepted.state.values)
        if best and accepted.cost - best[0].cost > steps * max(ASKED, FURTHER_SHARE * (null.cost - accepted.cost)):
            accepted = best[0]
        elif size > 1:
            break
    return accepted


def _contended(refits: _Refits, size: int, cost: float) -> list[Estimate]:
    """Candidates of one size, the best first; those that a few steps left close to the best, by what it gains on the
    `cost` with fewer effects, are fitted to the end."""
    found = refits.of_size(size)
    if found:
        best = found[0].cost
        near = RIVAL_SHARE * (cost - best)
        rivals = [e for e in found if e.cost - best < near][:MORE]
        if near > CONFOUNDED and len(rivals) > 1:
            for e in rivals:
                refits.fit_to_the_end(e)
            found = refits.of_size(size)
        if size == 1:
            # Constants far from the profile do what an effect would, and leave it no room where the fit begins there:
            # the best begins at the profile too.
            again = MORE if refits.null.strained else 1 if cost - best > HUGE else 0
            for e in found[:again]:
                refits.fit_to_the_end(e)
            found = refits.of_size(size)
            for e in found[: min(again, 1)]:
                if not refits.was_from_profile(e):
                    refits.fit_from_profile(e.state.values)
            found = refits.of_size(size)
    return found


def is_told(term: Term, value: float, sd: float) -> bool:
    """Whether an effect is clearly off by its own standard error too, for the deviance counts what the variances gain
    as well; and of a size that is physical."""
    return abs(value - term.null) > BEYOND * sd and not term.at_end(value)


def _settled(problem: Problem, refits: _Refits, accepted: Estimate, progress: Callable[[str], None]) -> Estimate:
    """With all slopes made anew; without the effects that are not needed, or not significant, then."""
    while accepted.state.values:
        progress(f"settling {', '.join(accepted.state.ids)}")
        whole = problem.estimate(accepted.state, WHOLE, problem.whole)
        refits.done[frozenset(whole.state.ids)] = whole
        weakest, least = "", math.inf
        for name in whole.state.ids:
            fewer = refits.without(name, whole)
            if not fewer.state.values and fewer.cost < refits.null.cost:
                refits.null = fewer
            if fewer.cost - whole.cost < least:
                weakest, least = name, fewer.cost - whole.cost
        sd = np.sqrt(np.diag(whole.solved.covariance))
        for value, (name, error) in zip(
            whole.state.values.values(), zip(whole.state.ids, sd, strict=False), strict=True
        ):
            if not is_told(BY_ID[name], value, error):
                weakest, least = name, 0.0
        if least > ASKED:
            return whole
        accepted = refits.without(weakest, whole)
    return refits.null


def _rivalled(
    problem: Problem,
    refits: _Refits,
    accepted: Estimate,
    terms: Sequence[Term],
    progress: Callable[[str], None],
) -> Estimate:
    """The accepted, or what is better when what acts as its effects do is put in their place, and those that few steps
    left near it are fitted to the end too."""
    for _ in range(MOST):
        made = problem.effect_slopes(accepted.state, own_first(accepted.state, terms))
        for ids, values, a in substitutes(problem, accepted, terms, made):
            refits.add(ids, values, a, again=True)
        near = max(SHORT, _apart(refits, accepted))
        for e in [e for e in _others(refits, accepted) if e.cost - accepted.cost < near][:MORE]:
            refits.fit_to_the_end(e)
        best = min(_others(refits, accepted), key=lambda e: e.cost, default=accepted)
        if best.cost >= accepted.cost:
            break
        accepted = _settled(problem, refits, best, progress)
        if not accepted.state.values:
            break
    return accepted


def _apart(refits: _Refits, accepted: Estimate) -> float:
    """Deviance by which a rival must be worse not to be what is there."""
    return max(CONFOUNDED, FURTHER_SHARE * (refits.null.cost - accepted.cost))


def _others(refits: _Refits, accepted: Estimate) -> list[Estimate]:
    """Candidates of the accepted's size, the best first; none where nothing is accepted."""
    found = refits.of_size(len(accepted.state.values)) if accepted.state.values else []
    return [e for e in found if frozenset(e.state.ids) != frozenset(accepted.state.ids)]


def rivals_of_constant(problem: Problem, found: Found, i: int) -> tuple[str, ...]:
    """Effects that would bring a free parameter, by its place, back to the profile: what a derivative that is named for
    being far from there may be instead."""
    e = found.accepted
    made = problem.effect_slopes(e.state, own_first(e.state, found.terms))
    far = float(e.state.a[i]) ** 2
    singles = screened(problem, e, found.terms, made)[1][1]
    return tuple(ids[-1] for _, ids, _, a in singles if abs(a[i]) < BEYOND and far - a[i] ** 2 > CONFOUNDED)
