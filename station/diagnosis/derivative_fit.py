"""Method `ml`: derivatives by the likelihood of diagnosis, with nothing hidden.

Every instrument is held against the others and against the aircraft at once, each with its noise, and all constants of
the profile are as uncertain as it says; of the six derivatives nothing is known before. Maximum likelihood with errors
in all variables, as station.diagnosis.likelihood has it. SI, radians, derivatives per radian.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import LONGITUDINAL
from station.diagnosis.candidate import Estimate
from station.diagnosis.checks import Checked
from station.diagnosis.free_parameters import DERIVATIVES
from station.diagnosis.likelihood import Problem
from station.diagnosis.manoeuvre import manoeuvre
from station.diagnosis.measured_record import Record, why_not_flown
from station.diagnosis.model_error import with_model_error
from station.diagnosis.null_fit import without_effects
from station.diagnosis.side_by_side import meanwhile
from station.estimation.acceptance import STILL, of_estimate, worded
from station.estimation.results import MethodResult, excited, names, not_applicable, unknown
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
_USUAL: Final = dict(zip(DERIVATIVES, (5.0, 8.0, 0.4, -1.0, -20.0, -1.5), strict=True))
"""Of light transports: where the fit begins, and no more, of derivatives that a profile does not give."""
_STEP: Final = 0.1
"""Of a prior's standard deviation, over which slopes are taken."""


def begun(ready: Prepared) -> Callable[[], MethodResult]:
    """The fit, made beside what else is done until it is asked for."""
    request, aircraft = ready.request, ready.record.aircraft
    why = why_not_flown(_open(aircraft))
    if request.axes == "body":
        why = "estimates wind-axes derivatives only"
    if not why and not excited(ready.record, ("elevator",)):
        status, words = worded(STILL)
        return lambda: MethodResult("not_applicable", words, unknown(LONGITUDINAL, status, words))
    found: list[Record] = []
    if not why:
        cut = ready.recorded.between(ready.start_s, float(ready.cut.t_s[-1]))
        own = Checked(request.subject, cut, (), (), request.noise, request.imu_position)
        try:
            found = own.records(aircraft)
        except UsageError as refusal:
            why = str(refusal).removeprefix(f"{request.subject}: ")
    if why:
        return lambda: not_applicable(why, names(request.axes))
    most = sorted(found, key=lambda r: -float(r.signals["elevator"].std()))[:MOST]
    card = request.card if request.card is not None else DEFAULT_CARD
    lines = grid(card.low, card.high, card.step)
    settings = {"manoeuvres": len(most), "of": len(found), "seconds": round(sum(r.seconds for r in most), 1)}
    made = meanwhile(_fitted, [(most, aircraft, lines, settings)])
    return lambda: made()[0]


def _fitted(records: Sequence[Record], aircraft: Aircraft, lines: Array, settings: dict[str, Any]) -> MethodResult:
    own = _open(aircraft)
    try:
        problem = Problem([manoeuvre(r, own) for r in records], own)
        six = [i for i, f in enumerate(problem.frees) if f.name in DERIVATIVES]
        e = with_model_error(problem, problem.freed(without_effects(problem), six, ()))
        values, covariance = _told(problem, e, lines)
    except (ArithmeticError, ValueError, UsageError) as failure:  # the other methods have theirs
        return not_applicable(f"numerical failure: {failure}", LONGITUDINAL)
    statistical = np.sqrt(np.diag(covariance))
    shares = relative_errors(aircraft, DERIVATIVES)[int(all(r.mass is not None for r in records))]
    errors = np.hypot(statistical, np.tile(shares, 2) * values)
    found, quasi_steady = (
        tuple(_judged(aircraft, n, x, sd) for n, x, sd in zip(DERIVATIVES, values[k], errors[k], strict=True))
        for k in (slice(0, len(DERIVATIVES)), slice(len(DERIVATIVES), None))
    )
    if not any(p.status is Status.ESTIMATED for p in found):
        return replace(not_applicable(found[0].why, LONGITUDINAL), parameters=found, settings=settings)
    noise = dict(zip(DERIVATIVES, statistical.tolist(), strict=False))
    return MethodResult("ok", "", found, settings=settings, statistical=noise, quasi_steady=quasi_steady)


def _open(aircraft: Aircraft) -> Aircraft:
    """With all six derivatives, each free; without the uncertainty that is told apart."""
    stated = {n: aircraft.derivatives.get(n) or Derivative(value=0.0) for n in DERIVATIVES}
    six = {n: Derivative(value=d.value or _USUAL[n], sd=d.sd or None) for n, d in stated.items()}
    known = aircraft.uncertainty.model_copy(update=_SURE)
    return aircraft.model_copy(update={"derivatives": {**aircraft.derivatives, **six}, "uncertainty": known})


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

    def at(a: Array) -> Array:
        aircraft = flown[0].loaded(problem.aircraft_at(e.state.values, a))
        own = np.array([aircraft.value(n) for n in DERIVATIVES])
        if physical_constants.why_not(aircraft):  # no lift is late
            return np.tile(own, 2)
        con = physical_constants.constants(aircraft)
        return np.concatenate([own, of_elevator(con, own, lines, speed, density, energy)])

    a, covariance = e.state.a, e.solved.covariance
    middle, slopes = at(a), np.zeros((2 * len(DERIVATIVES), len(covariance)))
    for j in range(len(problem.frees)):
        there = a.copy()
        there[j] += _STEP
        slopes[:, j] = (at(there) - middle) / _STEP
    return middle, np.asarray(slopes @ covariance @ slopes.T)
