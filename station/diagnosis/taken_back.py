"""What of a search's outcome is taken back before anything is named, and priors that the data contradict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from station.diagnosis.candidate import Estimate
from station.diagnosis.effects import BY_ID
from station.diagnosis.free_parameters import BEYOND, Free
from station.diagnosis.judge import RemainingResidual
from station.diagnosis.likelihood import ROUNDS, Problem
from station.diagnosis.model_error import with_model_error
from station.diagnosis.refits import ASKED, CONFOUNDED
from station.diagnosis.screening import LEAST_SHARE, whole_changes
from station.diagnosis.search import Found, is_told
from station.numerics.random_effects import NORMAL_95

LEAST_TOLD: Final = 0.25
"""Share of a prior's variance that the data are taken to have removed, at least, where it is asked whether they
contradict it: of a parameter that they hardly tell, a small error of the model would seem to."""


def told_from_error(found: Found, problem: Problem, remaining: RemainingResidual) -> tuple[Found, tuple[str, ...]]:
    """The outcome without effects that are not the same everywhere, or may be no more than what the model misses; and
    which are the latter."""
    lost = drowned(found.accepted, problem, remaining)
    left = less(found, problem, (*lost, *(x.effect for x in remaining.inhomogeneous)))
    told = still_told(left, problem)
    return told, (*lost, *(i for i in left.accepted.state.ids if i not in told.accepted.state.values))


def outdone(found: Found, problem: Problem) -> tuple[Found, list[tuple[str, tuple[str, ...]]]]:
    """The outcome without effects that gain less than is asked of them beside another, which gains that beside them and
    explains more in their place, though it is too small to be judged; and which that is, with theirs. Neither is a
    finding then: as small, anything may be what a model misses, and so may what acts as that does."""
    doubted = []
    for e, too_small in found.too_small:
        here = found.accepted.state
        own, others = ([i for i in s.ids if i not in t.ids] for s, t in ((here, e.state), (e.state, here)))
        # With a rival of a size that is judged beside it, it is that which stands in their place.
        in_place = own and others and too_small.issuperset(others)
        if not in_place or e.cost > found.accepted.cost - CONFOUNDED:
            continue
        try:
            both = problem.beside(here, {**e.state.values, **here.values}, here.a)
            whole, small = (problem.estimate(problem.relevelled(s), ROUNDS, problem.whole) for s in (both, e.state))
        except np.linalg.LinAlgError:  # so far off that its noise cannot be told
            continue
        # Where neither gains beside the other, they are rivals.
        alone = found.accepted.cost - whole.cost > ASKED * len(others)
        if alone and small.cost - whole.cost < ASKED * len(own):
            doubted.append((others[0], tuple(own)))
            found = less(found, problem, own)
    return found, doubted


def drowned(e: Estimate, problem: Problem, remaining: RemainingResidual) -> tuple[str, ...]:
    """Effects that change no series by more than is missed there, of a force by the model or of a sensor by any effect:
    any error of structure may look like them."""
    missed = dict(remaining.missed)
    if not missed or not e.state.values:
        return ()
    shares = whole_changes(problem, e.state, [BY_ID[i] for i in e.state.values])
    limits = np.full(shares.shape[1], LEAST_SHARE)
    for m, response in zip(problem.manoeuvres, e.state.responses, strict=True):
        limits = np.maximum(limits, m.missing(response, missed))
    return tuple(i for i, row in zip(e.state.values, shares, strict=True) if not (row > limits).any())


def less(found: Found, problem: Problem, names: Sequence[str]) -> Found:
    """The outcome without some of the accepted effects, the rest fitted without them."""
    accepted = found.accepted
    left = {i: v for i, v in accepted.state.values.items() if i not in names}
    if len(left) == len(accepted.state.values):
        return found
    if not left:
        return replace(found, accepted=found.null, alternatives=())
    start = problem.relevelled(problem.beside(accepted.state, left, accepted.state.a))
    return replace(found, accepted=problem.estimate(start, ROUNDS, problem.whole), alternatives=())


def still_told(found: Found, problem: Problem) -> Found:
    """The outcome without the accepted effects that are no longer clear where others were taken out, or priors that the
    data contradict; and without those whose 95 % interval, with what the model misses in it, holds that they are not
    there."""
    if not found.accepted.state.values:
        return found
    accepted = freed(problem, found.accepted)
    alone, told = (np.sqrt(np.diag(e.solved.covariance)) for e in (accepted, with_model_error(problem, accepted)))
    doubtful = [
        i
        for (i, x), sd, wider in zip(accepted.state.values.items(), alone, told, strict=False)
        if not is_told(BY_ID[i], x, sd)
        or abs(x - BY_ID[i].null) < NORMAL_95 * math.hypot(wider, problem.unsure(BY_ID[i]))
    ]
    return still_told(less(found, problem, doubtful), problem) if doubtful else found


def is_named_alone(problem: Problem, free: Free) -> bool:
    """Whether a free parameter is named where it is far from the profile: derivatives are, and zeros of instruments."""
    return free.name in problem.axis.derivatives or free.name in problem.axis.of_zero


def freed(problem: Problem, accepted: Estimate) -> Estimate:
    """The same with derivatives and zeros freed from priors that the data contradict, and with what it is told with."""

    def made() -> Estimate:
        told = [i for i, f in enumerate(problem.frees) if f.held and f.of in accepted.state.values]
        if not (_contradicting(problem, accepted) or told):
            return accepted
        # To the end first: a search leaves its best after few steps, some of a standard deviation before.
        e, far = problem.freed(accepted, (), told), set[int]()
        while more := _contradicting(problem, e) - far:
            far |= more
            e = problem.freed(accepted, sorted(far), told)
        return e

    return problem.memo.get("freed", accepted, made)


def _contradicting(problem: Problem, e: Estimate) -> set[int]:
    """Places of the derivatives and zeros that are beyond 3 prior standard deviations, or whose prior costs what is
    asked of an effect: freed from it, one at x that is left with `variance` (of 1) gains x^2 / (1 - variance)."""
    variance = np.diag(e.solved.covariance)[len(e.state.values) :]
    gained = np.square(e.state.a) / np.maximum(1 - variance, LEAST_TOLD)
    far = np.flatnonzero((np.abs(e.state.a) > BEYOND) | (gained > ASKED))
    return {i for i in far.tolist() if i < len(problem.frees) and is_named_alone(problem, problem.frees[i])}
