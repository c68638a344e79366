"""Candidates refitted: from the linear model's start, from the profile on, to the end, and without one effect."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.candidate import Estimate, Slopes, State
from station.diagnosis.effects import BY_ID
from station.diagnosis.likelihood import ROUNDS, Problem
from station.diagnosis.screening import (
    LEAST_SHARE,
    Start,
    free_slopes_of,
    hopeful,
    least_judged,
    own_first,
    screened,
    whole_changes,
)
from station.diagnosis.side_by_side import each
from station.diagnosis.term import Term

Array = NDArray[np.float64]

ASKED: Final = 13.4
"""Deviance reduction asked of each effect: by chance one of some forty that are about independent gains as much in one
clean flight of a hundred; what is named must besides lower the error of data held out."""
CONFOUNDED: Final = 6.0
"""Candidates of one size within this deviance of the best are confounded with it, at least."""
SINGLES: Final = 5
MORE: Final = 3
"""Candidates that the linear model puts first, of one effect and of more: the true one is rarely further down."""
LEADING: Final = 2
"""Of these, fitted to the end: a few steps from the profile promise the true one most, or all but one."""
AT_ONCE: Final = 2
"""Candidates refitted side by side, on any number of processors: what those before cost tells when others are left."""
REFITS: Final = 4
"""Steps of a candidate with the free parameters' slopes of none."""


class Refits:
    """Candidates refitted so far, each once; those of a size that is not judged, or not physical, cost infinitely
    much."""

    def __init__(self, problem: Problem, null: Estimate, least: Mapping[str, float]) -> None:
        self.problem, self.null, self._least = problem, null, dict(least)
        self.done: dict[frozenset[str], Estimate] = {}
        self._ended: dict[frozenset[str], Estimate] = {}
        """As they were when fitted to the end."""
        self._begun: dict[frozenset[str], tuple[dict[str, float], Array]] = {}
        """Where the linear model began them."""
        self._from_profile: set[frozenset[str]] = set()
        self._at_end: dict[str, tuple[float, int, float]] = {}
        """Cost, effects in all, and value of those at an end of their range, each at its best."""
        self._too_small: dict[frozenset[str], tuple[Estimate, frozenset[str]]] = {}
        """At their best, those that are refused for nothing but effects of a size that is not judged, and which."""

    def add(self, starts: Iterable[tuple[Sequence[str], Mapping[str, float], Array]], again: bool = False) -> None:
        """Candidates, of effects that begin at values beside free parameters; `again`: even those refitted before, and
        the better of both."""
        starts = [s for s in starts if again or self._before(frozenset(s[0])) is None]
        for k in range(0, len(starts), AT_ONCE):
            self._add(starts[k : k + AT_ONCE], again)

    def _add(self, starts: Sequence[tuple[Sequence[str], Mapping[str, float], Array]], again: bool) -> None:
        p, calls = self.problem, []
        for ids, values, a in starts:
            key = frozenset(ids)
            start = _physical({i: values[i] for i in ids})
            self._begun[key] = start, a
            # A candidate that can be neither the best of its size nor a rival need not be fitted to the end.
            rivals = [] if again else [e.cost for e in self.of_size(len(ids))]
            here = self._start([BY_ID[i] for i in ids], start, a)
            if here is not None:
                calls.append((p, here, self.null.slopes, min(rivals, default=math.inf) + CONFOUNDED))
            elif key not in self.done:
                self.done[key] = replace(self.null, cost=math.inf)
        for found in each(_refitted, calls):
            self._better(self._judged(found))

    def _start(self, terms: Sequence[Term], values: Mapping[str, float], a: Array) -> State | None:
        """The linear model's state; or where that is worse than the best with fewer of the effects, that, from which
        steps are damped as far as they must be; None where neither can be had."""
        p, ids = self.problem, {t.id for t in terms}
        fewer = min(
            (e for e in (self.null, *self.done.values()) if ids > set(e.state.ids)), key=lambda e: e.cost, default=None
        )
        try:
            here = p.relevelled(p.beside(self.null.state, values, a))
        except np.linalg.LinAlgError:  # so far off that its noise cannot be told
            here = None
        if fewer is None or (here is not None and p.cost(here) < fewer.cost):
            return here
        added = [t for t in terms if t.id not in fewer.state.values]
        if any(t.probes for t in added):  # at nothing, a bent effect has no slope
            return here
        there = {t.id: fewer.state.values.get(t.id, t.null) for t in terms}
        return p.beside(fewer.state, there, fewer.state.a)

    def _better(self, found: Estimate) -> Estimate:
        """Of a candidate, or of none, and the same one fitted before."""
        key = frozenset(found.state.ids)
        before = self._before(key)
        if before is None or found.cost <= before.cost:
            before = found
        if key:
            self.done[key] = before
        else:
            self.null = before
        return before

    def _before(self, ids: frozenset[str]) -> Estimate | None:
        """A candidate as it was fitted before."""
        return self.done.get(ids) if ids else self.null

    def without(self, name: str, whole: Estimate) -> Estimate:
        """A candidate fitted without one of its effects, and without those that are nothing then."""
        left = tuple(i for i in whole.state.ids if i != name)
        while True:
            self.add([(left, whole.state.values, whole.state.a)], again=True)
            fewer = self._before(frozenset(left)) or self.null
            fewer = min(fewer, self._beside(whole, left, fewer.cost), key=lambda e: e.cost)
            if math.isfinite(fewer.cost):
                return fewer
            left = tuple(i for i in fewer.state.ids if not self._is_nothing(BY_ID[i], fewer.state))

    def _beside(self, whole: Estimate, left: Sequence[str], beaten: float) -> Estimate:
        """Some of a candidate's effects fitted from its constants on, by its own slopes: those of no effect may be far
        from there. In as many steps as promise a cost below `beaten`, for without an effect the constants that moved
        with it begin far off."""
        p, s = self.problem, whole.state
        try:
            here = p.relevelled(p.beside(s, {i: s.values[i] for i in left}, s.a))
        except np.linalg.LinAlgError:  # so far off that its noise cannot be told
            return replace(self.null, cost=math.inf)
        slopes = p.with_free(free_slopes_of(whole))
        return self._better(self._judged(p.estimate(here, ROUNDS, slopes, beaten=beaten)))

    def fit_the_promising(self, size: int, cost: float) -> None:
        """Fits to the end, of the candidates that a few steps left short of what is asked on `cost`, the one that
        promises most, if that is enough. It begins at the linear model's start, however bad that is: where an effect
        multiplies a constant that has taken its place, the way from none of it is bent, and steps that must each gain
        are short."""
        short = [e for e in self.of_size(size) if cost - e.cost <= ASKED < cost - _promised(e)]
        e = min(short, key=_promised, default=None)
        if e is None or (begun := self._begun.pop(frozenset(e.state.ids), None)) is None:
            return
        p = self.problem
        try:
            here = p.relevelled(p.beside(self.null.state, *begun))
            self._better(self._judged(p.estimate(here, ROUNDS, p.whole)))
        except np.linalg.LinAlgError:  # so far off that its noise cannot be told
            return

    def fit_those_ahead(self, size: int, cost: float) -> None:
        """Fits to the end, of the candidates that a few steps left behind the best, those that promise more than it has
        and than is asked on `cost`: a constant that has taken an effect's place hands it back slowly."""
        found = self.of_size(size)
        ahead = [e for e in found[1:] if _promised(e) < min(found[0].cost, cost - ASKED)]
        self.fit_to_the_end(sorted(ahead, key=_promised)[:LEADING])

    def fit_to_the_end(self, some: Sequence[Estimate]) -> None:
        """Candidates again from where they are, all slopes made anew, but once."""
        states = [e.state for e in some if self._ended.get(frozenset(e.state.ids)) is not e]
        for found in each(_to_the_end, [(self.problem, s) for s in states]):
            key = frozenset(found.state.ids)
            self.done[key] = self._ended[key] = self._judged(found)

    def fit_from_profile(self, values: Mapping[str, float]) -> None:
        """A candidate fitted from the profile on, in place of the one there if it is better. To the end: on the way
        there the truth too promises less than constants that have taken its place."""
        self._take_from_profile(values, _from_profile(self.problem, values))

    def _take_from_profile(self, ids: Iterable[str], found: Estimate | None) -> None:
        self._from_profile.add(frozenset(ids))
        if found is not None:
            self._better(self._judged(found))

    def begin_at_profile(self, about: Estimate, terms: Sequence[Term], starts: Mapping[int, Sequence[Start]]) -> None:
        """Further effects on top of an estimate, begun where its constants are still the profile's: constants that have
        taken an effect's place do not give it back step by step, and hide which one it is. A few steps, from where the
        linear models there and at the estimate, `starts`, see them, tell the hopeful."""
        p = self.problem
        there = p.at_profile(about.state.values)
        ordered = own_first(there.state, terms)
        made = p.effect_slopes(there.state, ordered)
        # By constants that are far off, an effect may change less of what moves than it does.
        least = least_judged(p, there.state, ordered, made)
        self._least |= {i: min(x, self._least.get(i, x)) for i, x in least.items()}
        own, free = screened(p, there, terms, made)[1], free_slopes_of(there)
        for size, first, here in ((1, SINGLES, hopeful(own[1], MORE)), (2, MORE, own[2][:1])):
            tried: dict[frozenset[str], Estimate] = {}
            steps = [(p, _physical(values), free) for _, _, values, _ in (*starts[size][:first], *here)]
            for e in each(_few_steps, steps):
                # An end that a few steps reach, more may leave.
                if e is not None and not any(self._is_small(BY_ID[i], e.state) for i in e.state.ids):
                    ids = frozenset(e.state.ids)
                    tried[ids] = min(e, tried.get(ids, e), key=_promised)
            leading = sorted(tried.values(), key=_promised)[:LEADING]
            fits = each(_from_profile, [(p, e.state.values, e.state) for e in leading if not self.was_from_profile(e)])
            for e in leading:
                if not self.was_from_profile(e):
                    self._take_from_profile(e.state.ids, next(fits))
                if self.at_ease(size + len(about.state.values), about.cost):
                    return

    def at_ease(self, size: int, cost: float) -> bool:
        """Whether the best of a size, which gains what is asked on `cost`, has constants that its doubt lets expect:
        then nothing has taken an effect's place any more."""
        return any(cost - e.cost > ASKED and not e.strained for e in self.of_size(size)[:1])

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

    def too_small(self, cost: float) -> tuple[tuple[Estimate, frozenset[str]], ...]:
        """Candidates with effects of a size that is not judged, which cost less than this as they are, the best first;
        and which effects that are."""
        return tuple(sorted((x for x in self._too_small.values() if x[0].cost < cost), key=lambda x: x[0].cost))

    def _judged(self, found: Estimate) -> Estimate:
        if _opposed(found.state.values):
            return replace(found, cost=math.inf)
        for i, value in found.state.values.items():
            if BY_ID[i].at_end(value) and found.cost < self._at_end.get(i, (math.inf,))[0]:
                self._at_end[i] = found.cost, len(found.state.values), value
        left = tuple(i for i in found.state.ids if not self._is_nothing(BY_ID[i], found.state))
        if len(left) == len(found.state.ids):
            return found
        # The others are themselves a candidate, begun elsewhere: what kept it in a minimum of its own may be gone.
        before = self._before(frozenset(left))
        if before is not None and math.isfinite(before.cost) and found.cost < before.cost - CONFOUNDED:
            self._beside(found, left, before.cost)
        key = frozenset(found.state.ids)
        small = key.difference(left)
        if all(self._is_small(BY_ID[i], found.state) for i in small):
            here = found, small
            self._too_small[key] = min(here, self._too_small.get(key, here), key=lambda x: x[0].cost)
        return replace(found, cost=math.inf)

    def _is_nothing(self, t: Term, s: State) -> bool:
        """Whether an effect is of a size that is not judged, or not physical."""
        return t.at_end(s.values[t.id]) or self._is_small(t, s)

    def _is_small(self, t: Term, s: State) -> bool:
        if abs(s.values[t.id] - t.null) < self._least.get(t.id, 0.0):
            return True
        return bool(t.probes and whole_changes(self.problem, s, [t]).max() < LEAST_SHARE)

    def of_size(self, size: int) -> list[Estimate]:
        found = [e for ids, e in self.done.items() if len(ids) == size and math.isfinite(e.cost)]
        return sorted(found, key=lambda e: (e.cost, e.state.ids))


def _refitted(p: Problem, here: State, free: Sequence[Slopes], beaten: float) -> Estimate:
    return p.estimate(here, REFITS, p.with_free(free), beaten=beaten)


def _to_the_end(p: Problem, here: State) -> Estimate:
    return p.estimate(here, ROUNDS, p.whole)


def _few_steps(p: Problem, values: Mapping[str, float], free: Sequence[Slopes]) -> Estimate | None:
    """None where it is so far off that its noise cannot be told."""
    try:
        return p.few_steps(values, free, REFITS)
    except np.linalg.LinAlgError:
        return None


def _from_profile(p: Problem, values: Mapping[str, float], on_the_way: State | None = None) -> Estimate | None:
    """None where it is so far off that its noise cannot be told."""
    try:
        return p.from_profile(_physical(values), on_the_way)
    except np.linalg.LinAlgError:
        return None


def _promised(e: Estimate) -> float:
    """The cost a step further, if all is linear."""
    return e.cost - e.solved.gained


def _opposed(values: Mapping[str, float]) -> bool:
    """Whether an instrument is late by its lag and early by its delay, or the other way: what these leave is not late,
    but of another size at each frequency, as none is."""
    pairs = ((x, values.get(i.removesuffix("lag") + "delay", 0.0)) for i, x in values.items() if i.endswith(".lag"))
    return any(lag * delay < 0 for lag, delay in pairs)


def _physical(values: Mapping[str, float]) -> dict[str, float]:
    return {i: min(max(x, BY_ID[i].low), BY_ID[i].high) for i, x in values.items()}
