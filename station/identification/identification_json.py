"""An identification as station.identify/1, the JSON that `identify --json` writes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from station.estimation.flight_record import FlightRecord
from station.estimation.method_table import METHODS
from station.estimation.results import Axes, MethodResult
from station.identification.advice import NextInput, SiftedMethod
from station.identification.angle_consistency import Consistency, Transformation
from station.identification.drag_results import drag_json, drag_of
from station.identification.handling_qualities import derived_json, identified_qualities
from station.identification.identified import Identification
from station.identification.instrument_table import as_json as instruments_json
from station.identification.kinematic_results import (
    NOT_SEPARATED,
    VANE_UNITS,
    arrival_by_profile,
    disagreement,
    profile_fits,
    vane_assumptions,
    vane_by_profile,
    vane_method,
    vane_parameters,
)
from station.identification.kinematics import Kinematics
from station.identification.model_structure import Comparison
from station.model.compatibility import Compatibility
from station.model.gust_delay import Arrival, GustDelay
from station.model.vane_calibration import CALM_R2, VaneCalibration
from station.rows import ParamEstimate

SCHEMA: Final = "station.identify/1"
CI95: Final = 1.96
"""Standard deviations to either end of a 95 % interval."""
RANKED: Final = 5
"""Inputs that are listed."""

Json = dict[str, Any]


def as_json(found: Identification) -> Json:
    """SI and radians; None for what is not known."""
    is_known = found.turbulence != "unknown"
    return {
        "schema": SCHEMA,
        "log": found.log,
        "aircraft": found.aircraft.name,
        "interval_s": list(found.interval_s),
        "axes": found.axes,
        "turbulence": {"level": found.turbulence if is_known else None, "w_std_2_7hz_mps": _finite(found.gust_sd)},
        "remarks": list(found.remarks),
        "hint": found.hint,
        **(instruments_json(found.instruments) if found.instruments is not None else {}),
        "methods": {name: _method(name, result) for name, result in found.methods.items()},
        "recommended": found.recommended,
        "derived": derived_json(identified_qualities(found)),
        "drag": drag_json(drag_of(found.record)),
        "consistency": _consistency(found.consistency, found.axes),
        **(kinematics_json(found.kinematics, found.record) if found.kinematics else {}),
        **_section("model_structure", found.structures, _structures),
        **_section("sifted", found.sifted, _sifted),
        **_section("next_input", found.next_input, _next_input),
    }


def kinematics_json(made: Kinematics, record: FlightRecord) -> Json:
    """`compatibility`, `vane_calibration` and `gust_delay`, each with its status and interval."""

    def during(rows: slice) -> Json:
        return {"interval_s": [float(record.t_s[rows.start]), float(record.t_s[rows.stop - 1])]}

    return {
        **_section("compatibility", made.compatibility, lambda part: during(made.closed) | _compatibility(part)),
        **_section("vane_calibration", made.vane, lambda part: during(made.rows) | _vane(part, record)),
        **_section("gust_delay", made.delay, lambda part: during(made.rows) | _gust_delay(part, record)),
    }


def _section(name: str, part: Any, written: Any) -> Json:
    """A part as JSON, or the reason in its place; nothing where it was not asked for."""
    if part is None:
        return {}
    if isinstance(part, str):
        return {name: {"status": "not_applicable", "why": part}}
    return {name: {"status": "ok", "why": "", **written(part)}}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _method(name: str, result: MethodResult) -> Json:
    definition = METHODS[name].definition
    made: Json = {
        "status": result.status,
        "why": result.why,
        "definition": definition,
        "parameters": {p.name: _parameter(p, definition) for p in result.parameters},
        "fit": {n: {"r2": _finite(f.r2), "residual_rms": _finite(f.residual_rms)} for n, f in result.fit.items()},
        "settings": dict(result.settings),
    }
    for one, error in result.statistical.items():
        if made["parameters"][one]["ci95"] is not None:
            made["parameters"][one]["std_error_statistical"] = _finite(error)
    if result.quasi_steady:
        made["quasi_steady"] = {p.name: _parameter(p, "quasi_steady") for p in result.quasi_steady}
    if result.history:
        made["history"] = dict(result.history)
    return made


def _parameter(p: ParamEstimate, definition: str) -> Json:
    value, sd = _finite(p.value), _finite(p.sd)
    is_known = value is not None and sd is not None
    return {
        "estimate": value,
        "std_error": sd,
        "ci95": [p.value - CI95 * p.sd, p.value + CI95 * p.sd] if is_known else None,
        "status": p.status.value,
        "why": p.why,
        "definition": definition,
    }


def _consistency(found: Consistency | None, axes: Axes) -> Json:
    if found is None:
        return {}

    def numbers(t: Transformation) -> Json:
        return {"t_alpha": t.t_alpha, "t_q": t.t_q, "t_de": t.t_de}

    force = "CL" if axes == "wind" else "CZ"
    pairs = [
        {"from": found.base, "to": p.method, force: numbers(p.force), "Cm": numbers(p.moment), "agree": p.agree}
        for p in found.pairs
    ]
    return {"base": found.base, "pairs": pairs}


def _number(value: float, sd: float, status: str = "estimated", why: str = "") -> Json:
    interval = [value - CI95 * sd, value + CI95 * sd]
    return {"estimate": value, "std_error": sd, "ci95": interval, "status": status, "why": why}


def _named(parameters: tuple[ParamEstimate, ...]) -> Json:
    return {p.name: _number(p.value, p.sd, p.status.value, p.why) for p in parameters}


def _compatibility(part: Compatibility) -> Json:
    return {
        "parameters": _named(part.parameters),
        "residual_rms": dict(part.residual_rms),
        "iterations": part.iterations,
    }


def _vane(part: VaneCalibration, record: FlightRecord) -> Json:
    made: Json = {
        "parameters": _named(vane_parameters(part)),
        "units": dict(VANE_UNITS),
        "method": vane_method(part),
        "calm_above_r2": CALM_R2,
        "r2": part.r2,
        "rms_before_rad": part.rms_before,
        "rms_after_rad": part.rms_after,
        "assumes": list(vane_assumptions(record.aircraft)),
    }
    if record.aircraft.boom is not None:
        made["profile"] = {**vane_by_profile(record.aircraft), "vane_x_m": record.aircraft.boom.vane_x}
    return made


def _gust_delay(part: GustDelay, record: FlightRecord) -> Json:
    made: Json = {
        "parameters": _arrival(part.joint),
        "by_equation": {name: _arrival(one) for name, one in part.apart.items()},
        "equations_agree": part.agree,
        "speed_mps": part.speed,
        "band_hz": list(part.band_hz),
        "residual_over_noise": part.joint.excess,
    }
    if not part.agree:
        made["meaning"] = disagreement(part)
    stated = arrival_by_profile(part, record.aircraft)
    if stated is not None:
        made["profile"] = {"delay": stated.delay_s, "upwash": stated.upwash}
        made["profile_fits"] = profile_fits(part, stated)
    return made


def _arrival(one: Arrival) -> Json:
    upwash = _number(one.upwash, one.upwash_sd) | {"std_error_statistical": one.upwash_statistical}
    if not math.isfinite(one.upwash_sd):
        nothing = {"estimate": None, "std_error": None, "ci95": None, "std_error_statistical": None}
        upwash = {**nothing, "status": "unestimated", "why": NOT_SEPARATED}
    return {
        "delay": _number(one.delay_s, one.delay_sd) | {"std_error_statistical": one.delay_statistical},
        "distance": _number(one.distance_m, one.distance_sd) | {"std_error_statistical": one.distance_statistical},
        "upwash": upwash,
    }


def _structures(found: Mapping[str, Comparison]) -> Json:
    return {
        "equations": {
            equation: {
                "preferred": made.preferred,
                "structures": {
                    name: {
                        "parameters": {n: _number(v, s.std_error[n]) for n, v in s.estimate.items()},
                        "residual": s.residual,
                        "held_out": s.held_out,
                        "p_values": dict(s.p_values),
                    }
                    for name, s in made.structures.items()
                },
            }
            for equation, made in found.items()
        }
    }


def _sifted(found: Mapping[str, SiftedMethod]) -> Json:
    return {
        "methods": {
            name: {
                "parameters": {n: {"estimate": v, "std_error": sd} for n, (v, sd) in made.parameters.items()},
                "agree": made.agree,
                "lines_hz": made.lines_hz.tolist(),
            }
            for name, made in found.items()
        }
    }


def _next_input(found: NextInput) -> Json:
    return {
        "poorest": found.poorest,
        "relative_2sd": _finite(found.relative),
        "ranking": [
            {"input": one.name, "predicted_relative_2sd": one.relative[found.poorest]} for one in found.ranking[:RANKED]
        ],
    }
