"""A programme's points as station.points/1, the JSON that `points --json` writes."""

from __future__ import annotations

import math
from typing import Any, Final

from station.conventions import LONGITUDINAL
from station.identification.identification_json import as_json as identification_json
from station.numerics.random_effects import NORMAL_95, Pooled
from station.programme.changes import CALM, OWN, Baseline, Change, recommended
from station.programme.flown_points import FlownPoint
from station.programme.programme import Programme

SCHEMA: Final = "station.points/1"
POOLED_BY: Final = "random effects, restricted maximum likelihood; interval by Hartung and Knapp"

Json = dict[str, Any]


def as_json(made: Programme) -> Json:
    """SI and radians; None for what is not known."""
    baseline = made.baseline
    return {
        "schema": SCHEMA,
        "aircraft": made.aircraft.name,
        "logs": [str(f.path) for f in made.flights],
        "baseline": _baseline(baseline),
        "baseline_of": {
            "source": baseline.source,
            "points": list(baseline.points),
            "method": baseline.method,
            "pooled_by": POOLED_BY if baseline.points else "",
        },
        "remarks": list(made.remarks),
        "points": [_point(made, i, p) for i, p in enumerate(made.points)],
    }


def _baseline(baseline: Baseline) -> Json:
    own, calm = baseline.values.get(OWN, {}), baseline.values.get(CALM, {})
    first, definition = (own, OWN) if own else (calm, CALM)
    made = {n: _pooled(first.get(n)) | {"definition": definition} for n in LONGITUDINAL}
    if own and calm:
        for name, entry in made.items():
            entry[CALM] = _pooled(calm.get(name)) | {"definition": CALM}
    return made | {"CD_0": _pooled(baseline.drag) | {"definition": "energy"}}


def _pooled(p: Pooled | None) -> Json:
    if p is None:
        return {"estimate": None, "std_error": None, "ci95": None, "status": "unestimated", "points": 0}
    scatter = p.between if math.isfinite(p.between) else None
    return {
        "estimate": p.value,
        "std_error": p.error,
        "ci95": list(p.interval),
        "status": "estimated",
        "between_point_sd": scatter,
        "points": p.number,
    }


def _point(made: Programme, place: int, point: FlownPoint) -> Json:
    found = point.found
    methods: Json = {}
    if found is not None and point.methods is not None:
        all_of_it = identification_json(found)["methods"]
        for name, result in point.methods.items():
            entry = all_of_it[name]
            if result.status != found.methods[name].status:
                entry["status"], entry["why"] = result.status, result.why
                for one in entry["parameters"].values():
                    one["status"], one["why"] = "invalid", result.why
            methods[name] = entry | {"change_percent": _changes(made.changes[place][name])}
    best = recommended(point)
    return {
        "number": point.number,
        "name": point.name,
        "condition": point.condition,
        "log": point.log,
        "interval_s": [point.start_s, point.end_s],
        "status": "ok" if found is not None else "not_applicable",
        "why": point.why,
        "inputs_s": [[i.start_s, i.end_s] for i in point.inputs],
        "turbulence": {
            "level": point.turbulence if point.turbulence != "unknown" else None,
            "w_std_2_7hz_mps": point.gust_sd if math.isfinite(point.gust_sd) else None,
            "judged": "during the inputs",
        },
        "recommended": best,
        "CD_0": _drag(point, made.change(place)["CD_0"].why),
        "methods": methods,
        "change_percent": _changes(made.change(place)),
        "like": made.likeness(place) if point.title not in made.baseline.points else "",
    }


def _drag(point: FlownPoint, why: str) -> Json:
    if point.drag is None:
        return {"estimate": None, "std_error": None, "ci95": None, "status": "unestimated", "why": why}
    value, error = point.drag.value, point.drag.error
    ends = [value - NORMAL_95 * error, value + NORMAL_95 * error]
    return {"estimate": value, "std_error": error, "ci95": ends, "status": "estimated", "why": ""}


def _changes(changes: Any) -> Json:
    return {n: _change(c) for n, c in changes.items()}


def _change(change: Change) -> Json:
    if not change.is_known:
        return {"estimate": None, "ci95": None, "status": "unestimated", "why": change.why}
    return {"estimate": change.estimate, "ci95": [change.low, change.high], "status": "estimated", "why": ""}
