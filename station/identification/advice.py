"""What an identification says about its own input: lines sifted from a multisine, and which input to fly next."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import LATERAL, LONGITUDINAL
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
    with_airframe_errors,
)
from station.identification.input_ranking import Input, rank_inputs
from station.identification.sifting import sift
from station.numerics.regression import NotIdentifiable
from station.numerics.second_order import inverse_terms
from station.profile import Card, Multisine
from station.rows import ParamEstimate, Status

Array = NDArray[np.float64]

SIFTED: Final = ("II", "split")
"""Methods that lines can be sifted for."""
NO_ANGLE: Final = "no angle of attack throughout"


@dataclass(frozen=True, slots=True)
class SiftedMethod:
    """A method's derivatives, estimate and standard error of each, from the lines that the multisine excites."""

    parameters: Mapping[str, tuple[float, float]]
    agree: bool
    """Whether the lines between give the same."""
    lines_hz: Array


@dataclass(frozen=True, slots=True)
class NextInput:
    """The derivative with the largest relative error, and the elevator inputs ranked by what they would leave of it."""

    poorest: str
    relative: float
    """Two standard errors over its size; inf where nothing is known of it."""
    ranking: tuple[Input, ...]


def sifted(
    record: FlightRecord, alphas: Mapping[str, Array | None], card: Card | None, axes: Axes
) -> Mapping[str, SiftedMethod] | str:
    """For each method of `alphas` (its angle of attack (n,)) the derivatives of every axis from the lines of the card's
    multisines alone; or why there are none."""
    waves = [m for m in (card.inputs if card else ()) if isinstance(m, Multisine)]
    if card is None or not waves:
        return "no multisine on the card"
    if not record.usable.all():
        return "rows are missing"
    made: dict[str, SiftedMethod] = {}
    for name, alpha in alphas.items():
        if alpha is None or not np.isfinite(alpha).all():
            continue
        try:
            made[name] = _sifted(record, alpha, waves, (card.low, card.high), axes)
        except NotIdentifiable as refusal:
            return str(refusal)
    return made or NO_ANGLE


def _sifted(
    record: FlightRecord, alpha: Array, waves: Sequence[Multisine], band_hz: tuple[float, float], axes: Axes
) -> SiftedMethod:
    """Raises NotIdentifiable where no axis has lines of its own."""
    parameters: dict[str, tuple[float, float]] = {}
    agree, lines = True, set[float]()
    refusal = NotIdentifiable(NO_ANGLE)
    for equation in equations(record, axes):
        own = [m for m in waves if m.surface in equation.surfaces]
        if not own or not np.isfinite(equation.measured).all():
            continue
        columns = [*equation.regressors.T]
        if "elevator" in equation.surfaces:
            columns[0] = alpha
        else:
            columns[0] = columns[0] + _vane_lag_undone(record)
        surfaces = [record.motion[name] for name in sorted({m.surface for m in own})]
        try:
            found = sift(columns, equation.measured, surfaces, record.dt, own[0].repeat or own[0].duration, band_hz)
        except NotIdentifiable as why:
            refusal = why
            continue
        pairs = zip(found.estimate.tolist(), found.std_error.tolist(), strict=True)
        parameters |= dict(zip(equation.parameters, pairs, strict=True))
        agree = agree and found.agree
        lines |= set(found.lines_hz.tolist())
    if not parameters:
        raise refusal
    return SiftedMethod(parameters, agree, np.array(sorted(lines)))


def _vane_lag_undone(record: FlightRecord) -> Array:
    """What the sideslip vane (n,), rad, has yet to show: the equations take its reading as it is."""
    boom = record.aircraft.boom
    if boom is None:
        return np.zeros(len(record.t_s))
    first, second = inverse_terms(boom.vane_frequency, boom.vane_damping)
    rate = np.gradient(record.motion["beta_vane"], record.dt)
    return np.asarray(first * rate + second * np.gradient(rate, record.dt))


def sifted_results(
    found: Mapping[str, SiftedMethod] | str, record: FlightRecord, axes: Axes
) -> dict[str, MethodResult]:
    """What `sifted` found in the place of each method's own estimates, refusals included."""
    results = {}
    for method in SIFTED:
        if isinstance(found, str) or method not in found:
            why = found if isinstance(found, str) else NO_ANGLE
            results[method] = not_applicable(f"lines cannot be sifted: {why}", names(axes))
            continue
        made = found[method]
        parameters: list[ParamEstimate] = []
        for name in (*names(axes), *(n for n in made.parameters if n in LATERAL)):
            if name in made.parameters:
                value, error = (np.array([x]) for x in made.parameters[name])
                parameters += judge(record, [name], value, error, None)
            else:
                parameters += unknown([name], Status.INVALID, "no finite coefficient")
        settings = {"sifted_lines_hz": made.lines_hz.tolist(), "lines_between_agree": made.agree}
        results[method] = with_airframe_errors(result_of(parameters, {}, settings), record)
    return results


def next_input(
    record: FlightRecord, result: MethodResult | None, fit: Mapping[str, EquationFit] | None = None
) -> NextInput | str:
    """The least well known derivative of `result`, and the elevator inputs that would give the most information on it;
    or why they cannot be predicted.

    `fit`: how well the equations follow the record, if that is known: errors are predicted from its residuals.
    """
    aircraft = record.aircraft
    worst, size = "Cm_q", math.inf
    if result is not None:
        shares = {}
        for name, p in ((p.name.replace("CZ_", "CL_"), p) for p in result.parameters):
            if name in LONGITUDINAL:
                scale = max(abs(p.value), abs(aircraft.value(name))) if math.isfinite(p.value) else math.nan
                is_known = p.status is not Status.INVALID and math.isfinite(p.sd) and scale > 0
                shares[name] = 2 * p.sd / scale if is_known else math.inf
        if shares:
            worst, size = max(shares.items(), key=lambda item: item[1])
    residual = {n.replace("CZ", "CL"): f.residual_rms for n, f in (fit or {}).items() if f.residual_rms > 0}
    speed = float(np.nanmean(record.motion["airspeed"]))
    try:
        ranked = rank_inputs(aircraft, speed, record.mean_density, worst, residual)
    except NotIdentifiable as refusal:
        return str(refusal)
    return NextInput(worst, size, tuple(ranked))
