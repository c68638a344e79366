"""Records and an aircraft's profile -> a diagnosis, without files."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeVar

import numpy as np

from station.diagnosis import judge
from station.diagnosis.checks import first_seen
from station.diagnosis.corrections import instrument_of
from station.diagnosis.effects import BY_ID, DERIVATIVES, Term, extended, judged_effects
from station.diagnosis.fit import Fit, Problem, moved_by
from station.diagnosis.judge import SD_FACTOR, Gain, RemainingResidual
from station.diagnosis.measured_record import Record, Seen, describe_missing
from station.diagnosis.model_error import beyond, corrected_profile, gusts, incomplete
from station.diagnosis.model_error_search import WithModelError, of_vane, with_model_error
from station.diagnosis.reference import Reference, bare, reference, with_noise_through
from station.diagnosis.search import CONFOUNDED, FURTHER, FURTHER_SHARE, Found, search
from station.profile import Aircraft, Instrument
from station.rows import UsageError

MOVED: Final = 1.0
"""Standard deviations of a derivative from which the noise is taken through the model as it then is."""
LARGE: Final = 300.0
"""Drop from which the accepted effects are simulated and refitted."""
BACKLASH_UNSURE: Final = 0.5
"""Of the elevator's noise: what goes through a play with the motion widens it, however long the record (0.8 found)."""
NOTABLE_GUST: Final = 0.3
FAR_OFF: Final = 0.5
"""Share by which a derivative differs from the profile's as no handbook does."""
MOST_FAR_OFF: Final = 2
AS_MUCH: Final = 0.5
"""Share of the drop of an effect that another must explain to be as likely, with the model in doubt."""
UNWITNESSED: Final = {"accelerometer.scale": ("dynamic_pressure.scale", "mass.scale", "aero.CL_alpha")}
"""What the same lift, and the same vane against the integrated acceleration over the airspeed, would come from where no
vertical velocity is measured and the model is in doubt."""
T = TypeVar("T")
Verdict = Literal["no_effect", "effect_found", "confounded", "unexplained"]


@dataclass(frozen=True, slots=True)
class Effect:
    """One accepted effect."""

    term: Term
    value: float
    sd: float
    reduction: float
    """Of -2 log likelihood, against the same without it."""
    alternatives: tuple[str, ...]

    @property
    def ci95(self) -> tuple[float, float]:
        return self.value - 1.96 * self.sd, self.value + 1.96 * self.sd


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What was found, and everything needed to report it."""

    aircraft: Aircraft
    verdict: Verdict
    effects: tuple[Effect, ...]
    gain: Gain | None
    remaining: RemainingResidual
    found: Found
    problem: Problem
    held_out: tuple[Reference, ...]
    remarks: tuple[str, ...]
    extended: Aircraft
    """The profile with the accepted effects in it."""
    before: Aircraft
    """The profile with what is allowed for moved, nothing named."""
    after: Aircraft
    """The same with what was found."""
    seen: tuple[Seen, ...] = ()
    """Effects that needed no fit."""
    with_error: WithModelError | None = None
    """Where the model is in doubt: what was allowed for, and what of it is wrong. The effects are those that stand
    then, the model's own first among them."""
    strict: tuple[Effect, ...] = ()
    """What would have been named with the model taken for right."""


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
    seen: Sequence[Seen] = (),
) -> Diagnosis:
    """A diagnosis from manoeuvres that have been flown in the simulation already."""
    base = problem = Problem(references, aircraft)
    present = set.intersection(*(set(r.record.signals) for r in references))
    gusty = any(r.setting.gusty for r in references)
    held = any(len(r.record.held) for r in references)
    terms = judged_effects(aircraft, present, gusty, held)
    strict: tuple[Effect, ...] = ()
    if not incomplete(aircraft):
        problem = _with_noise_through_model(problem)
        found = search(problem, terms, progress)
        progress("what is left")
        remaining = judge.remaining_residual(problem, found)
        if found.accepted.values and (remaining.present or found.reduction > LARGE):
            progress("simulating with the effects")
            problem, found = _second_look(problem, found)
            remaining = judge.remaining_residual(problem, found)
        if found.accepted.values and not remaining.present:
            found = replace(found, accepted=significant(problem, found.accepted))
        far = beyond(problem, found.accepted)
        more = (Effect(p.term, p.value, SD_FACTOR * p.sd, p.reduction, ()) for p in far.values())
        effects = tuple(sorted((*_effects(found, problem), *more), key=lambda e: -e.reduction))
        # What the data say of these is what is gained.
        nuisances = [
            0.0 if a.name in far else float(x) for a, x in zip(problem.nuisances, found.null.moved, strict=False)
        ]
        before = moved_by(problem.aircraft, problem.nuisances, np.array(nuisances))
        better = extended(aircraft, found.accepted.values)
        for part in far.values():
            better = part.term.extend(better, part.value)
    with_error = None
    if incomplete(aircraft) or remaining.present:
        strict = () if incomplete(aircraft) else effects
        with_error = with_model_error(references, aircraft, terms, progress)
        problem, found = with_error.problem, with_error.found
        if incomplete(aircraft):
            remaining = judge.remaining_residual(problem, found)
        effects = _effects_with_error(with_error, aircraft)
        before, better = base.complete(base.null()), corrected_profile(problem, found.accepted)
    after = problem.complete(found.accepted)
    measured = judge.gain(before, after, held_out) if effects else None
    verdict: Verdict = "no_effect"
    if remaining.present or (with_error is not None and with_error.misses_much):
        verdict = "unexplained"
    elif any(e.alternatives for e in effects) or any(s.alternatives for s in seen):
        verdict = "confounded"
    elif effects or seen:
        verdict = "effect_found"
    remarks = [
        f"turbulence in {r.record.name}: vertical gust of {g:.2f} m/s standard deviation"
        for r, g in zip(references, found.accepted.gust, strict=True)
        if g > NOTABLE_GUST
    ]
    remarks += dict.fromkeys(words for r in references for words in describe_missing(r.record))
    if with_error is not None and len(_far_off(with_error)) >= MOST_FAR_OFF:
        remarks.append(
            f"{', '.join(_far_off(with_error))} are far from the profile's: is it another aircraft's? use --aircraft"
        )
    if with_error is not None and aircraft.boom is None:
        remarks.append(_about_the_vane(better))
    return Diagnosis(
        aircraft, verdict, effects, measured, remaining, found, problem, tuple(held_out), tuple(remarks), better,
        before, after, tuple(seen), with_error, strict,
    )  # fmt: skip


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
    """A fit free of what the sensors' noise makes of its values, without the effects that are nothing then."""
    while True:
        freed = problem.noise_corrected(fit)
        if not freed.values:
            return freed
        weakest = min(freed.values, key=lambda n: abs(freed.values[n]) / max(freed.sds[n], 1e-30))
        if abs(freed.values[weakest]) > 1.96 * SD_FACTOR * freed.sds[weakest]:
            return freed
        others = [i for i in fit.ids if i != weakest]
        fit = problem.refit(others, fit.values, fit.gust) if others else problem.null()


def _second_look(problem: Problem, found: Found) -> tuple[Problem, Found]:
    """Simulate with the accepted effects, refit them against that, and drop those that are no longer needed.

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
        return problem, found  # an aircraft with these effects could not have flown: what is left will tell
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
    accepted, aircraft = found.accepted, problem.aircraft
    out = []
    for name, value in accepted.values.items():
        others = frozenset(accepted.values) - {name}
        reduction = _without(found, others) - accepted.cost
        sd = SD_FACTOR * accepted.sds[name]
        if name == "elevator.backlash":
            sd = math.hypot(sd, BACKLASH_UNSURE * max(r.noise["elevator"] for r in problem.references))
        alternatives = judge.alternatives_of(found, name)
        if name == "alpha_vane.scale" and aircraft.boom is not None:
            twice = aircraft.boom.steady_calibration - 1
            if abs(value - twice) < 1.96 * sd < 0.4 * abs(twice):
                # Someone may have divided by the upwash already: the value is just what that gives.
                alternatives = ("alpha_vane.double_upwash", *alternatives)
        out.append(Effect(BY_ID[name], value, sd, reduction, alternatives))
    return tuple(sorted(out, key=lambda e: -e.reduction))


def _effects_with_error(d: WithModelError, aircraft: Aircraft) -> tuple[Effect, ...]:
    """The effects that stand with the model in doubt, and what of the model is wrong."""
    found = [replace(e, alternatives=(*e.alternatives, *_as_likely(d, e))) for e in _effects(d.found, d.problem)]
    if any(r.setting.rebuilt for r in d.problem.references):
        found = [replace(e, alternatives=(*e.alternatives, *UNWITNESSED.get(e.term.id, ()))) for e in found]
    wrong = list(d.parts)
    if incomplete(aircraft) and (gust := gusts(d.problem, d.found.accepted)) is not None:
        wrong.append(gust)
    found += [Effect(p.term, p.value, SD_FACTOR * p.sd, p.reduction, ()) for p in wrong]
    return tuple(sorted(found, key=lambda e: -e.reduction))


def _as_likely(d: WithModelError, e: Effect) -> tuple[str, ...]:
    """Effects that the instruments among themselves like better than one named, or as well if they explain as much of
    the rest: a likelihood with the model's errors in it does not tell apart what is that near."""
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
        and of_vane(n) == of_vane(e.term.id)
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
