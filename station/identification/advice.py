"""What an identification says about its own input: lines sifted from a multisine, and which input to fly next."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import LONGITUDINAL
from station.estimation.flight_record import FlightRecord
from station.estimation.results import (
    Axes,
    EquationFit,
    MethodResult,
    equations,
    judge,
    names,
    not_applicable,
    result_of,
    unknown,
)
from station.identification.input_ranking import rank_inputs
from station.identification.sifting import sift
from station.numerics.regression import NotIdentifiable
from station.profile import Card, Multisine
from station.rows import ParamEstimate, Status

Array = NDArray[np.float64]

SHOWN: Final = 5
SIFTED: Final = ("II", "split")
"""Methods that lines can be sifted for."""


def sifted_json(
    record: FlightRecord, alphas: Mapping[str, Array | None], card: Card | None, axes: Axes
) -> dict[str, Any]:
    """`sifted`: for each method of `alphas` (its angle of attack (n,)) the longitudinal derivatives from the lines of
    the card's multisine alone, and whether the lines between agree."""
    refused: dict[str, Any] = {"status": "not_applicable", "why": ""}
    waves = [m for m in (card.manoeuvres if card else ()) if isinstance(m, Multisine)]
    if card is None or not waves:
        return refused | {"why": "no multisine on the card"}
    if not record.usable.all():
        return refused | {"why": "rows are missing"}
    made: dict[str, Any] = {}
    for name, alpha in alphas.items():
        if alpha is None or not np.isfinite(alpha).all():
            continue
        made[name] = {"parameters": {}, "agree": True}
        for equation in equations(record, axes)[:2]:
            if not np.isfinite(equation.measured).all():
                continue
            columns = [alpha, *equation.regressors.T[1:]]
            try:
                found = sift(
                    columns,
                    equation.measured,
                    record.motion["elevator"],
                    record.dt,
                    waves[0].duration,
                    (card.low, card.high),
                )
            except NotIdentifiable as refusal:
                return refused | {"why": str(refusal)}
            rows = zip(equation.parameters, found.estimate.tolist(), found.std_error.tolist(), strict=True)
            made[name]["parameters"] |= {n: {"estimate": value, "std_error": error} for n, value, error in rows}
            made[name]["agree"] = made[name]["agree"] and found.agree
            made[name]["lines_hz"] = found.lines_hz.tolist()
    if not made:
        return refused | {"why": "no angle of attack throughout"}
    return {"status": "ok", "why": "", "methods": made}


def sifted_results(found: Mapping[str, Any], record: FlightRecord, axes: Axes) -> dict[str, MethodResult]:
    """What `sifted_json` found in the place of each method's own estimates, refusals included."""
    results = {}
    for method in SIFTED:
        made = found.get("methods", {}).get(method)
        if made is None:
            why = found["why"] or "no angle of attack throughout"
            results[method] = not_applicable(f"lines cannot be sifted: {why}", names(axes))
            continue
        parameters: list[ParamEstimate] = []
        for name in names(axes):
            p = made["parameters"].get(name)
            if p is None:
                parameters += unknown([name], Status.INVALID, "no finite coefficient")
            else:
                value, error = np.array([p["estimate"]]), np.array([p["std_error"]])
                parameters += judge(record, [name], value, error, None)
        settings = {"sifted_lines_hz": made["lines_hz"], "lines_between_agree": made["agree"]}
        results[method] = result_of(parameters, {}, settings)
    return results


def next_input_json(
    record: FlightRecord, result: MethodResult | None, fit: Mapping[str, EquationFit] | None = None
) -> dict[str, Any]:
    """`next_input`: the derivative known worst, and the elevator inputs that would tell most about it.

    `fit`: how well the equations follow the record, if that is known: errors are predicted from its residuals.
    """
    aircraft = record.aircraft
    worst, size = "Cm_q", math.inf
    if result is not None:
        known = {p.name.replace("CZ_", "CL_"): p for p in result.parameters}
        shares = {}
        for name, p in known.items():
            if name in LONGITUDINAL:
                scale = max(abs(p.value), abs(aircraft.value(name))) if math.isfinite(p.value) else math.nan
                told = p.status is not Status.INVALID and math.isfinite(p.sd) and scale > 0
                shares[name] = 2 * p.sd / scale if told else math.inf
        if shares:
            worst, size = max(shares.items(), key=lambda item: item[1])
    speed = float(np.nanmean(record.motion["airspeed"]))
    density = float(np.nanmean(2 * record.motion["dynamic_pressure"] / record.motion["airspeed"] ** 2))
    try:
        residual = {n.replace("CZ", "CL"): f.residual_rms for n, f in (fit or {}).items() if f.residual_rms > 0}
        ranked = rank_inputs(aircraft, speed, density, worst, residual)
    except NotIdentifiable as refusal:
        return {"status": "not_applicable", "why": str(refusal)}
    return {
        "status": "ok",
        "why": "",
        "poorest": worst,
        "relative_2sd": size if math.isfinite(size) else None,
        "ranking": [{"input": one.name, "predicted_relative_2sd": one.relative[worst]} for one in ranked[:SHOWN]],
    }
