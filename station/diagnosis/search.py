"""Which effects: every one alone, every pair, then more, each refitted; accepted by the deviance reduction."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.candidate import Estimate, Slopes
from station.diagnosis.effects import BY_ID
from station.diagnosis.free_parameters import BEYOND
from station.diagnosis.likelihood import ROUNDS, Problem
from station.diagnosis.null_fit import well_answered, without_effects
from station.diagnosis.refits import ASKED, CONFOUNDED, MORE, SINGLES, Refits
from station.diagnosis.screening import hopeful, least_judged, own_first, screened, substitutes
from station.diagnosis.term import Term

Array = NDArray[np.float64]

FURTHER_SHARE: Final = 0.03
"""A further effect must also gain this share of what the first did, and a rival be worse by as much: large corrections
are never perfect, and what a model misses takes one side or the other."""
HUGE: Final = 1000.0
"""Deviance reduction of an effect without which the first fit may have ended in a minimum of its own: it is fitted from
the profile on too."""
SHORT: Final = 4 * CONFOUNDED
"""Of the accepted's deviance: as near, a candidate that was left after few steps may yet be confounded with it (the
slopes it steps by are those of no effect)."""
RIVAL_SHARE: Final = 0.1
"""Of the best's deviance reduction: candidates nearer than this may yet overtake it when fitted to the end."""
PAIRS: Final = 5
MOST: Final = 4
"""Effects at once."""
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
    too_small: tuple[tuple[Estimate, frozenset[str]], ...] = ()
    """Candidates that explain more than what is accepted, with effects of a size that is not judged, and which these
    are; the best first."""
    of_noise: tuple[str, ...] = ()
    """Effects that explain no more than noise of their sensor does."""

    @property
    def reduction(self) -> float:
        return self.null.cost - self.accepted.cost


def search(problem: Problem, terms: Sequence[Term], progress: Callable[[str], None] = lambda _: None) -> Found:
    """Names of the effects that the records ask for, or none."""
    progress("fitting the aircraft")
    null = without_effects(problem)
    progress(f"screening {len(terms)} effects")
    terms = [x for t in terms for x in t.tried]
    slopes = problem.effect_slopes(null.state, terms)
    refits = Refits(problem, null, least_judged(problem, null.state, terms, slopes))
    singles = _one_and_two(problem, refits, terms, slopes, progress)
    accepted = _settled(problem, refits, _several(problem, refits, terms, progress), progress)
    if accepted.state.values:
        accepted = _rivalled(problem, refits, accepted, terms, progress)
    alternatives = _alternatives(refits, accepted)
    beyond = refits.beyond(accepted)
    plain = [k for k, t in enumerate(terms) if not t.probes]
    slopes = [Slopes(x.bins[plain], x.steady[plain], x.response[plain]) for x in slopes]
    small = refits.too_small(accepted.cost - CONFOUNDED)
    return Found(refits.null, accepted, alternatives, tuple(singles), refits.done, slopes, tuple(terms), beyond, small)


def _one_and_two(
    problem: Problem,
    refits: Refits,
    terms: Sequence[Term],
    slopes: Sequence[Slopes],
    progress: Callable[[str], None],
) -> list[tuple[float, str, float]]:
    """Refit the hopeful among single effects and pairs; every effect alone by the linear model."""
    null = refits.null
    singles, starts = screened(problem, null, terms, slopes)
    refits.add(s[1:] for s in hopeful(starts[1], SINGLES))
    likely = [s for s in starts[2] if s[0] > 2 * ASKED and s[0] - singles[0][0] > HOPEFUL * ASKED]
    if likely or null.strained:
        progress("pairs of effects")
    if null.strained:
        refits.begin_at_profile(null, terms, starts)
    else:
        refits.add(s[1:] for s in likely[:PAIRS])
    return singles


def _several(problem: Problem, refits: Refits, terms: Sequence[Term], progress: Callable[[str], None]) -> Estimate:
    """As many effects as gain what is asked of each."""
    null = accepted = refits.null
    for size in range(1, MOST + 1):
        if size > 1 and len(accepted.state.values) == size - 1:
            progress(f"{size} effects")
            made = problem.effect_slopes(accepted.state, own_first(accepted.state, terms))
            starts = screened(problem, accepted, terms, made)[1]
            refits.add(s[1:] for s in hopeful(starts[1], MORE))
            if accepted.strained and not refits.at_ease(size, accepted.cost):
                refits.begin_at_profile(accepted, terms, starts)
        best = _contended(refits, size, accepted.cost)[:1]
        steps = size - len(accepted.state.values)
        if best and accepted.cost - best[0].cost > steps * _asked(null, accepted):
            accepted = best[0]
        elif size > 1:
            break
    return accepted


def _contended(refits: Refits, size: int, cost: float) -> list[Estimate]:
    """Candidates of one size, the best first; those that a few steps left close to the best, by what it gains on the
    `cost` with fewer effects, are fitted to the end; so are those that promise more than it has, and one that they left
    short of what is asked, and promise."""
    refits.fit_the_promising(size, cost)
    refits.fit_those_ahead(size, cost)
    found = refits.of_size(size)
    if found and found[0].solved.gained > ASKED:
        refits.fit_to_the_end(found[:1])
        found = refits.of_size(size)
    if found:
        best = found[0].cost
        near = RIVAL_SHARE * (cost - best)
        rivals = [e for e in found if e.cost - best < near][:MORE]
        if near > CONFOUNDED and len(rivals) > 1:
            refits.fit_to_the_end(rivals)
            found = refits.of_size(size)
        if size == 1 and cost - best > HUGE and not refits.was_from_profile(found[0]):
            refits.fit_to_the_end(found[:1])
            refits.fit_from_profile(found[0].state.values)
            found = refits.of_size(size)
    return found


def _asked(null: Estimate, fewer: Estimate) -> float:
    """Deviance reduction asked of one effect more than `fewer` has."""
    return max(ASKED, FURTHER_SHARE * (null.cost - fewer.cost))


def is_told(term: Term, value: float, sd: float) -> bool:
    """Whether an effect is clearly off by its own standard error too, for the deviance counts what the variances gain
    as well; and of a size that is physical."""
    return abs(value - term.null) > BEYOND * sd and not term.at_end(value)


def _settled(problem: Problem, refits: Refits, accepted: Estimate, progress: Callable[[str], None]) -> Estimate:
    """With all slopes made anew; without the effects that are not needed, or not significant, then."""
    while accepted.state.values:
        progress(f"settling {', '.join(accepted.state.ids)}")
        whole = well_answered(problem, problem.estimate(accepted.state, ROUNDS, problem.whole))
        refits.done[frozenset(whole.state.ids)] = whole
        weakest, least = "", math.inf
        for name in whole.state.ids:
            fewer = refits.without(name, whole)
            beyond = fewer.cost - whole.cost - _asked(refits.null, fewer)
            if beyond < least:
                weakest, least = name, beyond
        sd = np.sqrt(np.diag(whole.solved.covariance))
        for value, (name, error) in zip(
            whole.state.values.values(), zip(whole.state.ids, sd, strict=False), strict=True
        ):
            if not is_told(BY_ID[name], value, error):
                weakest, least = name, -math.inf
        if least > 0:
            return whole
        accepted = refits.without(weakest, whole)
    return refits.null


def _rivalled(
    problem: Problem,
    refits: Refits,
    accepted: Estimate,
    terms: Sequence[Term],
    progress: Callable[[str], None],
) -> Estimate:
    """The accepted, or what is better when what acts as its effects do is put in their place, and those that few steps
    left near it are fitted to the end too."""
    for _ in range(MOST):
        made = problem.effect_slopes(accepted.state, own_first(accepted.state, terms))
        refits.add(substitutes(problem, accepted, terms, made), again=True)
        near = max(SHORT, _apart(refits, accepted))
        refits.fit_to_the_end([e for e in _others(refits, accepted) if e.cost - accepted.cost < near][:MORE])
        best = min(_others(refits, accepted), key=lambda e: e.cost, default=accepted)
        if best.cost >= accepted.cost:
            break
        accepted = _settled(problem, refits, best, progress)
        if not accepted.state.values:
            break
    return accepted


def _alternatives(refits: Refits, accepted: Estimate) -> tuple[Estimate, ...]:
    """Candidates that explain the data as well. One that is too small to be judged may be there all the same."""
    near, ids = accepted.cost + _apart(refits, accepted), frozenset(accepted.state.ids)
    small = [e for e, _ in refits.too_small(near) if len(e.state.ids) == len(ids) and frozenset(e.state.ids) != ids]
    return tuple(e for e in [*_others(refits, accepted), *small] if e.cost < near)


def _apart(refits: Refits, accepted: Estimate) -> float:
    """Deviance by which a rival must be worse not to be what is there."""
    return max(CONFOUNDED, FURTHER_SHARE * (refits.null.cost - accepted.cost))


def _others(refits: Refits, accepted: Estimate) -> list[Estimate]:
    """Candidates of the accepted's size, the best first; none where nothing is accepted."""
    found = refits.of_size(len(accepted.state.values)) if accepted.state.values else []
    return [e for e in found if frozenset(e.state.ids) != frozenset(accepted.state.ids)]


def rivals_of_constant(problem: Problem, found: Found, i: int) -> tuple[str, ...]:
    """Effects that would bring a free parameter, by its place, back to the profile: what a derivative that is named for
    being far from there may be instead."""
    e = found.accepted
    made = problem.effect_slopes(e.state, own_first(e.state, found.terms))
    far = float(e.state.a[i] + e.solved.step[len(e.state.values) + i]) ** 2
    singles = screened(problem, e, found.terms, made)[1][1]
    return tuple(ids[-1] for _, ids, _, a in singles if abs(a[i]) < BEYOND and far - a[i] ** 2 > CONFOUNDED)
