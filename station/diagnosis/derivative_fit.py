"""Method `ml`: derivatives by the likelihood of diagnosis, with nothing hidden.

Every instrument is held against the others and against the aircraft at once, each with its noise, and all constants of
the profile are as uncertain as it says; of the derivatives nothing is known before. Maximum likelihood with errors in
all variables, as station.diagnosis.likelihood has it; laterally gusts that no vane shows are noise that the aircraft
answers. SI, radians, derivatives per radian.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import LATERAL, LONGITUDINAL
from station.diagnosis.axis import ACROSS
from station.diagnosis.candidate import Estimate
from station.diagnosis.checks import Checked
from station.diagnosis.free_parameters import DERIVATIVES
from station.diagnosis.likelihood import Problem
from station.diagnosis.manoeuvre import manoeuvre
from station.diagnosis.measured_record import Record, lateral_record, why_not_flown, why_not_lateral
from station.diagnosis.model_error import with_model_error
from station.diagnosis.null_fit import without_effects
from station.diagnosis.side_by_side import meanwhile
from station.estimation.acceptance import STILL, of_estimate, worded
from station.estimation.flight_record import FlightRecord
from station.estimation.results import (
    LATERAL_FORCES,
    LATERAL_SURFACES,
    MethodResult,
    excited,
    moves_laterally,
    names,
    not_applicable,
    unknown,
    with_airframe_errors,
)
from station.estimation.results import STILL as OF_SURFACE
from station.identification.preparation import Prepared
from station.identification.request import DEFAULT_CARD
from station.model import physical_constants
from station.model.airframe_error import relative_errors
from station.model.quasi_steady import of_elevator
from station.numerics.spectra import grid
from station.profile import Aircraft, Derivative
from station.rows import ParamEstimate, Status, UsageError

Array = NDArray[np.float64]

MOST: Final = 4
"""Manoeuvres that are fitted, those in which the elevator moves most: three of a minute tell all derivatives to what
mass and inertia leave open, and each costs a second."""
_SURE: Final = {"mass": 0.0, "recorded_mass": 0.0, "inertia": 0.0, "dynamic_pressure": 0.0}
"""Of the uncertainty. What multiplies all derivatives of a force by one number no residual shows, where nothing is
known of these: a likelihood whose noise follows the model would make it small. It is in the errors that are told."""
_USUAL: Final = {
    **dict(zip(DERIVATIVES, (5.0, 8.0, 0.4, -1.0, -20.0, -1.5), strict=True)),
    "CY_beta": -0.8,
    "CY_p": 0.0,
    "CY_r": 0.5,
    "CY_da": 0.0,
    "CY_dr": 0.2,
    "Cl_beta": -0.1,
    "Cl_p": -0.45,
    "Cl_r": 0.15,
    "Cl_da": -0.15,
    "Cl_dr": 0.02,
    "Cn_beta": 0.1,
    "Cn_p": -0.05,
    "Cn_r": -0.15,
    "Cn_da": 0.0,
    "Cn_dr": -0.08,
}
"""Of light transports: where the fit begins, and no more, of derivatives that a profile does not give."""
_UNUSUAL: Final = 0.1
"""Standard deviation of the prior of those that are as often above as below zero: no more than where a fit begins."""
_BODY: Final = "estimates wind-axes derivatives only"
_STEP: Final = 0.1
"""Of a prior's standard deviation, over which slopes are taken."""


def begun(ready: Prepared) -> Callable[[], MethodResult]:
    """The fits, made beside what else is done until they are asked for: six longitudinal derivatives, and the lateral
    ones of a record that shows them."""
    request, aircraft, across = ready.request, ready.record.aircraft, moves_laterally(ready.record)
    found, why = _records(ready)
    along: MethodResult | None = None
    if no := why_not_flown(_open(aircraft)) or (_BODY if request.axes == "body" else ""):
        along = not_applicable(no, names(request.axes))
    elif not excited(ready.record, ("elevator",)):
        status, words = worded(STILL)
        along = MethodResult("not_applicable", words, unknown(LONGITUDINAL, status, words))
    elif why:
        along = not_applicable(why, LONGITUDINAL)
    sideways = [r for r in map(lateral_record, found) if isinstance(r, Record)]
    lateral: MethodResult | None = None
    if across and (
        no := why or why_not_lateral(_open(aircraft, LATERAL)) or ("" if sideways else "no piece of it can be fitted")
    ):
        lateral = not_applicable(no, LATERAL)
    calls: list[tuple[Any, ...]] = []
    if along is None:
        card = request.card if request.card is not None else DEFAULT_CARD
        calls.append((_fitted, *_most(found, ("elevator",)), aircraft, grid(card.low, card.high, card.step)))
    if across and lateral is None:
        calls.append((_fitted_across, *_most(sideways, LATERAL_SURFACES), ready.record))
    made = meanwhile(_called, calls) if calls else list

    def told() -> MethodResult:
        results = iter(made())
        first = along or next(results)
        return _joined(first, lateral or next(results)) if across else first

    return told


def _called(fit: Callable[..., MethodResult], *given: Any) -> MethodResult:
    try:
        return fit(*given)
    except (ArithmeticError, ValueError, UsageError) as failure:  # the other methods have theirs
        return not_applicable(f"numerical failure: {failure}", LONGITUDINAL if fit is _fitted else LATERAL)


def _records(ready: Prepared) -> tuple[list[Record], str]:
    """What is flown, in pieces; or why there are none."""
    request = ready.request
    cut = ready.recorded.between(ready.start_s, float(ready.cut.t_s[-1]))
    own = Checked(request.subject, cut, (), (), request.noise, request.imu_position)
    try:
        return own.records(ready.record.aircraft), ""
    except UsageError as refusal:
        return [], str(refusal).removeprefix(f"{request.subject}: ")


def _most(found: Sequence[Record], surfaces: Sequence[str]) -> tuple[list[Record], dict[str, Any]]:
    """The pieces in which surfaces move most, and what is told of them."""

    def moved(r: Record) -> float:
        return float(sum(r.signals[n].std() for n in surfaces if n in r.signals))

    most = sorted(found, key=lambda r: -moved(r))[:MOST]
    return most, {"manoeuvres": len(most), "of": len(found), "seconds": round(sum(r.seconds for r in most), 1)}


def _joined(along: MethodResult, across: MethodResult) -> MethodResult:
    """Of both axes, where either is told."""
    ok = next((r for r in (along, across) if r.status == "ok"), along)
    return replace(
        ok,
        parameters=(*along.parameters, *across.parameters),
        settings={**along.settings, **({"lateral": dict(across.settings)} if across.settings else {})},
        statistical={**along.statistical, **across.statistical},
        quasi_steady=along.quasi_steady,
    )


def _fitted(records: Sequence[Record], settings: dict[str, Any], aircraft: Aircraft, lines: Array) -> MethodResult:
    own = _open(aircraft)
    problem = Problem([manoeuvre(r, own) for r in records], own)
    six = [i for i, f in enumerate(problem.frees) if f.name in DERIVATIVES]
    e = with_model_error(problem, problem.freed(without_effects(problem), six, ()))
    values, covariance = _told(problem, e, lines)
    statistical = np.sqrt(np.diag(covariance))
    shares = relative_errors(aircraft, DERIVATIVES)[int(all(r.mass is not None for r in records))]
    errors = np.hypot(statistical, np.tile(shares, 2) * values)
    found, quasi_steady = (
        tuple(_judged(aircraft, n, x, sd) for n, x, sd in zip(DERIVATIVES, values[k], errors[k], strict=True))
        for k in (slice(0, len(DERIVATIVES)), slice(len(DERIVATIVES), None))
    )
    noise = dict(zip(DERIVATIVES, statistical.tolist(), strict=False))
    made = MethodResult("ok", "", found, settings=settings, statistical=noise, quasi_steady=quasi_steady)
    return made if _any(found) else replace(not_applicable(found[0].why, ()), parameters=found, settings=settings)


def _fitted_across(records: Sequence[Record], settings: dict[str, Any], flown: FlightRecord) -> MethodResult:
    own = _open(flown.aircraft, LATERAL)
    problem = Problem([manoeuvre(r, own, ACROSS) for r in records], own)
    free = [i for i, f in enumerate(problem.frees) if f.name in LATERAL]
    e = with_model_error(problem, problem.freed(without_effects(problem), free, ()))
    values, covariance = _moved(problem, e, lambda aircraft: np.array([aircraft.value(n) for n in LATERAL]))
    still = {
        f"{c}_{d}": f"no {s} input" for d, s in OF_SURFACE.items() if not excited(flown, (s,)) for c in LATERAL_FORCES
    }
    found = tuple(
        ParamEstimate(n, math.nan, math.nan, Status.UNESTIMATED, still[n])
        if n in still
        else _judged(flown.aircraft, n, x, math.sqrt(variance))
        for n, x, variance in zip(LATERAL, values.tolist(), np.diag(covariance).tolist(), strict=True)
    )
    made = with_airframe_errors(MethodResult("ok", "", found, settings=settings), flown)
    return made if _any(made.parameters) else replace(made, status="not_applicable", why=made.parameters[0].why)


def _any(found: Sequence[ParamEstimate]) -> bool:
    return any(p.status is Status.ESTIMATED for p in found)


def _open(aircraft: Aircraft, of: Sequence[str] = DERIVATIVES) -> Aircraft:
    """With all derivatives of one axis, each free; without the uncertainty that is told apart."""
    stated = {n: aircraft.derivatives.get(n) or Derivative(value=0.0) for n in of}
    free = {n: Derivative(value=d.value or _USUAL[n], sd=_sd(n, d)) for n, d in stated.items()}
    known = aircraft.uncertainty.model_copy(update=_SURE if of is DERIVATIVES else {**_SURE, "surface_scale": 0.0})
    return aircraft.model_copy(update={"derivatives": {**aircraft.derivatives, **free}, "uncertainty": known})


def _sd(name: str, stated: Derivative) -> float | None:
    """Of the prior that a fit begins with; None: as wide as profiles are wrong."""
    usual = name in LATERAL and not stated.value
    return stated.sd or (abs(_USUAL[name]) or _UNUSUAL if usual else None)


def _judged(aircraft: Aircraft, name: str, value: float, sd: float) -> ParamEstimate:
    return ParamEstimate(name, float(value), float(sd), *worded(of_estimate(value, sd, abs(aircraft.value(name)), 0.0)))


def _told(problem: Problem, e: Estimate, lines: Array) -> tuple[Array, Array]:
    """The aircraft's own derivatives, then the quasi-steady ones, (12,), and their covariance (12, 12)."""
    flown = problem.manoeuvres
    speed = float(np.mean([m.record.signals["airspeed"].mean() for m in flown]))
    density = float(np.mean([m.record.density for m in flown]))
    energy = np.zeros(len(lines))
    for m in flown:
        x = m.record.signals["elevator"]
        phases = np.exp(-2j * math.pi * m.record.dt * np.outer(lines, np.arange(len(x))))
        energy += np.abs(phases @ (x - x.mean())) ** 2

    def of(made: Aircraft) -> Array:
        aircraft = flown[0].loaded(made)
        own = np.array([aircraft.value(n) for n in DERIVATIVES])
        if physical_constants.why_not(aircraft):  # no lift is late
            return np.tile(own, 2)
        con = physical_constants.constants(aircraft)
        return np.concatenate([own, of_elevator(con, own, lines, speed, density, energy)])

    return _moved(problem, e, of)


def _moved(problem: Problem, e: Estimate, of: Callable[[Aircraft], Array]) -> tuple[Array, Array]:
    """What is made `of` the aircraft of an estimate, (n,), and its covariance (n, n)."""
    a, covariance = e.state.a, e.solved.covariance
    middle = of(problem.aircraft_at(e.state.values, a))
    slopes = np.zeros((len(middle), len(covariance)))
    for j in range(len(problem.frees)):
        there = a.copy()
        there[j] += _STEP
        slopes[:, j] = (of(problem.aircraft_at(e.state.values, there)) - middle) / _STEP
    return middle, np.asarray(slopes @ covariance @ slopes.T)
