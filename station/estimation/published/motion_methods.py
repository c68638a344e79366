"""Methods that integrate the equations of motion: oe, fe and VI, each from a FlightRecord to a MethodResult."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate

from station.conventions import LATERAL, to_si
from station.estimation.flight_record import FlightRecord
from station.estimation.published.filter_error import Longitudinal
from station.estimation.published.kalman import Tuning, extended_kalman
from station.estimation.published.lateral_motion import MEASURED as LATERAL_MEASURED
from station.estimation.published.lateral_motion import OUTPUTS as LATERAL_OUTPUTS
from station.estimation.published.lateral_motion import Found, lateral_filter_error, lateral_output_error
from station.estimation.published.longitudinal_motion import NX, NY, PARAMETERS, Body
from station.estimation.published.output_error import CONVERGED, Convergence, OutputFit
from station.estimation.published.short_period import ShortPeriod
from station.estimation.results import (
    DOF,
    Axes,
    EquationFit,
    MethodResult,
    equations,
    excited,
    inflation_of,
    judge,
    moves_laterally,
    names,
    not_applicable,
    regress,
    result_of,
    unknown,
)
from station.model.coefficients import force_coefficients, lift_and_drag
from station.numerics.differentiation import derivative, white_variance
from station.numerics.regression import NotIdentifiable, least_squares, smoothed_start
from station.numerics.turbulence import TURBULENCE_LENGTH, in_band
from station.rows import ParamEstimate, Status

Array = NDArray[np.float64]

MIN_LENGTH_S: Final = 2.0
"""Of a record that is integrated."""


def method_oe(record: FlightRecord, axes: Axes) -> MethodResult:
    """oe: output error; the short period, or with speed derivatives in the profile the longitudinal motion, and the
    lateral one where that is excited, each by itself."""
    _require_length(record)
    return _and_lateral(record, axes, lambda: _output_error(record, axes), lateral_output_error, LATERAL_MEASURED)


def _output_error(record: FlightRecord, axes: Axes) -> MethodResult:
    if _has_speed_terms(record):
        return _longitudinal(record, axes, "oe")
    if not record.has("theta"):
        raise NotIdentifiable("the record has no theta")
    _require_input(record)
    force = "CL" if axes == "wind" else "CZ"
    model = ShortPeriod.of(
        record.motion,
        record.alpha,
        record.coefficients,
        record.airframe,
        record.dt,
        wind_axes=axes == "wind",
    )
    start: dict[str, float] = {}
    for equation in equations(record, axes)[:2]:
        regression, _ = regress(record, equation)
        label = "force" if equation.name == force else "Cm"
        trim = smoothed_start(equation.regressors, 1.0, record.dt)
        # The regression counts q c/2V from its start; the model from zero.
        start[f"{label}_0"] = float(regression.estimate[3] - regression.estimate[1] * trim[1])
        start |= {f"{label}_{d}": float(regression.estimate[i]) for i, d in enumerate(DOF)}
    free = (
        *(f"force_{d}" for d in ("0", *DOF)),
        *(f"Cm_{d}" for d in ("0", *DOF)),
        "az_bias",
        "alpha_start",
        "q_start",
    )
    fit = model.estimate(start, free)
    wanted = {f"{force}_{d}": f"force_{d}" for d in DOF} | {f"Cm_{d}": f"Cm_{d}" for d in DOF}
    at = [free.index(n) for n in wanted.values()]
    inflation = np.tile(_inflation(record), 2)
    parameters = judge(record, list(wanted), fit.estimate[at], fit.se_coloured[at], inflation, *_verdict(fit))
    settings = {
        "model": "short period: alpha and q integrated, the rest as measured",
        "outputs": ["alpha", "q", "az"],
        "standard_errors": "coloured residuals",
        "iterations": fit.iterations,
    }
    return result_of(parameters, _output_fits(("alpha", "q", "az"), model.measured, fit), settings)


def method_fe(record: FlightRecord, axes: Axes) -> MethodResult:
    """fe: filter error of the longitudinal motion, and of the lateral one where that is excited, each by itself;
    process-noise amplitudes estimated."""
    _require_length(record)
    return _and_lateral(record, axes, lambda: _longitudinal(record, axes, "fe"), lateral_filter_error, LATERAL_OUTPUTS)


def _and_lateral(
    record: FlightRecord, axes: Axes, longitudinal: Callable[[], MethodResult],
    lateral: Callable[[FlightRecord], Found], outputs: Sequence[str],
) -> MethodResult:  # fmt: skip
    """A longitudinal method with its lateral counterpart, where the lateral motion is excited; either may fail."""
    if not moves_laterally(record):
        return longitudinal()
    try:
        made = longitudinal()
    except NotIdentifiable as why:
        made = not_applicable(str(why), names(axes))
    try:
        found, fit, more = lateral(record)
    except NotIdentifiable as why:
        return replace(made, parameters=(*made.parameters, *unknown(LATERAL, Status.INVALID, str(why))))
    fits = {**made.fit, **_output_fits(outputs, fit.model + fit.residual, fit)}
    return result_of((*made.parameters, *found), fits, {**made.settings, **more})


def _inflation(record: FlightRecord) -> Array:
    """Variance inflation of alpha, q c/2V and elevator (DOF). A model with process noise gives estimates even where an
    elevator proportional to q leaves them undetermined, and its sensitivities do not show it."""
    x = np.column_stack([record.alpha, record.coefficients.qhat, record.motion["elevator"]])
    return inflation_of(x[np.isfinite(x).all(axis=1)])


def _verdict(fit: OutputFit) -> tuple[Status, str]:
    if fit.converged:
        return Status.ESTIMATED, ""
    return Status.INVALID, f"not converged in {fit.iterations} iterations"


def _output_fits(outputs: Sequence[str], measured: Array, fit: OutputFit) -> dict[str, EquationFit]:
    found = {}
    for i, name in enumerate(outputs):
        e = fit.residual[:, i]
        good = np.isfinite(e)
        spread = float(np.var(measured[good, i]))
        rms = float(np.sqrt(np.mean(e[good] ** 2)))
        found[name] = EquationFit(1 - rms**2 / spread if spread > 0 else math.nan, rms)
    return found


def _require_input(record: FlightRecord) -> None:
    if not excited(record, ("elevator",)):
        raise NotIdentifiable("no elevator input")


def _require_length(record: FlightRecord) -> None:
    record.require_complete()
    if len(record.t_s) * record.dt < MIN_LENGTH_S:
        raise NotIdentifiable(f"{len(record.t_s) * record.dt:.2g} s of data: needs {MIN_LENGTH_S:g} s or more")


def _has_speed_terms(record: FlightRecord) -> bool:
    return any(n.endswith("_V") for n in record.aircraft.derivatives)


@dataclass(frozen=True, slots=True)
class _Setup:
    """The longitudinal motion of a record, ready for VI, oe and fe."""

    body: Body
    free: tuple[str, ...]
    initial: dict[str, float]
    inputs: Array
    measured: Array
    start: Array
    noise: Array


def _setup(record: FlightRecord) -> _Setup:
    """Raises NotIdentifiable for what the model needs and the record or the profile lacks."""
    if not record.has("theta"):
        raise NotIdentifiable("the record has no theta")
    _require_input(record)
    m, aircraft = record.motion, record.aircraft
    if "phi" in m and np.nanmax(np.abs(m["phi"])) > math.radians(20):
        raise NotIdentifiable("banked beyond 20 deg: the model flies wings level")
    speed = float(np.nanmean(m["airspeed"]))
    try:
        body = Body.of(aircraft, speed, float(np.nanmean(record.airframe.mass)))
    except ValueError as error:
        raise NotIdentifiable(str(error)) from error
    thrust = m["thrust"] if record.has("thrust") else np.zeros(len(record.t_s))
    density = 2 * m["dynamic_pressure"] / m["airspeed"] ** 2 if aircraft.air_density is None else aircraft.air_density
    inputs = np.column_stack([m["elevator"], thrust, density * np.ones(len(record.t_s))])
    qdot = m["qdot"] if record.has("qdot") else np.full(len(record.t_s), np.nan)
    measured = np.column_stack([m["airspeed"], record.alpha, m["theta"], m["q"], qdot, m["ax"], m["az"]])
    if record.has("qdot"):
        slope = qdot
    else:
        slope = derivative(m["q"], record.dt)
        measured[:, 4] = slope
    free, initial = _initial(record, body, inputs, slope)
    start = smoothed_start(measured[:, :NX], 2.0, record.dt)
    noise = np.array([white_variance(column, 2) for column in measured.T])
    floor = np.array([1e-3, 1e-5, 1e-5, 1e-5, 1e-4, 1e-3, 1e-3]) ** 2
    return _Setup(body, free, initial, inputs, measured, start, np.maximum(noise, floor))


def _initial(record: FlightRecord, body: Body, inputs: Array, qdot: Array) -> tuple[tuple[str, ...], dict[str, float]]:
    """The free parameters and values to start from: equation error on the model's own coefficients."""
    m = record.motion
    qbar = 0.5 * inputs[:, 2] * m["airspeed"] ** 2
    # Per unit of mass, as the model counts.
    thrust = inputs[:, 1] / body.mass, body.thrust_angle
    cx, cz = force_coefficients((m["ax"], m["az"]), thrust, body.area_by_mass * qbar)
    lift, drag = lift_and_drag(cx, cz, np.sin(record.alpha), np.cos(record.alpha))
    measured = {
        "CD": drag,
        "CL": lift,
        "Cm": (qdot - body.thrust_arm_by_inertia * inputs[:, 1]) / (body.area_chord_by_inertia * qbar),
    }
    rate_speed = body.reference_speed if body.fixed_rate_speed else m["airspeed"]
    known = record.aircraft.derivatives
    terms = {
        "0": np.ones(len(qbar)),
        "V": m["airspeed"] / body.reference_speed,
        "alpha": record.alpha,
        "q": m["q"] * body.rate_length / rate_speed,
        "de": m["elevator"],
    }
    initial: dict[str, float] = {}
    for coefficient, z in measured.items():
        always = ("0", "alpha") if coefficient == "CD" else ("0", "alpha", "q", "de")
        listed = tuple(t for t in terms if f"{coefficient}_{t}" in known)
        used = listed if _has_speed_terms(record) else always
        fit = least_squares(np.column_stack([terms[t] for t in used]), z)
        initial |= {f"{coefficient}_{t}": float(v) for t, v in zip(used, fit.estimate, strict=True)}
    free = tuple(n for n in PARAMETERS if n in initial)
    return free, initial


def _derivatives(
    record: FlightRecord,
    axes: Axes,
    free: Sequence[str],
    values: Array,
    errors: Array,
    status: Status = Status.ESTIMATED,
    why: str = "",
) -> tuple[ParamEstimate, ...]:
    """The model's parameters as the axes' derivatives. Body axes by CZ_a = -(CL_a + CD_0), CZ_q = -CL_q, CZ_de = -CL_de
    at small angles of attack, good to 1 %."""
    found = dict(zip(free, zip(values.tolist(), errors.tolist(), strict=True), strict=True))
    together = dict(zip(DOF, _inflation(record), strict=True))
    out = []
    for name in names(axes):
        source = name.replace("CZ_", "CL_")
        if source not in found:
            out.append(ParamEstimate(name, math.nan, math.nan, Status.INVALID, "not in this aircraft's model"))
            continue
        value, sd = found[source]
        if name.startswith("CZ_"):
            trim = found.get("CD_0", (0.0, 0.0))[0] if name == "CZ_alpha" else 0.0
            value = -(value + trim)
        inflation = np.array([together[name.split("_")[1]]])
        out += judge(record, [name], np.array([value]), np.array([sd]), inflation, status, why)
    return tuple(out)


def _longitudinal(record: FlightRecord, axes: Axes, kind: Literal["oe", "fe"]) -> MethodResult:
    setup = _setup(record)
    model = Longitudinal(setup.body, setup.start, {}, setup.free, setup.inputs, record.dt)
    initial = [setup.initial[n] for n in setup.free]
    if kind == "oe":
        fit = model.output_error(setup.measured, initial, CONVERGED)
    else:
        speed = setup.body.reference_speed
        level = max(record.turbulence()[1], 0.05) / in_band(speed) if record.dt < 1 / 15 else to_si(5, "ft/s")
        rate = math.sqrt(2 * speed / TURBULENCE_LENGTH)
        amplitudes = (level * rate, level / speed * rate, 0.1 * level / speed * rate, 0.1 * level / speed * rate)
        fit = model.filter_error(setup.measured, initial, amplitudes, SETTLED)
    m = len(setup.free)
    errors = np.maximum(fit.se_white, fit.se_coloured)[:m]
    parameters = _derivatives(record, axes, setup.free, fit.estimate[:m], errors, *_verdict(fit))
    settings: dict[str, Any] = {
        "model": "longitudinal: V, alpha, theta, q",
        "outputs": list(OUTPUT_NAMES),
        "iterations": fit.iterations,
        "all_parameters": _all_parameters(setup.free, fit.estimate, errors),
    }
    if kind == "fe":
        settings["process_noise"] = fit.estimate[m:].tolist()
    return result_of(parameters, _output_fits(OUTPUT_NAMES, setup.measured, fit), settings)


def _all_parameters(free: Sequence[str], values: Array, errors: Array) -> dict[str, list[float]]:
    return {n: [float(values[i]), float(errors[i])] for i, n in enumerate(free)}


SETTLED: Final = Convergence(step=0.01, noise=1e-3, searches=30)
"""For filter error, whose iterations take long."""
OUTPUT_NAMES: Final = ("airspeed", "alpha", "theta", "q", "qdot", "ax", "az")


def method_vi(record: FlightRecord, axes: Axes) -> MethodResult:
    """VI: extended Kalman filter, derivatives as states. Process noise of V and alpha from the turbulence level: first-
    order gusts of MIL-F-8785C's length; errors widened by the innovations' own correlation."""
    _require_length(record)
    setup = _setup(record)
    level = record.turbulence()[1]
    speed = setup.body.reference_speed
    sigma = max(level, 0.01) / in_band(speed) if math.isfinite(level) else to_si(5, "ft/s")
    share = min(2 * record.dt * speed / TURBULENCE_LENGTH, 1.0)
    m = len(setup.free)
    process = np.zeros(NX + m)
    process[0], process[1] = sigma**2 * share, (sigma / speed) ** 2 * share
    prior = np.array([max(abs(v), 0.1) for v in setup.initial.values()])
    initial = np.concatenate([10 * setup.noise[:NX], prior**2])
    noise = setup.noise
    for _ in range(2):
        tuning = Tuning(initial, process, noise)
        track = extended_kalman(
            setup.body, setup.start, setup.initial, setup.free, tuning, setup.inputs, setup.measured, record.dt
        )
        if not (np.isfinite(track.state).all() and np.isfinite(track.sd).all()):
            raise NotIdentifiable("the filter diverges")
        # The innovations of the first pass are the measurement noise of the second.
        noise = np.maximum(noise, np.var(track.innovation[len(track.innovation) // 4 :], axis=0))
    values, errors = track.parameters(10)
    errors = errors * math.sqrt(max(_correlation_time(track.innovation), 1.0))
    parameters = _derivatives(record, axes, setup.free, values, errors)
    fits = {}
    for i in range(NY):
        e = track.innovation[:, i]
        spread = float(np.var(setup.measured[:, i]))
        fits[OUTPUT_NAMES[i]] = EquationFit(1 - float(np.var(e)) / spread, float(np.sqrt(np.mean(e * e))))
    settings = {
        "model": "longitudinal: V, alpha, theta, q",
        "process_noise_variance_per_step": process[:NX].tolist(),
        "measurement_noise_variance": noise.tolist(),
        "all_parameters": _all_parameters(setup.free, values, errors),
    }
    return result_of(parameters, fits, settings)


def _correlation_time(innovation: Array) -> float:
    """1 + 2 sum of the autocorrelation up to its first zero: the largest of the outputs behind the derivatives."""
    worst = 1.0
    for e in innovation[:, (1, 3, 4, 6)].T:
        e = e - e.mean()
        r = correlate(e, e)[len(e) - 1 :] / float(e @ e)
        below = np.flatnonzero(r <= 0)
        worst = max(worst, 1 + 2 * float(r[1 : below[0] if len(below) else len(r)].sum()))
    return worst
