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
from station.diagnosis.doubt import Doubted, in_doubt, of_vane
from station.diagnosis.effects import BY_ID, DERIVATIVES, Term, extended, judged_effects
from station.diagnosis.fit import Fit, Problem, moved_by
from station.diagnosis.judge import SD_FACTOR, Gain, Leftover
from station.diagnosis.measured_record import Record, Seen, describe_missing
from station.diagnosis.model_doubt import beyond, gusts, incomplete, mended
from station.diagnosis.reference import Reference, bare, heard_through, reference
from station.diagnosis.search import FURTHER, FURTHER_SHARE, RIVAL, Found, search
from station.profile import Aircraft, Instrument
from station.rows import UsageError

MOVED: Final = 1.0
"""Standard deviations of a derivative from which the noise is taken through the model as it then is."""
LARGE: Final = 300.0
"""Drop from which the accepted effects are simulated and refitted."""
PLAY_UNSURE: Final = 0.5
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
    drop: float
    """Of -2 log likelihood, against the same without it."""
    rivals: tuple[str, ...]

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
    leftover: Leftover
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
    doubted: Doubted | None = None
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
        problem = _as_heard(problem)
        found = search(problem, terms, progress)
        progress("what is left")
        leftover = judge.left_over(problem, found)
        if found.accepted.values and (leftover.present or found.drop > LARGE):
            progress("simulating with the effects")
            problem, found = _second_look(problem, found)
            leftover = judge.left_over(problem, found)
        if found.accepted.values and not leftover.present:
            found = replace(found, accepted=sure(problem, found.accepted))
        far = beyond(problem, found.accepted)
        more = (Effect(p.term, p.value, SD_FACTOR * p.sd, p.drop, ()) for p in far.values())
        effects = tuple(sorted((*_effects(found, problem), *more), key=lambda e: -e.drop))
        # What the data say of these is what is gained.
        allowed = [0.0 if a.name in far else float(x) for a, x in zip(problem.allowed, found.null.moved, strict=False)]
        before = moved_by(problem.aircraft, problem.allowed, np.array(allowed))
        better = extended(aircraft, found.accepted.values)
        for part in far.values():
            better = part.term.extend(better, part.value)
    doubted = None
    if incomplete(aircraft) or leftover.present:
        strict = () if incomplete(aircraft) else effects
        doubted = in_doubt(references, aircraft, terms, progress)
        problem, found = doubted.problem, doubted.found
        if incomplete(aircraft):
            leftover = judge.left_over(problem, found)
        effects = _effects_in_doubt(doubted, aircraft)
        before, better = base.complete(base.null()), mended(problem, found.accepted)
    after = problem.complete(found.accepted)
    measured = judge.gain(before, after, held_out) if effects else None
    verdict: Verdict = "no_effect"
    if leftover.present or (doubted is not None and doubted.misses_much):
        verdict = "unexplained"
    elif any(e.rivals for e in effects) or any(s.alternatives for s in seen):
        verdict = "confounded"
    elif effects or seen:
        verdict = "effect_found"
    remarks = [
        f"turbulence in {r.record.name}: vertical gust of {g:.2f} m/s standard deviation"
        for r, g in zip(references, found.accepted.gust, strict=True)
        if g > NOTABLE_GUST
    ]
    remarks += dict.fromkeys(words for r in references for words in describe_missing(r.record))
    if doubted is not None and len(_far_off(doubted)) >= MOST_FAR_OFF:
        remarks.append(
            f"{', '.join(_far_off(doubted))} are far from the profile's: is it another aircraft's? use --aircraft"
        )
    if doubted is not None and aircraft.boom is None:
        remarks.append(_about_the_vane(better))
    return Diagnosis(
        aircraft, verdict, effects, measured, leftover, found, problem, tuple(held_out), tuple(remarks), better,
        before, after, tuple(seen), doubted, strict,
    )  # fmt: skip


def _as_heard(problem: Problem) -> Problem:
    """With the sensors' noise as it passes through the model that the data ask for, where that is not the profile's:
    through the profile's, an effect that brings its derivatives back would seem to add noise."""
    nothing = problem.null()
    moved = [x for a, x in zip(problem.allowed, nothing.moved, strict=False) if a.name in DERIVATIVES]
    if max(np.abs(moved), default=0.0) < MOVED:
        return problem
    there = problem.complete(nothing)
    return Problem([heard_through(r, there) for r in problem.references], problem.aircraft)


def sure(problem: Problem, fit: Fit) -> Fit:
    """A fit free of what the sensors' noise makes of its values, without the effects that are nothing then."""
    while True:
        freed = problem.undiluted(fit)
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
    rivals = []
    for rival in found.rivals:
        if len(rival.values) == len(accepted.values):
            fit = again.refit(rival.ids, rival.values, gust)
            if fit.cost - accepted.cost < RIVAL and frozenset(fit.ids) != frozenset(accepted.ids):
                rivals.append(fit)
    return again, Found(nothing, accepted, tuple(rivals), found.singles, tried, found.screened)


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
        drop = _without(found, others) - accepted.cost
        sd = SD_FACTOR * accepted.sds[name]
        if name == "elevator.backlash":
            sd = math.hypot(sd, PLAY_UNSURE * max(r.noise["elevator"] for r in problem.references))
        rivals = judge.rivals_of(found, name)
        if name == "alpha_vane.scale" and aircraft.boom is not None:
            twice = aircraft.boom.steady_calibration - 1
            if abs(value - twice) < 1.96 * sd < 0.4 * abs(twice):
                # Someone may have divided by the upwash already: the value is just what that gives.
                rivals = ("alpha_vane.double_upwash", *rivals)
        out.append(Effect(BY_ID[name], value, sd, drop, rivals))
    return tuple(sorted(out, key=lambda e: -e.drop))


def _effects_in_doubt(d: Doubted, aircraft: Aircraft) -> tuple[Effect, ...]:
    """The effects that stand with the model in doubt, and what of the model is wrong."""
    found = [replace(e, rivals=(*e.rivals, *_as_likely(d, e))) for e in _effects(d.found, d.problem)]
    if any(r.setting.rebuilt for r in d.problem.references):
        found = [replace(e, rivals=(*e.rivals, *UNWITNESSED.get(e.term.id, ()))) for e in found]
    wrong = list(d.parts)
    if incomplete(aircraft) and (gust := gusts(d.problem, d.found.accepted)) is not None:
        wrong.append(gust)
    found += [Effect(p.term, p.value, SD_FACTOR * p.sd, p.drop, ()) for p in wrong]
    return tuple(sorted(found, key=lambda e: -e.drop))


def _as_likely(d: Doubted, e: Effect) -> tuple[str, ...]:
    """Effects that the instruments among themselves like better than one named, or as well if they explain as much of
    the rest: a likelihood with the model's errors in it does not tell apart what is that near."""
    own = d.support.get(e.term.id)
    if own is None:
        return ()
    named = {*d.found.accepted.values, *e.rivals}
    drops = {f.ids[0]: d.found.screened - f.cost for f in d.found.singles if math.isfinite(f.cost)}
    enough = AS_MUCH * drops.get(e.term.id, math.inf)
    return tuple(
        n
        for n, v in d.support.items()
        if n not in named
        and of_vane(n) == of_vane(e.term.id)
        and v > own + (-RIVAL if drops.get(n, 0.0) > enough else RIVAL)
    )


def _far_off(d: Doubted) -> list[str]:
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
