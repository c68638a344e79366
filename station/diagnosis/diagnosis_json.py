"""A diagnosis as station.diagnose/1 (logs/README.md), for JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

from station.diagnosis import judge
from station.diagnosis.detectable import Detectable
from station.diagnosis.diagnosis_result import Effect, Gain, Result
from station.diagnosis.effects import BY_ID
from station.diagnosis.kinematic_diagnosis import KinematicDiagnosis
from station.diagnosis.procedure import Diagnosis, gusts
from station.diagnosis.reported import free_parameters_of, noise_of, not_accepted

SCHEMA: Final = "station.diagnose/1"


def as_json(d: Diagnosis, sizes: Sequence[Detectable]) -> dict[str, Any]:
    """Of a full diagnosis, with the sizes that its records would show (`detectable_sizes`)."""
    lateral = d.lateral
    return _finite(
        {
            **_common(d, _fitted(d), [m.record.name for m in d.held_out]),
            **_of_fit(d),
            "detectable": [
                {"id": x.id, "size": x.found, "size_named": x.named, "unit": BY_ID[x.id].unit, "rival": x.alternative}
                for x in sizes
            ],
            "lateral": None
            if lateral is None
            else {"fitted_on": _fitted(lateral), "verdict": lateral.verdict, "gain": _gain_json(lateral.gain)}
            | _of_fit(lateral),
        }
    )


def _fitted(d: Diagnosis) -> list[str]:
    return [m.record.name for m in d.problem.manoeuvres]


def _of_fit(d: Diagnosis) -> dict[str, Any]:
    """What the fit of one axis says."""
    problem, remaining, names = d.problem, d.remaining, _fitted(d)
    there, fitted = remaining.present, d.found.accepted
    free = free_parameters_of(d)
    return {
        "not_named": [_effect_json(e) for e in d.not_named],
        "unexplained": {
            "present": there,
            "signals": list(remaining.signals) if there else [],
            "band_hz": list(remaining.band_hz) if there else [],
            "series": remaining.series if there else "",
            "like": "",
            "log_p": remaining.log_p,
            "log_p_limit": remaining.log_p_limit,
            "score": 0.0,
            "score_limit": 0.0,
        },
        "with_model_error": {"missed": dict(d.missed)} if d.missed else None,
        "residuals": {
            e.name: {"rms_before": e.before, "rms_after": e.after, "white": e.white}
            for e in judge.series_errors(problem, fitted.state.levels, remaining, d.before, d.after)
        },
        "derivatives": {
            p.name: {"change_percent": 100 * p.change, "in_prior_sd": p.in_prior_sd} for p in free if p.of_derivative
        },
        "parameters": [
            {"name": p.name, "prior_sd": p.prior_sd, "in_prior_sd": p.in_prior_sd, "sd": p.sd} for p in free
        ],
        "noise": dict(zip(names, noise_of(d), strict=True)),
        "gust_sigma_mps": dict(zip(names, gusts(problem, fitted), strict=True)),
        "excluded": [{"id": x.id, "value": x.value, "drop": x.reduction} for x in not_accepted(d)],
    }


def kinematic_json(d: KinematicDiagnosis) -> dict[str, Any]:
    """Of the kinematic part alone."""
    before, after = d.vane_rms
    return _finite(
        {
            **_common(d, [j.name for j in d.fitted], [j.name for j in d.held_out]),
            "unexplained": {"present": False, "signals": [], "band_hz": []},
            "residuals": {
                name: {"rms_before": before, "rms_after": after, "white": False}
                for name in ("alpha_vane",)
                if math.isfinite(before)
            },
            "judged": list(d.judged),
            "not_judged": dict(d.not_judged),
        }
    )


def _common(d: Result, fitted: list[str], held_out: list[str]) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "aircraft": d.aircraft.name,
        "fitted_on": fitted,
        "held_out": held_out,
        "verdict": d.verdict,
        "effects": [_effect_json(e) for e in d.named],
        "gain": _gain_json(d.gain),
        "remarks": list(d.remarks),
    }


def _effect_json(e: Effect) -> dict[str, Any]:
    seen = e.reduction is None
    signature = e.signature or f"{e.term.target}: -2 log likelihood falls by {e.reduction or 0.0:.1f}"
    return {
        "id": e.term.id,
        "sentence": e.sentence,
        "value": e.value,
        "unit": e.term.unit,
        "shown": e.term.shown,
        "ci95": list(e.ci95),
        "evidence": {
            "p_value": 0.0 if seen else math.erfc(math.sqrt(0.5 * max(e.reduction or 0.0, 0.0))),
            "signature": signature,
            "drop": e.reduction,
        },
        "confounded_with": list(e.alternatives),
        "separate_by": e.term.separate_by if e.alternatives else "",
        "suspect": e.suspect,
        "constants": [{"name": c.free.name, "value": c.value, "ci95": list(c.ci95)} for c in e.constants],
    }


def _gain_json(g: Gain | None) -> dict[str, Any] | None:
    if g is None:
        return None
    return {
        "metric": g.metric,
        "before": g.before,
        "after": g.after,
        "reduction_percent": 100 * g.reduction,
        "ci95": [100 * g.low, 100 * g.high],
        "by_record": [{"record": n, "before": b, "after": a} for n, b, a in g.by_record],
    }


def _finite(fields: dict[str, Any]) -> dict[str, Any]:
    """JSON has no NaN: null in its place."""

    def finite(value: Any) -> Any:
        if isinstance(value, dict):
            return _finite(value)
        if isinstance(value, list):
            return [finite(v) for v in value]
        return None if isinstance(value, float) and not math.isfinite(value) else value

    return {k: finite(v) for k, v in fields.items()}
