"""Methods that need the whole record: I and sidpac; and how any post-flight method of method_table is run."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np

from station.conventions import LATERAL
from station.estimation.acceptance import of_equation, worded
from station.estimation.flight_record import FlightRecord
from station.estimation.method_table import METHODS
from station.estimation.published import sidpac as published
from station.estimation.results import (
    Axes,
    Equation,
    EquationFit,
    MethodResult,
    blocked,
    completed,
    equations,
    inflation_of,
    judge,
    names,
    not_applicable,
    regress,
    result_of,
    unknown,
)
from station.numerics.regression import NotIdentifiable
from station.rows import ParamEstimate, Status

Runner = Callable[[FlightRecord, Axes], MethodResult]


def method_i(record: FlightRecord, axes: Axes) -> MethodResult:
    """I: time-domain equation error with a constant, errors corrected for coloured residuals."""
    parameters: list[ParamEstimate] = []
    fits: dict[str, EquationFit] = {}
    for equation in equations(record, axes):
        status, why = blocked(record, equation)
        try:
            if status is Status.INVALID:
                raise NotIdentifiable(why)
            fit, inflation = regress(record, equation)
        except NotIdentifiable as refusal:
            parameters += completed(_refused(equation, status, why, refusal), equation)
            continue
        m = len(equation.parameters)
        if status is Status.ESTIMATED:
            status, why = worded(of_equation(fit.r2))
        made = judge(record, equation.parameters, fit.estimate[:m], fit.se_coloured[:m], inflation, status, why)
        parameters += completed(made, equation)
        fits[equation.name] = EquationFit(fit.r2, fit.s)
    settings = {
        "regressors": ["alpha", "q c/2V", "elevator", "1"],
        "standard_errors": "coloured residuals",
        "samples": int(record.usable.sum()),
    }
    return result_of(parameters, fits, settings)


def method_sidpac(record: FlightRecord, axes: Axes) -> MethodResult:
    """sidpac: recursive Fourier equation error exactly as SIDPAC's rtpid, on both published grids.

    `parameters` are those of the 36-line grid; `history` holds every estimate of both, CZ beside CL, once a second.
    """
    asked = {e.name for e in equations(record, axes)}
    history: dict[str, Any] = {}
    parameters: list[ParamEstimate] = []
    fits: dict[str, EquationFit] = {}
    for label, lines in (("rtpid_36", published.GRID_36), ("rtpid_191", published.GRID_191)):
        history[label] = {}
        for equation in equations(record, axes, ("CZ", "CL", "Cm")):
            status, why = blocked(record, equation)
            mine = label == "rtpid_36" and equation.name in asked
            try:
                if status is Status.INVALID:
                    raise NotIdentifiable(why)
                record.require_complete()
                x, z = equation.regressors, equation.measured
                found = published.recursive_fourier(x, z, record.dt, published.grid(lines))
            except NotIdentifiable as refusal:
                if mine:
                    parameters += completed(_refused(equation, status, why, refusal), equation)
                continue
            history[label][equation.name] = {
                "parameters": list(equation.parameters),
                "t_s": found.t_s.tolist(),
                "estimate": found.estimate.tolist(),
                "std_error": found.se.tolist(),
            }
            if mine:
                last = found.estimate[-1]
                residual = z - x @ last
                fits[equation.name] = EquationFit(published.r_squared(x, z, last), float(np.std(residual)))
                inflation = inflation_of(x)
                made = judge(record, equation.parameters, last, found.se[-1], inflation, status, why)
                parameters += completed(made, equation)
    first, step, count = published.GRID_36
    settings = {
        "frequencies_hz": [first, step, first + step * (count - 1)],
        "standard_errors": "as published: not corrected for coloured residuals",
    }
    return result_of(parameters, fits, settings, history)


def _refused(equation: Equation, status: Status, why: str, refusal: NotIdentifiable) -> tuple[ParamEstimate, ...]:
    """Every parameter of an equation without a solution: for the reason known before, if any, else the refusal."""
    return unknown(equation.parameters, status if why else Status.INVALID, why or str(refusal))


def run(name: str, record: FlightRecord, axes: Axes) -> MethodResult:
    """A post-flight method's result, refusals included: never an exception for what a record lacks."""
    method = METHODS[name]
    module, _, function = method.runner.partition(":")
    runner: Runner = getattr(import_module(module), function)
    lateral = method.lateral and any(e.name == "CY" for e in equations(record, axes))
    wanted = (*names(axes), *(LATERAL if lateral else ()))
    try:
        return runner(record, axes)
    except NotIdentifiable as refusal:
        return not_applicable(str(refusal), wanted)
    except (np.linalg.LinAlgError, FloatingPointError, ZeroDivisionError) as failure:
        return not_applicable(f"numerical failure: {failure}", wanted)
