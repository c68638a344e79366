"""The kinematic part of an identification as JSON: instrument errors, vane calibration, gust delay."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from station.estimation.flight_record import FlightRecord
from station.identification.kinematics import Kinematics
from station.identification.model_structure import compare_structures
from station.model.compatibility import Compatibility
from station.model.gust_delay import GustDelay, Lead
from station.model.vane_calibration import CALM_R2, VaneCalibration
from station.numerics.regression import NotIdentifiable
from station.rows import AlphaEstimate

Array = NDArray[np.float64]

CI95: Final = 1.96
AGREED_SD: Final = 3.0


def instruments_json(made: Kinematics, record: FlightRecord) -> dict[str, Any]:
    """`compatibility`, `vane_calibration` and `gust_delay`, each with its status; numbers in SI, rad."""
    return {
        "compatibility": _section(made.compatibility, record, made.closed, _compatibility),
        "vane_calibration": _section(made.vane, record, made.rows, _vane),
        "gust_delay": _section(made.delay, record, made.rows, _delay),
    }


def structure_json(record: FlightRecord, t_s: Array, alphas: Sequence[AlphaEstimate]) -> dict[str, Any]:
    """`model_structure`: for CL and Cm the structures of estimation.structure, and the one that the data prefer.

    `alphas` at `t_s` (n,): the angles of attack of motion and gust that the live estimator found.
    """
    refused = {"status": "not_applicable", "why": ""}
    arm = record.aircraft.unsteady.tail_arm
    if arm <= 0:
        return refused | {"why": "the aircraft profile gives no tail arm"}
    if not record.has("theta", "v_down"):
        return refused | {"why": "no attitude or vertical velocity"}
    if not len(t_s):
        return refused | {"why": "the live estimator did not run"}
    motion, gust = (np.array([getattr(a, n) for a in alphas]) for n in ("alpha_inertial", "alpha_gust"))
    good = np.isfinite(motion) & np.isfinite(gust)
    # From the first angles on: before, the filters settle.
    first = int(np.argmax(good)) if good.any() else len(good)
    inside = record.t_s >= (t_s[first] if first < len(t_s) else np.inf)
    t = record.t_s[inside]
    if not len(t) or not good[first:].all() or not record.usable[inside].all():
        return refused | {"why": "no inertial angle of attack throughout"}
    late = arm / record.motion["airspeed"][inside]
    regressors = {
        "alpha_i": np.interp(t, t_s, motion),
        "alpha_g": np.interp(t, t_s, gust),
        "alpha_g_tail": np.interp(t - late, t_s, gust),
        "q": record.coefficients.qhat[inside],
        "de": record.motion["elevator"][inside],
    }
    found: dict[str, Any] = {}
    for equation in ("CL", "Cm"):
        measured = record.coefficients.named(equation)[inside]
        if not np.isfinite(measured).all():
            continue
        try:
            made = compare_structures(regressors, measured, record.dt)
        except NotIdentifiable as refusal:
            return refused | {"why": str(refusal)}
        found[equation] = {
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
    return {"status": "ok", "why": "", "equations": found}


def _section(part: Any, record: FlightRecord, rows: slice, tell: Any) -> dict[str, Any]:
    if isinstance(part, str):
        return {"status": "not_applicable", "why": part}
    interval = [float(record.t_s[rows.start]), float(record.t_s[rows.stop - 1])]
    return {"status": "ok", "why": "", "interval_s": interval, **tell(part, record)}


def _number(value: float, sd: float, status: str = "estimated", why: str = "") -> dict[str, Any]:
    interval = [value - CI95 * sd, value + CI95 * sd]
    return {"estimate": value, "std_error": sd, "ci95": interval, "status": status, "why": why}


def _compatibility(part: Compatibility, _: FlightRecord) -> dict[str, Any]:
    return {
        "parameters": {p.name: _number(p.value, p.sd, p.status.value, p.why) for p in part.parameters},
        "residual_rms": dict(part.residual_rms),
        "iterations": part.iterations,
    }


def _vane(part: VaneCalibration, record: FlightRecord) -> dict[str, Any]:
    boom = record.aircraft.boom
    assumes = ["no mean vertical wind"]
    if boom is None:
        assumes.append("vane at the CG: for one x ahead, slow pitching adds x/V to the delay")
    told = "" if part.is_calm else f"gusts: the motion explains {max(part.r2, 0.0):.0%} of the reading"
    status = "estimated" if part.is_calm else "unestimated"
    made: dict[str, Any] = {
        "parameters": {
            "zero": _number(part.zero.value, part.zero.sd, status, told),
            "scale": _number(part.scale.value, part.scale.sd, status, told),
            "delay": _number(part.delay.value, part.delay.sd, status, told),
        },
        "units": {"zero": "rad", "scale": "1", "delay": "s"},
        "method": "least squares" if part.is_calm else "generalised least squares",
        "calm_above_r2": CALM_R2,
        "r2": part.r2,
        "rms_before_rad": part.rms_before,
        "rms_after_rad": part.rms_after,
        "assumes": assumes,
    }
    if boom is not None:
        made["profile"] = {"zero": boom.zero, "scale": 1 / boom.steady_calibration, "vane_x_m": boom.vane_x}
    return made


def _delay(part: GustDelay, record: FlightRecord) -> dict[str, Any]:
    boom = record.aircraft.boom
    made = {
        "parameters": _lead(part.joint),
        "by_equation": {name: _lead(lead) for name, lead in part.apart.items()},
        "equations_agree": part.agree,
        "speed_mps": part.speed,
        "band_hz": list(part.band_hz),
        "residual_over_noise": part.joint.excess,
    }
    if not part.agree:
        differ = "ask for different delays" if len(part.apart) > 1 else "do not both tell a delay"
        made["meaning"] = f"lift and moment {differ}: not the vane, but the tail or the wing's memory"
    if boom is not None:
        profile = {"delay": boom.gust_x / part.speed, "upwash": boom.upwash_body + boom.upwash_wing}
        made["profile"] = profile
        made["profile_fits"] = bool(
            abs(part.joint.delay_s - profile["delay"]) <= AGREED_SD * part.joint.delay_sd + 0.002
            and abs(part.joint.upwash - profile["upwash"]) <= AGREED_SD * part.joint.upwash_sd
        )
    return made


def _lead(lead: Lead) -> dict[str, Any]:
    upwash = _number(lead.upwash, lead.upwash_sd) | {"std_error_statistical": lead.upwash_statistical}
    if not math.isfinite(lead.upwash_sd):
        why = "motion and gust act too much alike on lift and moment; the profile's was taken"
        nothing = {"estimate": None, "std_error": None, "ci95": None, "std_error_statistical": None}
        upwash = {**nothing, "status": "unestimated", "why": why}
    return {
        "delay": _number(lead.delay_s, lead.delay_sd) | {"std_error_statistical": lead.delay_statistical},
        "distance": _number(lead.distance_m, lead.distance_sd) | {"std_error_statistical": lead.distance_statistical},
        "upwash": upwash,
    }
