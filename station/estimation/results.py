"""What post-flight methods share: the equations of a record, and results with a status for every estimate.

Derivatives per rad, rates normalised with q c/2V, p b/2V, r b/2V. `estimated`, `unestimated` (not significant or not
excited) or `invalid` (the record or the model cannot give it).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from station.conventions import LONGITUDINAL, LONGITUDINAL_BODY
from station.estimation.acceptance import EXCITED, WIDE, is_wide, of_estimate, worded
from station.estimation.flight_record import FlightRecord
from station.model.airframe_error import relative_errors, roll_and_yaw_errors
from station.numerics.regression import Fit, NotIdentifiable, least_squares, smoothed_start
from station.profile import Aircraft
from station.rows import ParamEstimate, Status

Array = NDArray[np.float64]
Axes = Literal["wind", "body"]

SINGULAR: Final = 1e12
"""Condition number from which a matrix counts as singular."""
LEAST_SAMPLES: Final = 50
DOF: Final = ("alpha", "q", "de")
LATERAL_DOF: Final = ("beta", "p", "r", "da", "dr")
LATERAL_SURFACES: Final = ("aileron", "rudder")
LATERAL_FORCES: Final = ("CY", "Cl", "Cn")
STILL: Final = {"da": "aileron", "dr": "rudder"}
"""Derivatives that need a surface of their own to move."""


@dataclass(frozen=True, slots=True)
class EquationFit:
    """How well a method's model fits a measured quantity."""

    r2: float
    residual_rms: float


@dataclass(frozen=True, slots=True)
class MethodResult:
    """A method's estimates from a record: `ok`, or `not_applicable` and why."""

    status: Literal["ok", "not_applicable"]
    why: str = ""
    parameters: tuple[ParamEstimate, ...] = ()
    fit: Mapping[str, EquationFit] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    history: Mapping[str, Any] = field(default_factory=dict)
    statistical: Mapping[str, float] = field(default_factory=dict)
    """Standard errors from noise alone, without model error, where they differ from the reported ones."""

    quasi_steady: tuple[ParamEstimate, ...] = ()
    """Where `parameters` are the aircraft's own derivatives, those that equation error gives in calm air."""

    def parameter(self, name: str) -> ParamEstimate | None:
        return next((p for p in self.parameters if p.name == name), None)


def names(axes: Axes) -> tuple[str, ...]:
    """The six longitudinal derivatives in wind (CL) or body (CZ) axes."""
    return LONGITUDINAL if axes == "wind" else LONGITUDINAL_BODY


def not_applicable(why: str, parameters: Sequence[str]) -> MethodResult:
    """A refusal: every parameter invalid, and why."""
    return MethodResult("not_applicable", why, unknown(parameters, Status.INVALID, why))


def unknown(parameters: Sequence[str], status: Status, why: str) -> tuple[ParamEstimate, ...]:
    return tuple(ParamEstimate(n, math.nan, math.nan, status, why) for n in parameters)


def judge(
    record: FlightRecord,
    parameters: Sequence[str],
    values: Array,
    errors: Array,
    inflation: Array | None,
    status: Status = Status.ESTIMATED,
    why: str = "",
) -> tuple[ParamEstimate, ...]:
    found = []
    for i, name in enumerate(parameters):
        value, sd, this, reason = float(values[i]), float(errors[i]), status, why
        if status is Status.ESTIMATED:
            known = abs(record.aircraft.value(name.replace("CZ_", "CL_")))
            this, reason = worded(of_estimate(value, sd, known, inflation[i] if inflation is not None else 0.0))
        found.append(ParamEstimate(name, value, sd, this, reason))
    return tuple(found)


def inflation_of(x: Array) -> Array:
    """Variance inflation of each column by the others, constant removed."""
    centred = x - x.mean(axis=0)
    scale = np.sqrt((centred**2).sum(axis=0))
    if (scale == 0).any():
        return np.full(x.shape[1], np.inf)
    correlation = (centred / scale).T @ (centred / scale)
    if np.linalg.cond(correlation) > SINGULAR:
        return np.full(x.shape[1], np.inf)
    inflation: Array = np.diag(np.linalg.inv(correlation)).copy()
    return inflation


def excited(record: FlightRecord, surfaces: Sequence[str]) -> bool:
    """Whether any of the surfaces moves more than its noise."""
    for name in surfaces:
        if record.has(name):
            motion = record.motion[name]
            if np.nanvar(motion) > EXCITED * record.noise.get(name, 0.0) ** 2 + 1e-18:
                return True
    return False


@dataclass(frozen=True, slots=True)
class Equation:
    """One linear equation: a measured coefficient (n,), its regressors (n, m), its derivatives' names, and the surfaces
    of which one must move."""

    name: str
    parameters: tuple[str, ...]
    regressors: Array
    measured: Array
    surfaces: tuple[str, ...]


def moves_laterally(record: FlightRecord) -> bool:
    """Whether a record has the lateral signals, and aileron or rudder were moved."""
    return record.has("p", "r", "ay", "beta_vane", *LATERAL_SURFACES) and excited(record, LATERAL_SURFACES)


def equations(record: FlightRecord, axes: Axes, forces: Sequence[str] | None = None) -> list[Equation]:
    """The longitudinal equations, and the lateral ones where the record has their signals and inputs."""
    c, m = record.coefficients, record.motion
    x = np.column_stack([record.alpha, c.qhat, m["elevator"]])
    wanted = forces or (("CL", "Cm") if axes == "wind" else ("CZ", "Cm"))
    made = [Equation(n, tuple(f"{n}_{d}" for d in DOF), x, c.named(n), ("elevator",)) for n in wanted]
    if moves_laterally(record):
        columns = dict(zip(LATERAL_DOF, (record.beta, c.phat, c.rhat, m["aileron"], m["rudder"]), strict=True))
        # A surface that stands still would be a regressor of noise alone, collinear with all others.
        columns = {d: x for d, x in columns.items() if d not in STILL or excited(record, (STILL[d],))}
        x = np.column_stack(list(columns.values()))
        for name in LATERAL_FORCES:
            made.append(Equation(name, tuple(f"{name}_{d}" for d in columns), x, c.named(name), LATERAL_SURFACES))
    return made


def completed(parameters: Sequence[ParamEstimate], equation: Equation) -> tuple[ParamEstimate, ...]:
    """An equation's estimates with those of the surfaces that stood still."""
    if equation.name not in LATERAL_FORCES:
        return tuple(parameters)
    known = {p.name: p for p in parameters}
    every = {f"{equation.name}_{d}": STILL.get(d, "") for d in LATERAL_DOF}
    none = {n: ParamEstimate(n, math.nan, math.nan, Status.UNESTIMATED, f"no {s} input") for n, s in every.items()}
    return tuple(known.get(n, none[n]) for n in every)


def blocked(record: FlightRecord, equation: Equation) -> tuple[Status, str]:
    """Status and reason of an equation that cannot be fitted; ESTIMATED if it can."""
    if not np.isfinite(equation.measured[record.usable]).any():
        lacking = {"Cm": "iyy", "Cl": "ixx, iyy and izz", "Cn": "ixx, iyy and izz"}.get(equation.name)
        return Status.INVALID, f"the aircraft profile gives no {lacking}" if lacking else "no finite coefficient"
    if not excited(record, equation.surfaces):
        return Status.UNESTIMATED, f"no {' or '.join(equation.surfaces)} input"
    return Status.ESTIMATED, ""


def regress(record: FlightRecord, equation: Equation) -> tuple[Fit, Array]:
    x, z = equation.regressors, equation.measured
    good = record.usable & np.isfinite(x).all(axis=1) & np.isfinite(z)
    if good.sum() < LEAST_SAMPLES:
        raise NotIdentifiable(f"{int(good.sum())} usable samples: needs {LEAST_SAMPLES}")
    x, z = x[good], z[good]
    start = smoothed_start(x, 1.0, record.dt)
    return least_squares(np.column_stack([x - start, np.ones(len(x))]), z), inflation_of(x)


def airframe_errors(record: FlightRecord, parameters: Sequence[ParamEstimate]) -> list[float]:
    """What the uncertainty of mass and inertia does to each parameter, standard deviations."""
    names, at = [p.name for p in parameters], int("mass" in record.motion)
    values = np.array([p.value for p in parameters])
    found = np.abs(relative_errors(record.aircraft, names)[at] * values)
    for place, name in enumerate(names):
        rolling = f"Cl{name[2:]}"
        if name[:2] != "Cn" or rolling not in names:
            continue
        pair = [names.index(rolling), place]
        if np.isfinite(values[pair]).all():
            others = relative_errors(record.aircraft, [rolling, name], of_inertia=False)[at] * values[pair]
            found[pair] = np.hypot(others, np.ravel(roll_and_yaw_errors(record.aircraft, *values[pair, None])))
    return [float(x) for x in found]


def with_airframe_errors(result: MethodResult, record: FlightRecord) -> MethodResult:
    """Standard errors that include those of mass and inertia, which no residual shows."""
    made = []
    for p, share in zip(result.parameters, airframe_errors(record, result.parameters), strict=True):
        made.append(_with_error(p, math.hypot(p.sd, share), record.aircraft))
    own = {p.name: p.sd for p in result.parameters if math.isfinite(p.sd)}
    return replace(_or_why(result, made), parameters=tuple(made), statistical={**own, **result.statistical})


def with_more_error(result: MethodResult, more: Mapping[str, float], record: FlightRecord) -> MethodResult:
    """Standard errors that hold, in quadrature, what is known to be wrong with the derivatives named."""
    return with_errors_of(result, more, record, math.hypot)


def with_errors_of(
    result: MethodResult, more: Mapping[str, float], record: FlightRecord, joined: Callable[[float, float], float]
) -> MethodResult:
    """Standard errors `joined` with others, of the derivatives named."""
    if not more:
        return result

    def wider(p: ParamEstimate) -> ParamEstimate:
        return _with_error(p, joined(p.sd, more[p.name]), record.aircraft) if p.name in more else p

    made = tuple(wider(p) for p in result.parameters)
    own = {p.name: p.sd for p in result.parameters if p.name in more and math.isfinite(p.sd)}
    return replace(
        _or_why(result, made),
        parameters=made,
        quasi_steady=tuple(wider(p) for p in result.quasi_steady),
        statistical={**own, **result.statistical},
    )


def without_airframe_errors(result: MethodResult, record: FlightRecord) -> MethodResult:
    """The contrary: to be compared with a result that is wrong by the same share."""
    shares = airframe_errors(record, result.parameters)
    pairs = zip(result.parameters, shares, strict=True)
    made = tuple(_with_error(p, math.sqrt(max(p.sd**2 - share**2, 0.0)), None) if share else p for p, share in pairs)
    return replace(result, parameters=made)


def _with_error(p: ParamEstimate, sd: float, aircraft: Aircraft | None) -> ParamEstimate:
    """A parameter with another standard error: not significant where two of them exceed its size by the result and by
    the profile."""
    status, why = p.status, p.why
    size = max(abs(p.value), abs(aircraft.value(p.name.replace("CZ_", "CL_"))) if aircraft else 0.0)
    if aircraft and status is Status.ESTIMATED and 2 * sd > size:
        status, why = worded(WIDE)
    return ParamEstimate(p.name, p.value, sd, status, why)


def _or_why(result: MethodResult, made: Sequence[ParamEstimate]) -> MethodResult:
    """Not applicable where no parameter is significant any more."""
    if result.status == "ok" and not any(p.status is Status.ESTIMATED for p in made):
        return replace(result, status="not_applicable", why=worded(WIDE)[1])
    return result


def widened(result: MethodResult, witness: MethodResult, called: str, aircraft: Aircraft | None = None) -> MethodResult:
    """Standard errors that include the bias by the angle of attack.

    A method that takes the vane's for the angle of attack at the CG is biased by gusts, and its residuals do not show
    by how much: the error includes the distance from `witness`, which corrects the gust's part, and the witness's own.
    Twice the error then covers the true value in 96 to 100 % of the flights (24 each of both Twin Otters, calm air to
    10 ft/s), without it in as little as 0 %. Parameters that the witness has no number for keep their errors. A
    parameter whose two standard errors then exceed its size, by the result or by the `aircraft`, is not significant and
    unestimated. `called`: the witness's name.
    """
    known = {
        p.name: p
        for p in witness.parameters
        if math.isfinite(p.sd) and (p.status is not Status.INVALID or is_wide(p.why))
    }

    def wider(p: ParamEstimate) -> ParamEstimate:
        by = known[p.name]
        return _with_error(p, math.hypot(p.sd, p.value - by.value, by.sd), aircraft)

    made = tuple(wider(p) if p.name in known else p for p in result.parameters)
    if made == result.parameters:
        return result
    errors = result.settings.get("standard_errors", "coloured residuals")
    settings = {**result.settings, "standard_errors": f"{errors}, and the distance from {called}"}
    own = {p.name: p.sd for p in result.parameters if p.name in known and math.isfinite(p.sd)}
    return replace(_or_why(result, made), parameters=made, settings=settings, statistical={**own, **result.statistical})


def result_of(
    parameters: Sequence[ParamEstimate],
    fits: Mapping[str, EquationFit],
    settings: Mapping[str, Any],
    history: Mapping[str, Any] | None = None,
) -> MethodResult:
    """`ok` if anything is estimated; else not applicable, for the first reason given."""
    if any(p.status is Status.ESTIMATED for p in parameters):
        return MethodResult("ok", "", tuple(parameters), fits, settings, history or {})
    why = next((p.why for p in parameters if p.why), "nothing could be estimated")
    return MethodResult("not_applicable", why, tuple(parameters), fits, settings, history or {})
