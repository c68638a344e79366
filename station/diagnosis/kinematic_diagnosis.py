"""Diagnosis without aerodynamics: what the instruments of a record say of each other, and what cannot be judged.

For aircraft that nobody has described, and records without an elevator. The vane's zero, scale and delay come from
vane_calibration, biases from the reconstruction of compatibility; an effect is named where its estimate is ACCEPTED
standard deviations from what changes nothing. Gusts that hide the vane are said, and the vane is then not judged.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import G0
from station.diagnosis.checks import Checked, merged
from station.diagnosis.diagnosis_report import FILE_NAME, effects_table
from station.diagnosis.effects import BY_ID, extended
from station.diagnosis.measured_record import Seen, held_samples, why_not_flown
from station.estimation.flight_record import FlightRecord
from station.identification.html_page import text, write_page
from station.identification.instrument_pages import kinematic_pages
from station.identification.kinematics import Kinematics, kinematics
from station.identification.preparation import corrected, flight_record
from station.model.compatibility import Compatibility
from station.model.vane_calibration import VaneCalibration
from station.numerics.regression import NotIdentifiable
from station.numerics.second_order import vane_lag
from station.profile import Aircraft
from station.rows import ParamEstimate, Status, UsageError

Array = NDArray[np.float64]

ACCEPTED: Final = 4.0
"""Standard deviations of an estimate from nothing: the evidence that diagnosis asks of a first effect."""
BLOCK_S: Final = 5.0
RESAMPLES: Final = 400
FIRM: Final = {"alpha_vane.bias": math.radians(0.2), "alpha_vane.scale": 0.02, "alpha_vane.delay": 0.01,
               "q.bias": math.radians(0.1),"accelerometer.bias": 0.01 * G0,
               "dynamic_pressure.scale": 0.02}  # fmt: skip
"""Below that a deviation is of no consequence, SI."""
BIASES: Final = {"q_bias": "q.bias", "az_bias": "accelerometer.bias", "airspeed_scale": "dynamic_pressure.scale"}
"""Parameters of the reconstruction, and the effects that they are."""
HELD: Final = ("alpha_vane", "theta", "v_down")
"""Signals that are asked whether they repeat their values."""
AERODYNAMIC: Final = "derivatives, mass, inertia, CG, elevator and the gust's way to wing and tail"


@dataclass(frozen=True, slots=True)
class Judged:
    """One record and its kinematics."""

    name: str
    record: FlightRecord
    made: Kinematics
    seen: tuple[Seen, ...]
    remarks: tuple[str, ...]


def judge(name: str, flown: Checked, aircraft: Aircraft, span: tuple[float, float] = (-math.inf, math.inf)) -> Judged:
    """The kinematics of a span (s) of a recording. Raises UsageError where there is nothing to judge."""
    place, noise = flown.imu_position, flown.noise
    table = flown.table.between(*span)
    try:
        record, _ = flight_record(corrected(table, aircraft, noise, place), aircraft, place, noise)
    except NotIdentifiable as refusal:
        raise UsageError(f"{name}: cannot be diagnosed: {refusal}") from refusal
    made = kinematics(record)
    if isinstance(made.vane, str) and isinstance(made.compatibility, str):
        raise UsageError(f"{name}: nothing can be judged: {made.vane}; {made.compatibility}")
    return Judged(name, record, made, flown.seen, flown.remarks)


def diagnose_kinematics(
    fitted: Sequence[Judged], held_out: Sequence[Judged], aircraft: Aircraft
) -> tuple[dict[str, Any], Aircraft]:
    """station.diagnose/1 of the kinematic part, with what was judged and what was not; and the extended profile."""
    effects, judged, not_judged = _effects(fitted, aircraft)
    seen = _seen(fitted)
    named = [*map(_seen_json, seen), *effects]
    verdict = "no_effect"
    if named:
        verdict = "confounded" if any(e["confounded_with"] for e in named) else "effect_found"
    calm = [j for j in fitted if isinstance(j.made.vane, VaneCalibration) and j.made.vane.is_calm]
    residuals = {}
    if calm:
        before = [j.made.vane.rms_before for j in calm if isinstance(j.made.vane, VaneCalibration)]
        after = [j.made.vane.rms_after for j in calm if isinstance(j.made.vane, VaneCalibration)]
        residuals["alpha_vane"] = {"rms_before": _rms(before), "rms_after": _rms(after), "white": False}
    values = {e["id"]: e["value"] for e in effects}
    remarks = [f"kinematic part only: judged {', '.join(judged) or 'nothing'}"]
    remarks += [f"not judged: {what}: {why}" for what, why in not_judged.items()]
    remarks += dict.fromkeys(words for j in (*fitted, *held_out) for words in j.remarks)
    result = {
        "schema": "station.diagnose/1",
        "aircraft": aircraft.name,
        "fitted_on": [j.name for j in fitted],
        "held_out": [j.name for j in held_out],
        "verdict": verdict,
        "effects": named,
        "gain": _gain(values, held_out),
        "unexplained": {"present": False, "signals": [], "band_hz": []},
        "residuals": residuals,
        "judged": judged,
        "not_judged": not_judged,
        "remarks": remarks,
    }
    return result, extended(aircraft, values)


def _effects(fitted: Sequence[Judged], aircraft: Aircraft) -> tuple[list[dict[str, Any]], list[str], dict[str, str]]:
    """Effects, what was judged, and what was not with its reason."""
    estimates: dict[str, list[tuple[float, float]]] = {}
    reasons: dict[str, str] = {}
    for j in fitted:
        for name, p in _estimates(j, aircraft).items():
            if p.status is Status.ESTIMATED:
                estimates.setdefault(name, []).append((p.value, p.sd))
            else:
                reasons.setdefault(name, p.why)
        for what, part in (("the vane's zero, scale and delay", j.made.vane), ("biases", j.made.compatibility)):
            if isinstance(part, str):
                reasons.setdefault(what, part)
    vane = [n for n in estimates if n.startswith("alpha_vane") and _is_beyond(n, *_pooled(estimates[n]))]
    if vane and "dynamic_pressure.scale" in estimates:
        # The reconstruction has no delay of the vane: what that leaves there would be taken for airspeed.
        del estimates["dynamic_pressure.scale"]
        reasons["dynamic_pressure.scale"] = "the vane is off: mend it first"
    effects: list[dict[str, Any]] = []
    for name, found in estimates.items():
        value, sd = _pooled(found)
        if not _is_beyond(name, value, sd):
            continue
        term = BY_ID[name]
        alternatives: list[str] = []
        if name == "alpha_vane.delay" and aircraft.boom is None:
            alternatives = ["alpha_vane.position"]
        if name == "accelerometer.bias":
            alternatives = ["theta.bias"]
        effects.append(
            {
                "id": name,
                "sentence": term.words(value),
                "value": value,
                "unit": term.unit,
                "ci95": [value - 1.96 * sd, value + 1.96 * sd],
                "evidence": {
                    "p_value": math.erfc(abs(value) / sd / math.sqrt(2)),
                    "signature": f"{term.target} against the other instruments",
                    "drop": (value / sd) ** 2,
                },
                "confounded_with": alternatives,
                "separate_by": term.separate_by if alternatives else "",
                "suspect": False,
            }
        )
    effects.sort(key=lambda e: -e["evidence"]["drop"])
    why = why_not_flown(aircraft) or "the record has no elevator"
    not_judged = {name: reason for name, reason in reasons.items() if name not in estimates}
    return effects, sorted(estimates), {**not_judged, AERODYNAMIC: why}


def _estimates(j: Judged, aircraft: Aircraft) -> dict[str, ParamEstimate]:
    """By effect: how far from the profile, and whether the record tells it."""
    out = {}
    part = j.made.vane
    if isinstance(part, VaneCalibration):
        zero, scale, lag = _stated(aircraft)
        status = Status.ESTIMATED if part.is_calm else Status.UNESTIMATED
        why = "" if part.is_calm else f"gusts: the motion explains {max(part.r2, 0.0):.0%} of the reading"
        for name, value, sd in (
            ("alpha_vane.bias", part.bias.value - zero, part.bias.sd),
            ("alpha_vane.scale", part.scale.value / scale - 1, part.scale.sd / scale),
            ("alpha_vane.delay", part.delay.value - lag, part.delay.sd),
        ):
            out[name] = ParamEstimate(name, value, sd, status, why)
    if isinstance(j.made.compatibility, Compatibility):
        for p in j.made.compatibility.parameters:
            effect = BIASES.get(p.name)
            if effect == "dynamic_pressure.scale":
                out[effect] = ParamEstimate(effect, p.value**2 - 1, 2 * p.value * p.sd, p.status, p.why)
            elif effect is not None:
                out[effect] = ParamEstimate(effect, p.value, p.sd, p.status, p.why)
    return out


def _stated(aircraft: Aircraft) -> tuple[float, float, float]:
    """Zero (rad), scale and delay (s) that the profile gives the vane: a second-order one follows slow motion late."""
    boom = aircraft.boom
    if boom is None:
        return 0.0, 1.0, 0.0
    return boom.zero, 1 / boom.steady_calibration, vane_lag(boom.vane_frequency, boom.vane_damping)


def _is_beyond(name: str, value: float, sd: float) -> bool:
    return abs(value) >= max(ACCEPTED * sd, FIRM[name])


def _pooled(found: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Weighted mean; its sd is widened where the records disagree by more than theirs."""
    values, sds = np.array(found).T
    weight = 1 / sds**2
    mean = float((weight * values).sum() / weight.sum())
    spread = float((weight * (values - mean) ** 2).sum() / max(len(values) - 1, 1))
    return mean, math.sqrt(max(spread, 1.0) / float(weight.sum()))


def _seen(fitted: Sequence[Judged]) -> tuple[Seen, ...]:
    """Signs, units and repeated values."""
    held: dict[str, list[float]] = {}
    for j in fitted:
        for name in HELD:
            column = j.record.motion.get(name)
            fresh = held_samples(column[j.made.rows]) if column is not None else np.empty(0)
            if len(fresh):
                held.setdefault(name, []).append(float(np.median(np.diff(fresh))) * j.record.dt)
    return merged([s for j in fitted for s in j.seen], held, 0.0)


def _seen_json(s: Seen) -> dict[str, Any]:
    evidence = {"p_value": 0.0, "signature": s.signature, "drop": None}
    return {"id": s.id, "sentence": s.sentence, "value": s.value, "unit": s.unit, "ci95": [s.value, s.value],
            "evidence": evidence, "confounded_with": list(s.alternatives),
            "separate_by": s.separate_by if s.alternatives else "", "suspect": False}  # fmt: skip


def _gain(values: Mapping[str, float], held_out: Sequence[Judged]) -> dict[str, Any] | None:
    """Vane against the inertial flow angle in records not used, before and after its zero, scale and delay."""
    own = {n: v for n, v in values.items() if n.startswith("alpha_vane.")}
    squares = []
    for j in held_out:
        part = j.made.vane
        if not own or not isinstance(part, VaneCalibration):
            continue
        zero, scale, lag = _stated(j.record.aircraft)
        reading = j.record.motion["alpha_vane"][j.made.rows]
        t = np.arange(len(reading)) * j.record.dt
        before = (np.interp(t + lag, t, reading) - zero) / scale - part.expected
        late = np.interp(t + lag + own.get("alpha_vane.delay", 0.0), t, reading)
        found = (zero + own.get("alpha_vane.bias", 0.0), scale * (1 + own.get("alpha_vane.scale", 0.0)))
        after = (late - found[0]) / found[1] - part.expected
        width = round(BLOCK_S / j.record.dt)
        squares += [
            (float(before[a : a + width] @ before[a : a + width]), float(after[a : a + width] @ after[a : a + width]),
             float(width))
            for a in range(0, len(reading) - width + 1, width)
        ]  # fmt: skip
    if not squares:
        return None
    table = np.array(squares)

    def reduction(rows: Array) -> float:
        return 100 * (1 - math.sqrt(rows[:, 1].sum() / rows[:, 0].sum()))

    rng = np.random.default_rng(2)
    draws = [reduction(table[rng.integers(0, len(table), len(table))]) for _ in range(RESAMPLES)]
    total = table.sum(0)
    return {
        "metric": "held-out vane against inertial flow angle, rad rms",
        "before": math.sqrt(total[0] / total[2]),
        "after": math.sqrt(total[1] / total[2]),
        "reduction_percent": reduction(table),
        "ci95": np.quantile(draws, [0.025, 0.975]).tolist(),
        "by_record": [],
    }


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(sum(v * v for v in values) / len(values))


def series_in_time(fitted: Sequence[Judged]) -> dict[str, dict[str, tuple[Array, Array]]]:
    """Vane and motion of each record, deg over s, by plot and line."""
    plots: dict[str, dict[str, tuple[Array, Array]]] = {}
    for j in fitted:
        part = j.made.vane
        if isinstance(part, VaneCalibration):
            t = j.record.t_s[j.made.rows]
            reading = j.record.motion["alpha_vane"][j.made.rows]
            lines = {"vane": reading, "vane, calibrated": part.corrected, "motion": part.expected}
            plots[f"{j.name}: angle of attack, deg"] = {n: (t, np.degrees(y)) for n, y in lines.items()}
    return plots


def write_kinematic_report(result: Mapping[str, Any], fitted: Sequence[Judged], folder: Path) -> Path:
    """The page: verdict, effects, each record's calibration with its pictures, and what was not judged."""
    kinematic = {
        "no_effect": "The instruments agree with each other within noise.",
        "effect_found": "Instruments disagree with each other.",
        "confounded": "Instruments disagree with each other; this record does not tell which of two causes it is.",
    }
    lines = "".join(f"<li>{text(w)}: {text(y)}</li>" for w, y in result["not_judged"].items())
    body = [
        f"<h1>{text(result['aircraft'])}: what the instruments say of each other</h1>",
        f'<p class="verdict">{kinematic[result["verdict"]]}</p>',
        "<p>Kinematic part only: without aerodynamic data nothing is simulated.</p>",
        effects_table(result),
        f"<h2>Not judged</h2><ul>{lines}</ul>",
    ]
    for j in fitted:
        body.append(f"<h1>{text(j.name)}</h1>")
        body += kinematic_pages(replace(j.made, delay="it needs the aircraft's lift"), j.record)
    return write_page(f"Diagnosis: {result['aircraft']}", body, folder / FILE_NAME)
