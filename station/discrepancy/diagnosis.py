"""Records and an aircraft's profile -> a diagnosis: the whole of contract.md's station.diagnose/1, without files."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

from scipy import stats

from station.discrepancy import judge
from station.discrepancy.effects import BY_ID, Term, extended, judged_effects
from station.discrepancy.fit import Problem
from station.discrepancy.judge import SD_FACTOR, Gain, Leftover
from station.discrepancy.record import Record, describe_missing
from station.discrepancy.reference import Reference, reference
from station.discrepancy.search import Found, search
from station.profile import Aircraft

SCHEMA: Final = "station.diagnose/1"
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


def diagnose(
    fitted: Sequence[Record],
    held_out: Sequence[Record],
    aircraft: Aircraft,
    progress: Callable[[str], None] = lambda _: None,
    seed: int = 0,
) -> Diagnosis:
    """Compare, name, extend, measure. Raises UsageError."""
    references = []
    for k, record in enumerate(fitted):
        progress(f"simulating {record.name}")
        references.append(reference(record, aircraft, seed + 1000 * k))
    kept = []
    for k, record in enumerate(held_out):
        progress(f"simulating {record.name} (held out)")
        kept.append(reference(record, aircraft, seed + 1000 * (k + len(fitted))))
    return diagnosis_of(references, kept, aircraft, progress)


def diagnosis_of(
    references: Sequence[Reference],
    held_out: Sequence[Reference],
    aircraft: Aircraft,
    progress: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """A diagnosis from manoeuvres that have been flown in the simulation already."""
    problem = Problem(references, aircraft)
    present = set.intersection(*(set(r.record.signals) for r in references))
    gusty = any(r.setting.gusty for r in references)
    held = any(r.record.held for r in references)
    terms = judged_effects(aircraft, present, gusty, held)
    found = search(problem, terms, progress)
    progress("what is left")
    leftover = judge.left_over(problem, found)
    effects = _effects(found)
    measured = judge.gain(problem, held_out, found)
    verdict: Verdict = "no_effect"
    if leftover.present:
        verdict = "unexplained"
    elif any(e.rivals for e in effects):
        verdict = "confounded"
    elif effects:
        verdict = "effect_found"
    remarks = tuple(dict.fromkeys(w for r in references if (w := describe_missing(r.record))))
    values = {e.term.id: e.value for e in effects}
    return Diagnosis(
        aircraft, verdict, effects, measured, leftover, found, problem, tuple(held_out), remarks,
        extended(aircraft, values),
    )  # fmt: skip


def _effects(found: Found) -> tuple[Effect, ...]:
    accepted = found.accepted
    out = []
    for name, value in accepted.values.items():
        others = frozenset(accepted.values) - {name}
        without = found.refitted.get(others, found.null if not others else None)
        drop = _without(found, others) - accepted.cost if without is None else without.cost - accepted.cost
        sd = SD_FACTOR * accepted.sds[name]
        out.append(Effect(BY_ID[name], value, sd, drop, judge.rivals_of(found, name)))
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
        "effects": [_effect_json(e, d.verdict == "unexplained") for e in d.effects],
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
        "residuals": residuals,
        "noise": {r.record.name: dict(r.noise) for r in problem.references},
        "gust_sigma_mps": {r.record.name: g for r, g in zip(problem.references, found.accepted.gust, strict=True)},
        "excluded": [
            {"id": f.ids[0], "value": f.values[f.ids[0]], "drop": max(found.null.cost - f.cost, 0.0)}
            for f in found.singles
            if f.ids[0] not in found.accepted.values and math.isfinite(f.cost)
        ],
        "remarks": list(d.remarks),
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

