"""Records and an aircraft's profile -> a diagnosis: the whole of contract.md's station.diagnose/1, without files."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Final, Literal

from scipy import stats

from station.discrepancy import judge
from station.discrepancy.checks import Seen, examine
from station.discrepancy.effects import BY_ID, Term, extended, judged_effects
from station.discrepancy.fit import Problem
from station.discrepancy.judge import SD_FACTOR, Gain, Leftover
from station.discrepancy.record import Record, describe_missing
from station.discrepancy.reference import Reference, bare, reference
from station.discrepancy.search import FURTHER, RIVAL, Found, search
from station.profile import Aircraft
from station.rows import UsageError

SCHEMA: Final = "station.diagnose/1"
LARGE: Final = 300.0
"""Drop from which the accepted effects are simulated and refitted."""
NOTABLE_GUST: Final = 0.3
MODEL_ERROR: Final = 0.05
"""Share of the predicted forces and moments by which a real aircraft's model may be wrong without an effect."""
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
    seen: tuple[Seen, ...] = ()
    """Effects that needed no fit."""
    tolerant: tuple[Effect, ...] = ()
    """Where something is unexplained: what is found when the model itself may be MODEL_ERROR wrong."""
    tolerant_leftover: Leftover | None = None


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
    # The flights take most of the time and let go of the interpreter: each record has its own thread.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        made = list(
            pool.map(lambda kr: reference(kr[1], aircraft, seed + 1000 * kr[0]), enumerate([*fitted, *held_out]))
        )
    references, kept = made[: len(fitted)], made[len(fitted) :]
    return diagnosis_of(references, kept, aircraft, progress, seen)


def diagnosis_of(
    references: Sequence[Reference],
    held_out: Sequence[Reference],
    aircraft: Aircraft,
    progress: Callable[[str], None] = lambda _: None,
    seen: Sequence[Seen] = (),
) -> Diagnosis:
    """A diagnosis from manoeuvres that have been flown in the simulation already."""
    problem = Problem(references, aircraft)
    present = set.intersection(*(set(r.record.signals) for r in references))
    gusty = any(r.setting.gusty for r in references)
    held = any(len(r.record.held) for r in references)
    terms = judged_effects(aircraft, present, gusty, held)
    found = search(problem, terms, progress)
    progress("what is left")
    leftover = judge.left_over(problem, found)
    if found.accepted.values and (leftover.present or found.drop > LARGE):
        progress("simulating with the effects")
        problem, found = _second_look(problem, found)
        leftover = judge.left_over(problem, found)
    effects = _effects(found, aircraft)
    measured = judge.gain(problem, held_out, found)
    tolerant: tuple[Effect, ...] = ()
    tolerant_leftover = None
    if leftover.present:
        progress(f"allowing the model {100 * MODEL_ERROR:g} % error")
        lenient = Problem(
            [reference(r.record, aircraft, 0, MODEL_ERROR, r.flights, (r.mass_share, r.iyy_share)) for r in references],
            aircraft,
        )
        other = search(lenient, terms, progress)
        tolerant, tolerant_leftover = _effects(other, aircraft), judge.left_over(lenient, other)
    verdict: Verdict = "no_effect"
    if leftover.present:
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
    values = {e.term.id: e.value for e in effects}
    return Diagnosis(
        aircraft, verdict, effects, measured, leftover, found, problem, tuple(held_out), tuple(remarks),
        extended(aircraft, values), tuple(seen), tolerant, tolerant_leftover,
    )  # fmt: skip


def _second_look(problem: Problem, found: Found) -> tuple[Problem, Found]:
    """Simulate with the accepted effects, refit them against that, and drop those that are no longer needed.

    A large correction leaves traces that the simulation without it does not have.
    """
    subject = extended(problem.aircraft, found.accepted.values)
    same = bare(subject).model_dump() == bare(problem.aircraft).model_dump()  # instruments alone: it flies alike
    try:
        references = [
            reference(r.record, subject, 500 + k, 0.0, r.flights if same else None, (r.mass_share, r.iyy_share))
            for k, r in enumerate(problem.references)
        ]
    except UsageError:
        return problem, found  # an aircraft with these effects could not have flown: what is left will tell
    again = Problem(references, problem.aircraft)
    values, gust = dict(found.accepted.values), found.accepted.gust
    accepted = again.refit(tuple(values), values, gust)
    tried = {frozenset(values): accepted}
    while len(accepted.values) > 1:
        fewer = []
        for name in accepted.values:
            ids = tuple(i for i in accepted.values if i != name)
            fit = again.refit(ids, accepted.values, gust)
            tried[frozenset(ids)] = fit
            fewer.append(fit)
        best = min(fewer, key=lambda f: (f.cost, f.ids))
        if best.cost - accepted.cost > FURTHER:
            break
        accepted = best
    rivals = []
    for rival in found.rivals:
        if len(rival.values) == len(accepted.values):
            fit = again.refit(rival.ids, rival.values, gust)
            if fit.cost - accepted.cost < RIVAL and frozenset(fit.ids) != frozenset(accepted.ids):
                rivals.append(fit)
    return again, Found(again.null(), accepted, tuple(rivals), found.singles, tried, found.screened)


def _effects(found: Found, aircraft: Aircraft) -> tuple[Effect, ...]:
    accepted = found.accepted
    out = []
    for name, value in accepted.values.items():
        others = frozenset(accepted.values) - {name}
        without = found.refitted.get(others, found.null if not others else None)
        drop = _without(found, others) - accepted.cost if without is None else without.cost - accepted.cost
        sd = SD_FACTOR * accepted.sds[name]
        rivals = judge.rivals_of(found, name)
        if name == "alpha_vane.scale" and aircraft.boom is not None:
            twice = aircraft.boom.steady_calibration - 1
            if abs(value - twice) < 1.96 * sd < 0.4 * abs(twice):
                # Someone may have divided by the upwash already: the value is just what that gives.
                rivals = ("alpha_vane.double_upwash", *rivals)
        out.append(Effect(BY_ID[name], value, sd, drop, rivals))
    return tuple(sorted(out, key=lambda e: -e.drop))


def _without(found: Found, others: frozenset[str]) -> float:
    """Cost of the best refitted candidate within `others`."""
    costs = [f.cost for ids, f in found.refitted.items() if ids <= others and math.isfinite(f.cost)]
    return min([found.null.cost, *costs])


def as_json(d: Diagnosis) -> dict[str, Any]:
    """station.diagnose/1; more than the contract's fields is there, nothing less."""
    problem, found = d.problem, d.found
    before_aircraft, after_aircraft = judge.complete(problem, found.null), judge.complete(problem, found.accepted)
    white = {name: p > judge.LEFT_LOG_P for name, p in d.leftover.by_series}
    residuals: dict[str, Any] = {}
    for name in white:
        before = [judge.channel_error(r, before_aircraft).get(name, float("nan")) for r in problem.references]
        after = [judge.channel_error(r, after_aircraft).get(name, float("nan")) for r in problem.references]
        residuals[name] = {"rms_before": _rms(before), "rms_after": _rms(after), "white": white[name]}
    return {
        "schema": SCHEMA,
        "aircraft": d.aircraft.name,
        "fitted_on": [r.record.name for r in problem.references],
        "held_out": [r.record.name for r in d.held_out],
        "verdict": d.verdict,
        "effects": [*map(_seen_json, d.seen), *(_effect_json(e, d.verdict == "unexplained") for e in d.effects)],
        "gain": _gain_json(d),
        "unexplained": {
            "present": d.leftover.present,
            "signals": list(d.leftover.signals) if d.leftover.present else [],
            "band_hz": list(d.leftover.band_hz) if d.leftover.present else [],
            "series": d.leftover.series if d.leftover.present else "",
            "like": d.leftover.like if d.leftover.present and d.leftover.score > judge.LEFT_SCORE else "",
            "log_p": d.leftover.log_p,
            "score": d.leftover.score,
        },
        "with_model_error": _tolerant_json(d),
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
        "remarks": list(d.remarks),
    }


def _seen_json(s: Seen) -> dict[str, Any]:
    return {
        "id": s.id,
        "sentence": s.sentence,
        "value": s.value,
        "unit": s.unit,
        "ci95": [s.value, s.value],
        "evidence": {"p_value": 0.0, "signature": s.signature, "drop": None},
        "confounded_with": [],
        "separate_by": s.separate_by,
        "suspect": False,
    }


def _tolerant_json(d: Diagnosis) -> dict[str, Any] | None:
    if d.tolerant_leftover is None:
        return None
    return {
        "share": MODEL_ERROR,
        "effects": [_effect_json(e, d.tolerant_leftover.present) for e in d.tolerant],
        "unexplained": d.tolerant_leftover.present,
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
        "ci95": list(e.ci95),
        "evidence": {"p_value": float(stats.chi2.sf(max(e.drop, 0.0), 1)), "signature": target, "drop": e.drop},
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
