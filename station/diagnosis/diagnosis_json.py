"""A diagnosis as station.diagnose/1 (logs/README.md), for JSON and the report."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

from station.diagnosis import judge
from station.diagnosis.detectable import detectable_sizes
from station.diagnosis.effects import BY_ID
from station.diagnosis.measured_record import Seen
from station.diagnosis.procedure import Diagnosis, Effect
from station.diagnosis.search import FIRST

SCHEMA: Final = "station.diagnose/1"


def as_json(d: Diagnosis) -> dict[str, Any]:
    """station.diagnose/1, as logs/README.md has it."""
    problem, found = d.problem, d.found
    white = {name: p > d.remaining.log_p_limit for name, p in d.remaining.by_series}
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
            "present": d.remaining.present,
            "signals": list(d.remaining.signals) if d.remaining.present else [],
            "band_hz": list(d.remaining.band_hz) if d.remaining.present else [],
            "series": d.remaining.series if d.remaining.present else "",
            "like": d.remaining.like if d.remaining.coherent else "",
            "log_p": d.remaining.log_p,
            "log_p_limit": d.remaining.log_p_limit,
            "score": d.remaining.score,
            "score_limit": d.remaining.score_limit,
        },
        "with_model_error": _model_error_json(d),
        "residuals": residuals,
        "derivatives": {
            a.name: {"change_percent": 100 * a.sd * float(m), "in_prior_sd": float(m)}
            for a, m in zip(problem.nuisances, found.accepted.moved, strict=False)
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
            {"id": x.id, "size": x.found, "size_named": x.named, "unit": BY_ID[x.id].unit, "rival": x.alternative}
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
        "confounded_with": list(s.alternatives),
        "separate_by": s.separate_by if s.alternatives else "",
        "suspect": False,
    }


def _is_suspect(d: Diagnosis, e: Effect) -> bool:
    """Whether what is unexplained may have made it: not where the instruments say so among themselves."""
    significant = d.with_error is not None and d.with_error.kinematic_chi2.get(e.term.id, 0.0) > FIRST
    return d.verdict == "unexplained" and not significant


def _model_error_json(d: Diagnosis) -> dict[str, Any] | None:
    if d.with_error is None:
        return None
    return {
        "missed": dict(d.with_error.shares),
        "instruments_say": {n: v for n, v in d.with_error.kinematic_chi2.items() if v > 0},
        "with_the_model_taken_for_right": [_effect_json(e, True) for e in d.strict],
    }


def _rms(values: Sequence[float]) -> float:
    good = [v for v in values if math.isfinite(v)]
    return math.sqrt(sum(v * v for v in good) / len(good)) if good else float("nan")


def _effect_json(e: Effect, suspect: bool) -> dict[str, Any]:
    target = f"{e.term.target}: -2 log likelihood falls by {e.reduction:.1f}"
    p_value = math.erfc(math.sqrt(0.5 * max(e.reduction, 0.0)))
    return {
        "id": e.term.id,
        "sentence": e.term.words(e.value),
        "value": e.value,
        "unit": e.term.unit,
        "shown": e.term.shown,
        "ci95": list(e.ci95),
        "evidence": {
            "p_value": p_value,
            "signature": target,
            "drop": e.reduction,
        },
        "confounded_with": list(e.alternatives),
        "separate_by": e.term.separate_by if e.alternatives else "",
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
