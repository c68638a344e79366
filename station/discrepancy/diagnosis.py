"""Records and an aircraft's profile -> a diagnosis: the whole of contract.md's station.diagnose/1, without files."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, TypeVar

from station.discrepancy import judge
from station.discrepancy.checks import Seen, examine
from station.discrepancy.corrections import instrument_of
from station.discrepancy.detectable import detectable_sizes
from station.discrepancy.doubt import Doubted, in_doubt
from station.discrepancy.effects import BY_ID, DERIVATIVES, Term, extended, judged_effects
from station.discrepancy.fit import Problem
from station.discrepancy.judge import SD_FACTOR, Gain, Leftover
from station.discrepancy.record import Record, describe_missing
from station.discrepancy.reference import Reference, bare, reference
from station.discrepancy.search import FIRST, FURTHER, FURTHER_SHARE, RIVAL, Found, search
from station.discrepancy.structure import gusts, incomplete, mended
from station.profile import Aircraft, Instrument
from station.rows import UsageError

SCHEMA: Final = "station.diagnose/1"
LARGE: Final = 300.0
"""Drop from which the accepted effects are simulated and refitted."""
PLAY_UNSURE: Final = 0.5
"""Of the elevator's noise: what goes through a play with the motion widens it, however long the record (0.8 found)."""
NOTABLE_GUST: Final = 0.3
FAR_OFF: Final = 0.5
"""Share by which a derivative differs from the profile's as no handbook does."""
MOST_FAR_OFF: Final = 2
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
    seen, mended = examine([*fitted, *held_out], aircraft)
    fitted, held_out = mended[: len(fitted)], mended[len(fitted) :]
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
        found = search(problem, terms, progress)
        progress("what is left")
        leftover = judge.left_over(problem, found)
        if found.accepted.values and (leftover.present or found.drop > LARGE):
            progress("simulating with the effects")
            problem, found = _second_look(problem, found)
            leftover = judge.left_over(problem, found)
        effects = _effects(found, problem)
        before, better = problem.complete(found.null), extended(aircraft, found.accepted.values)
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
    elif any(e.rivals for e in effects):
        verdict = "confounded"
    elif effects or seen:
        verdict = "effect_found"
    remarks = [
        f"turbulence in {r.record.name}: vertical gust of {g:.2f} m/s standard deviation"
        for r, g in zip(references, found.accepted.gust, strict=True)
        if g > NOTABLE_GUST
    ]
    remarks += dict.fromkeys(w for r in references if (w := describe_missing(r.record)))
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
    """Effects that the instruments among themselves like better than one named."""
    own = d.support.get(e.term.id)
    if own is None:
        return ()
    named = {*d.found.accepted.values, *e.rivals}
    return tuple(
        n for n, v in d.support.items() if v > own + RIVAL and n not in named and _of_vane(n) == _of_vane(e.term.id)
    )


def _of_vane(name: str) -> bool:
    return name.startswith(("alpha_vane.", "boom."))


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


def as_json(d: Diagnosis) -> dict[str, Any]:
    """station.diagnose/1; more than the contract's fields is there, nothing less."""
    problem, found = d.problem, d.found
    white = {name: p > d.leftover.log_p_limit for name, p in d.leftover.by_series}
    residuals: dict[str, Any] = {}
    for name in white:
        before = [judge.channel_error(r, d.before).get(name, float("nan")) for r in problem.references]
        after = [judge.channel_error(r, d.after).get(name, float("nan")) for r in problem.references]
        residuals[name] = {"rms_before": _rms(before), "rms_after": _rms(after), "white": white[name]}
    return {
        "schema": SCHEMA,
        "aircraft": d.aircraft.name,
        "fitted_on": [r.record.name for r in problem.references],
        "held_out": [r.record.name for r in d.held_out],
        "verdict": d.verdict,
        "effects": [*map(_seen_json, d.seen), *(_effect_json(e, _is_suspect(d, e)) for e in d.effects)],
        "gain": _gain_json(d),
        "unexplained": {
            "present": d.leftover.present,
            "signals": list(d.leftover.signals) if d.leftover.present else [],
            "band_hz": list(d.leftover.band_hz) if d.leftover.present else [],
            "series": d.leftover.series if d.leftover.present else "",
            "like": d.leftover.like if d.leftover.coherent else "",
            "log_p": d.leftover.log_p,
            "log_p_limit": d.leftover.log_p_limit,
            "score": d.leftover.score,
            "score_limit": d.leftover.score_limit,
        },
        "with_model_error": _doubted_json(d),
        "residuals": residuals,
        "derivatives": {
            a.name: {"change_percent": 100 * a.sd * float(m), "in_prior_sd": float(m)}
            for a, m in zip(problem.allowed, found.accepted.moved, strict=False)
            if a.relinear
        },
        "noise": {r.record.name: dict(r.noise) for r in problem.references},
        "gust_sigma_mps": {r.record.name: g for r, g in zip(problem.references, found.accepted.gust, strict=True)},
        "excluded": [
            {"id": f.ids[0], "value": f.values[f.ids[0]], "drop": max(found.screened - f.cost, 0.0)}
            for f in found.singles
            if f.ids[0] not in found.accepted.values and math.isfinite(f.cost)
        ],
        "detectable": [
            {"id": x.id, "size": x.found, "size_named": x.named, "unit": BY_ID[x.id].unit, "rival": x.rival}
            for x in detectable_sizes(problem, found.accepted.gust)
        ],
        "remarks": list(d.remarks),
    }


def _seen_json(s: Seen) -> dict[str, Any]:
    return {
        "id": s.id,
        "sentence": s.sentence,
        "value": s.value,
        "unit": s.unit,
        "shown": s.unit,
        "ci95": [s.value, s.value],
        "evidence": {"p_value": 0.0, "signature": s.signature, "drop": None},
        "confounded_with": [],
        "separate_by": s.separate_by,
        "suspect": False,
    }


def _is_suspect(d: Diagnosis, e: Effect) -> bool:
    """Whether what is unexplained may have made it: not where the instruments say so among themselves."""
    sure = d.doubted is not None and d.doubted.support.get(e.term.id, 0.0) > FIRST
    return d.verdict == "unexplained" and not sure


def _doubted_json(d: Diagnosis) -> dict[str, Any] | None:
    if d.doubted is None:
        return None
    return {
        "missed": dict(d.doubted.shares),
        "instruments_say": {n: v for n, v in d.doubted.support.items() if v > 0},
        "with_the_model_taken_for_right": [_effect_json(e, True) for e in d.strict],
    }


def _rms(values: Sequence[float]) -> float:
    good = [v for v in values if math.isfinite(v)]
    return math.sqrt(sum(v * v for v in good) / len(good)) if good else float("nan")


def _effect_json(e: Effect, suspect: bool) -> dict[str, Any]:
    target = f"{e.term.target}: -2 log likelihood falls by {e.drop:.1f}"
    return {
        "id": e.term.id,
        "sentence": e.term.words(e.value),
        "value": e.value,
        "unit": e.term.unit,
        "shown": e.term.shown,
        "ci95": list(e.ci95),
        "evidence": {"p_value": math.erfc(math.sqrt(0.5 * max(e.drop, 0.0))), "signature": target, "drop": e.drop},
        "confounded_with": list(e.rivals),
        "separate_by": e.term.separate_by if e.rivals else "",
        "suspect": suspect,
    }


def _gain_json(d: Diagnosis) -> dict[str, Any] | None:
    g = d.gain
    if g is None:
        return None
    return {
        "metric": "held-out normalised output error",
        "before": g.before,
        "after": g.after,
        "reduction_percent": 100 * g.reduction,
        "ci95": [100 * g.low, 100 * g.high],
        "by_record": [{"record": n, "before": b, "after": a} for n, b, a in g.by_record],
    }
