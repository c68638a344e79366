"""Records and an aircraft's profile -> a diagnosis, without files."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, TypeVar

import numpy as np

from station.diagnosis import judge
from station.diagnosis.checks import first_seen
from station.diagnosis.corrections import instrument_of
from station.diagnosis.diagnosis_result import Effect, Gain, Verdict, by_reduction, verdict_of
from station.diagnosis.effects import BY_ID, Term, extended, judged_effects
from station.diagnosis.fit import Fit, Problem
from station.diagnosis.judge import SD_FACTOR, RemainingResidual
from station.diagnosis.measured_record import Record, describe_missing
from station.diagnosis.model_error import beyond, corrected_profile, gusts, incomplete
from station.diagnosis.model_error_search import WithModelError, with_model_error
from station.diagnosis.nuisances import DERIVATIVES, moved_by
from station.diagnosis.reference import Reference, bare, reference, with_noise_through
from station.diagnosis.search import CONFOUNDED, FIRST, FURTHER, FURTHER_SHARE, Found, search
from station.profile import Aircraft, Instrument
from station.rows import UsageError

MOVED: Final = 1.0
"""Standard deviations of a derivative from which the noise is taken through the model as it then is."""
LARGE: Final = 300.0
"""Deviance reduction from which the accepted effects are simulated and refitted."""
NOTABLE_GUST: Final = 0.3
FAR_OFF: Final = 0.5
"""Share by which a derivative differs from the profile's as no handbook does."""
MOST_FAR_OFF: Final = 2
AS_MUCH: Final = 0.5
"""Share of the deviance reduction of an effect that another must reach to be as likely, with the model in error."""
ALIKE: Final = 0.4
"""Half of a value's 95 % interval over another value, up to which it is just that value."""
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What was found, and everything needed to report it."""

    aircraft: Aircraft
    verdict: Verdict
    effects: tuple[Effect, ...]
    """Those fitted, the strongest evidence first."""
    gain: Gain | None
    remaining: RemainingResidual
    found: Found
    problem: Problem
    held_out: tuple[Reference, ...]
    remarks: tuple[str, ...]
    extended: Aircraft
    """The profile with the accepted effects in it."""
    before: Aircraft
    """The profile with its nuisances as fitted, nothing named."""
    after: Aircraft
    """The same with what was found."""
    seen: tuple[Effect, ...] = ()
    """Effects that needed no fit."""
    with_error: WithModelError | None = None
    """Where the model is in error: what was freed, and what of it is wrong. The effects are those that stand then, the
    model's own among them."""
    strict: tuple[Effect, ...] = ()
    """What would have been named with the model taken as exact."""

    @property
    def named(self) -> tuple[Effect, ...]:
        return (*self.seen, *self.effects)

    @property
    def not_judged(self) -> Mapping[str, str]:
        return {}

    @property
    def missed(self) -> Mapping[str, float]:
        """What the model misses of lift, moment and drag though its parameters are free, as a share of each."""
        return self.with_error.shares if self.with_error is not None else {}

    @property
    def unexplained(self) -> tuple[tuple[str, ...], tuple[float, float]] | None:
        """Signals and band (Hz) of what no effect explains."""
        return (self.remaining.signals, self.remaining.band_hz) if self.remaining.present else None


class _Outcome(NamedTuple):
    """One search: what it found, what remains, and the aircraft before and with it."""

    problem: Problem
    found: Found
    remaining: RemainingResidual
    effects: tuple[Effect, ...]
    before: Aircraft
    extended: Aircraft


def diagnose(
    fitted: Sequence[Record],
    held_out: Sequence[Record],
    aircraft: Aircraft,
    progress: Callable[[str], None] = lambda _: None,
    seed: int = 0,
) -> Diagnosis:
    """Compare, name, extend, measure. Raises UsageError."""
    seen = first_seen([*fitted, *held_out])
    progress(f"simulating {', '.join(r.name for r in (*fitted, *held_out))}")
    made = _side_by_side(lambda k, record: reference(record, aircraft, seed + 1000 * k), [*fitted, *held_out])
    references, kept = made[: len(fitted)], made[len(fitted) :]
    return diagnosis_of(references, kept, aircraft, progress, seen)


def _side_by_side(make: Callable[[int, T], Reference], of: Sequence[T]) -> list[Reference]:
    """One thread each, also where cores are fewer: three at once on two cores end together, two and one do not. The
    flights take most of the time and let go of the interpreter."""
    with ThreadPoolExecutor(min(len(of), 2 * (os.cpu_count() or 1))) as pool:
        return list(pool.map(make, range(len(of)), of))


def diagnosis_of(
    references: Sequence[Reference],
    held_out: Sequence[Reference],
    aircraft: Aircraft,
    progress: Callable[[str], None] = lambda _: None,
    seen: Sequence[Effect] = (),
) -> Diagnosis:
    """A diagnosis from manoeuvres that have been flown in the simulation already."""
    base = Problem(references, aircraft)
    present = set.intersection(*(set(r.record.signals) for r in references))
    gusty = any(r.setting.gusty for r in references)
    held = any(len(r.record.held) for r in references)
    terms = judged_effects(aircraft, present, gusty, held)
    exact = None if incomplete(aircraft) else _with_exact_model(base, terms, progress)
    if exact is None or exact.remaining.present:
        with_error = with_model_error(references, aircraft, terms, progress)
        outcome = _with_model_error(with_error, base, exact)
    else:
        with_error, outcome = None, exact
    found, effects = outcome.found, outcome.effects
    after = outcome.problem.complete(found.accepted)
    unexplained = outcome.remaining.present or (with_error is not None and with_error.misses_much)
    if unexplained:
        effects = tuple(replace(e, suspect=not _confirmed(e, with_error)) for e in effects)
    remarks = [
        f"turbulence in {r.record.name}: vertical gust of {g:.2f} m/s standard deviation"
        for r, g in zip(references, found.accepted.gust, strict=True)
        if g > NOTABLE_GUST
    ]
    remarks += dict.fromkeys(words for r in references for words in describe_missing(r.record))
    if with_error is not None:
        remarks += _about_the_model(with_error, aircraft, outcome.extended)
    return Diagnosis(
        aircraft=aircraft,
        verdict=verdict_of((*seen, *effects), unexplained),
        effects=effects,
        gain=judge.gain(outcome.before, after, held_out) if effects else None,
        remaining=outcome.remaining,
        found=found,
        problem=outcome.problem,
        held_out=tuple(held_out),
        remarks=tuple(remarks),
        extended=outcome.extended,
        before=outcome.before,
        after=after,
        seen=tuple(seen),
        with_error=with_error,
        strict=exact.effects if with_error is not None and exact is not None else (),
    )


def _with_exact_model(problem: Problem, terms: Sequence[Term], progress: Callable[[str], None]) -> _Outcome:
    """A search with the aircraft's model taken as exact within its priors."""
    problem = _with_noise_through_model(problem)
    found = search(problem, terms, progress)
    progress("residual test")
    remaining = judge.remaining_residual(problem, found)
    if found.accepted.values and (remaining.present or found.reduction > LARGE):
        progress("simulating with the effects")
        problem, found = _resimulated(problem, found)
        remaining = judge.remaining_residual(problem, found)
    if found.accepted.values and not remaining.present:
        found = replace(found, accepted=significant(problem, found.accepted))
    far = beyond(problem, found.accepted)
    more = (replace(e, sd=SD_FACTOR * e.sd) for e in far.values())
    effects = tuple(sorted((*_effects(found, problem), *more), key=by_reduction))
    # What the data say of these is what is gained.
    own = zip(problem.nuisances, found.null.moved, strict=False)
    before = moved_by(problem.aircraft, problem.nuisances, np.array([0.0 if a.name in far else x for a, x in own]))
    better = extended(problem.aircraft, found.accepted.values)
    for part in far.values():
        better = part.term.extend(better, part.value)
    return _Outcome(problem, found, remaining, effects, before, better)


def _with_model_error(d: WithModelError, base: Problem, exact: _Outcome | None) -> _Outcome:
    """What stands with the aircraft's model in error; what remains unexplained is that of the exact
    one, where it was searched."""
    remaining = judge.remaining_residual(d.problem, d.found) if exact is None else exact.remaining
    effects = _effects_with_error(d, base.aircraft)
    before = base.complete(base.null())
    return _Outcome(d.problem, d.found, remaining, effects, before, corrected_profile(d.problem, d.found.accepted))


def _confirmed(e: Effect, d: WithModelError | None) -> bool:
    """Whether the instruments say so among themselves, whatever remains unexplained."""
    return d is not None and d.kinematic_chi2.get(e.term.id, 0.0) > FIRST


def _about_the_model(d: WithModelError, aircraft: Aircraft, better: Aircraft) -> list[str]:
    remarks = []
    if len(_far_off(d)) >= MOST_FAR_OFF:
        remarks.append(f"{', '.join(_far_off(d))} are far from the profile's: is it another aircraft's? use --aircraft")
    if aircraft.boom is None:
        remarks.append(_about_the_vane(better))
    return remarks


def _with_noise_through_model(problem: Problem) -> Problem:
    """With the sensors' noise as it passes through the model that the data ask for, where that is not the profile's:
    through the profile's, an effect that brings its derivatives back would seem to add noise."""
    nothing = problem.null()
    moved = [x for a, x in zip(problem.nuisances, nothing.moved, strict=False) if a.name in DERIVATIVES]
    if max(np.abs(moved), default=0.0) < MOVED:
        return problem
    there = problem.complete(nothing)
    return Problem([with_noise_through(r, there) for r in problem.references], problem.aircraft)


def significant(problem: Problem, fit: Fit) -> Fit:
    """A fit corrected for the noise in its regressors, without the effects that are not significant then."""
    while True:
        freed = problem.noise_corrected(fit)
        if not freed.values:
            return freed
        weakest = min(freed.values, key=lambda n: abs(freed.values[n]) / max(freed.sds[n], 1e-30))
        if abs(freed.values[weakest]) > 1.96 * SD_FACTOR * freed.sds[weakest]:
            return freed
        others = [i for i in fit.ids if i != weakest]
        fit = problem.refit(others, fit.values, fit.gust) if others else problem.null()


def _resimulated(problem: Problem, found: Found) -> tuple[Problem, Found]:
    """Simulate with the accepted effects, refit them against that, and leave out those that are no longer needed.

    A large correction leaves traces that the simulation without it does not have.
    """
    subject = extended(problem.aircraft, found.accepted.values)
    same = _flies_alike(subject, problem.aircraft)
    try:
        references = _side_by_side(
            lambda k, r: reference(
                r.record, subject, 500 + k, r.flights if same else None, (r.mass_share, r.iyy_share)
            ),
            problem.references,
        )
    except UsageError:
        return problem, found  # an aircraft with these effects could not have flown: the residual test shows it
    again = Problem(references, problem.aircraft)
    values, gust = dict(found.accepted.values), found.accepted.gust
    accepted = again.refit(tuple(values), values, gust)
    tried = {frozenset(values): accepted}
    nothing = again.null()
    while len(accepted.values) > 1:
        fewer = []
        for name in accepted.values:
            ids = tuple(i for i in accepted.values if i != name)
            fit = again.refit(ids, accepted.values, gust)
            tried[frozenset(ids)] = fit
            fewer.append(fit)
        best = min(fewer, key=lambda f: (f.cost, f.ids))
        if best.cost - accepted.cost > max(FURTHER, FURTHER_SHARE * (nothing.cost - best.cost)):
            break
        accepted = best
    alternatives = []
    for alternative in found.alternatives:
        if len(alternative.values) == len(accepted.values):
            fit = again.refit(alternative.ids, alternative.values, gust)
            if fit.cost - accepted.cost < CONFOUNDED and frozenset(fit.ids) != frozenset(accepted.ids):
                alternatives.append(fit)
    return again, Found(nothing, accepted, tuple(alternatives), found.singles, tried, found.screened)


def _flies_alike(one: Aircraft, other: Aircraft) -> bool:
    """Whether they differ in instruments alone, and not in those that say how the aircraft was flown."""
    for name in ("airspeed", "elevator"):
        shown, shown_then = (instrument_of(a, name) or Instrument() for a in (one, other))
        if (shown.gain, shown.cubic) != (shown_then.gain, shown_then.cubic):
            return False
    return bare(one).model_dump() == bare(other).model_dump()


def _effects(found: Found, problem: Problem) -> tuple[Effect, ...]:
    accepted = found.accepted
    out = []
    for name, value in accepted.values.items():
        term = BY_ID[name]
        reduction = _without(found, frozenset(accepted.values) - {name}) - accepted.cost
        sd = SD_FACTOR * accepted.sds[name]
        if term.unsure_in_noise:
            sd = math.hypot(sd, term.unsure_in_noise * max(r.noise[term.target] for r in problem.references))
        alternatives = judge.alternatives_of(found, name)
        same = term.same_value(problem.aircraft)
        if same is not None and abs(value - same[1]) < 1.96 * sd < ALIKE * abs(same[1]):
            alternatives = (same[0], *alternatives)
        out.append(Effect(term, value, sd, reduction, alternatives))
    return tuple(sorted(out, key=by_reduction))


def _effects_with_error(d: WithModelError, aircraft: Aircraft) -> tuple[Effect, ...]:
    """The effects that stand with the model in error, and what of the model is wrong."""
    found = [replace(e, alternatives=(*e.alternatives, *_as_likely(d, e))) for e in _effects(d.found, d.problem)]
    if any(r.setting.rebuilt for r in d.problem.references):
        found = [replace(e, alternatives=(*e.alternatives, *e.term.without_velocity)) for e in found]
    wrong = list(d.parts)
    if incomplete(aircraft) and (gust := gusts(d.problem, d.found.accepted)) is not None:
        wrong.append(gust)
    found += [replace(e, sd=SD_FACTOR * e.sd) for e in wrong]
    return tuple(sorted(found, key=by_reduction))


def _as_likely(d: WithModelError, e: Effect) -> tuple[str, ...]:
    """Effects that the instruments among themselves like better than one named, or as well if they explain as much of
    the rest: a likelihood with the model's errors in it does not separate what is that near."""
    own = d.kinematic_chi2.get(e.term.id)
    if own is None:
        return ()
    named = {*d.found.accepted.values, *e.alternatives}
    reductions = {f.ids[0]: d.found.screened - f.cost for f in d.found.singles if math.isfinite(f.cost)}
    enough = AS_MUCH * reductions.get(e.term.id, math.inf)
    return tuple(
        n
        for n, v in d.kinematic_chi2.items()
        if n not in named
        and BY_ID[n].of_vane == e.term.of_vane
        and v > own + (-CONFOUNDED if reductions.get(n, 0.0) > enough else CONFOUNDED)
    )


def _far_off(d: WithModelError) -> list[str]:
    """Derivatives that differ from the profile's by more than half of it."""
    names = {p.term.id.removeprefix("aero."): abs(p.value) for p in d.parts if p.term.shown == "%"}
    return [n for n in DERIVATIVES if names.get(n, 0.0) > FAR_OFF]


def _about_the_vane(better: Aircraft) -> str:
    """What the record says of a vane that the profile does not describe."""
    boom, late = better.boom, better.instruments.get("alpha_vane")
    assert boom is not None
    return (
        f"the profile does not say where the alpha vane is, nor how late: it reads as if {boom.vane_x:.1f} m ahead of "
        f"the CG, {1e3 * (late.latency if late else 0.0):.0f} ms late, with {100 * boom.upwash_body:.0f} % upwash"
    )


def _without(found: Found, others: frozenset[str]) -> float:
    """Cost of the best refitted candidate within `others`."""
    costs = [f.cost for ids, f in found.refitted.items() if ids <= others and math.isfinite(f.cost)]
    return min([found.null.cost, *costs])
