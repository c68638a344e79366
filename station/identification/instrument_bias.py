"""What errors of the instruments, which the others contradict, do to derivatives.

A vane that is late by T reads alpha - T alphadot, and with the angle of attack go its derivatives: the rate derivative
takes up T 2V/c of the angle's. No residual shows it, but the instruments show it among themselves, before any
aerodynamics (instrument_table.py). A surface has no instrument to be held against but the moment that it makes: where
this follows the record later than a sample, what is recorded is the actuator's command, or badly in time. Least squares
on the record as it is, and with its signals as these lags and scales would have them, differ by what they do; the
standard errors of every method hold the difference.

Source: Klein and Morelli 2006, sections 9.4 (time skews), 10.2 (data compatibility).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from station.estimation.flight_record import FlightRecord, flow_angles
from station.estimation.results import LATERAL_SURFACES, Axes, Equation, MethodResult, equations, excited, regress
from station.identification import surface_scales
from station.identification.by_input import Shown, by_input, input_history, instrumented, is_flown
from station.identification.instrument_table import InstrumentTable
from station.model.coefficients import coefficients
from station.model.instrument_lags import FILTERS_S
from station.numerics.differentiation import derivative
from station.numerics.regression import NotIdentifiable
from station.rows import Status

Array = NDArray[np.float64]

SURE: Final = 3.0
"""Standard deviations of a lag or a scale beyond which instruments contradict each other."""
LATE_S: Final = 0.02
"""A lag that is no error of an instrument: unsteady upwash and the vane on its spring make it as late."""
REGRESSED: Final = ("alpha_vane", "q", "az", "ax", "airspeed", "beta_vane", "p", "r", "ay")
"""What the equations are made of; velocities over ground are not in them,"""
INTEGRATED: Final = ("phi", "psi")
"""nor attitude, which the inertial sideslip is made with."""
SURFACES: Final = {"Cm": ("elevator", "de"), "Cl": ("aileron", "da"), "Cn": ("rudder", "dr")}
"""The coefficient that shows a surface best, and its mark there."""
ANSWERS: Final = {"elevator": "q", "aileron": "p", "rudder": "r"}
INPUTS: Final = dict.fromkeys(LATERAL_SURFACES, LATERAL_SURFACES)
"""A surface that only answers the motion, by feedback, is late by as much as that."""
LONGEST_S: Final = 0.3
"""Of a surface's lag: slower actuators do not control an aircraft."""
LIFT: Final = ("CL", "CZ")
"""Coefficients that follow the angle of attack: a vane that shows it after them is late."""
LATEST_S: Final = 1.5
"""Of a vane's lag."""
VANE_S: Final = 0.1
"""A vane on its spring, in upwash that comes late, is as late as this. Lift itself is later than the angle."""
STEP_S: Final = 0.01


@dataclass(frozen=True, slots=True)
class Error:
    """Of a signal, beyond what the profile says: reported `late` (s, negative: early), or a surface that follows what
    is recorded with a time constant `follows` (s); times `scale`."""

    late: float = 0.0
    scale: float = 1.0
    follows: float = 0.0
    by_lift: bool = False
    """Lift came so long before: as late at least, for lift itself is later than the angle."""

    def undone(self, x: Array, t_s: Array) -> Array:
        """The signal `x` (n,) at `t_s` as it was."""
        good = np.isfinite(x)
        if self.late:
            moved = CubicSpline(t_s[good], x[good], extrapolate=False)(t_s + self.late)
            x = np.where(good, moved, np.nan)
        if self.follows:
            keep = np.exp(-(t_s[1] - t_s[0]) / self.follows)
            whole = np.interp(t_s, t_s[good], x[good])
            x = np.where(good, lfilter([1 - keep], [1, -keep], whole - whole[0]) + whole[0], np.nan)
        return np.asarray(x / self.scale)

    def worded(self, name: str) -> str:
        how = "later than its lift, or more" if self.by_lift else "late" if self.late > 0 else "early"
        parts = [f"{abs(1e3 * self.late):.0f} ms {how}"] if self.late else []
        parts += [f"scale {self.scale:.3g}"] if self.scale != 1.0 else []
        parts += [f"ahead of its moment by a lag of {1e3 * self.follows:.0f} ms"] if self.follows else []
        return f"{name} {' and '.join(parts)}"


@dataclass(frozen=True, slots=True)
class Doubts:
    """What contradicts the record, and by how much each derivative is wrong by it."""

    errors: Mapping[str, Error]
    by_instruments: Mapping[str, float]
    by_surfaces: Mapping[str, float]
    """By surfaces whose scale the profile contradicts."""
    words: str

    def wrong(self, instead: Mapping[str, float] | None = None) -> dict[str, float]:
        """Each derivative, by all of it; `instead`: what a method itself makes of the instruments' errors."""
        of = {**self.by_instruments, **(instead or {})}
        return {n: math.hypot(of.get(n, 0.0), self.by_surfaces.get(n, 0.0)) for n in {**of, **self.by_surfaces}}


def contradicted(record: FlightRecord, table: InstrumentTable) -> dict[str, Error]:
    """Each instrument that the others contradict."""
    scale_known = record.aircraft.uncertainty.vane_scale
    found = {}
    for row in table.rows:
        lag, scale = 0.0, 1.0
        if not row.lag.why:
            beyond = row.lag.value - row.stated.get("lag", 0.0)
            lag = beyond if abs(beyond) > max(SURE * row.lag.sd, LATE_S) else 0.0
        if not row.scale.why:
            share = row.scale.value / row.stated.get("scale", 1.0)
            # What is estimated is its logarithm: 3 sd of 15 % are 1.57, not 1.45, and 0.64.
            sure = max(SURE * row.scale.sd / row.scale.value, math.log1p(scale_known))
            scale = share if abs(math.log(share)) > sure else 1.0
        if row.signal in (*REGRESSED, *INTEGRATED) and (lag, scale) != (0.0, 1.0):
            found[row.signal] = Error(lag, scale)
    return found


def out_of_time(record: FlightRecord, axes: Axes) -> dict[str, Error]:
    """Each surface whose moment follows what is recorded late, or early, by more than a sample, and a vane whose angle
    lift has followed before it is shown."""
    found = {}
    for equation in equations(record, axes):
        if equation.name in LIFT:
            late = [Error(late=s, by_lift=True) for s in np.arange(0.0, LATEST_S + VANE_S / 2, VANE_S / 2)]
            error = _timed(record, equation, record.alpha, equation.parameters.index(f"{equation.name}_alpha"), late)
            if error is not None and error.late > VANE_S:
                found["alpha_vane"] = error
        surface, mark = SURFACES.get(equation.name, ("", ""))
        name = f"{equation.name}_{mark}"
        if name not in equation.parameters or not np.isfinite(equation.measured[record.usable]).any():
            continue
        if not excited(record, (surface,)) or not is_flown(record, INPUTS.get(surface, (surface,)), ANSWERS[surface]):
            continue
        steps = np.arange(STEP_S, LONGEST_S + STEP_S / 2, STEP_S)
        tried = [Error(), *(Error(late=s) for s in (*steps, *-steps)), *(Error(follows=s) for s in steps)]
        error = _timed(record, equation, record.motion[surface], equation.parameters.index(name), tried)
        if error is not None:
            found[surface] = error
    return found


def _timed(record: FlightRecord, equation: Equation, signal: Array, at: int, tried: Sequence[Error]) -> Error | None:
    """The error of those `tried`, from none to the largest, with which `signal` (n,), regressor `at`, explains the
    coefficient best; None where that is none, or the largest, or is not sure."""
    good = record.usable & np.isfinite(equation.regressors).all(axis=1) & np.isfinite(equation.measured)
    if good.sum() < len(equation.parameters) + 2:
        return None
    z = equation.measured[good] - equation.measured[good].mean()
    # Gusts move the regressors too, a moment's in its own time: what the surfaces' history explains of both sides is
    # free of that. Lift follows a gust as it follows the motion.
    basis = None if equation.name in LIFT else input_history(record, equation, good, LONGEST_S)
    if basis is None and equation.name not in LIFT:
        return None

    def moved(error: Error) -> Array:
        x = equation.regressors.copy()
        x[:, at] = error.undone(signal, record.t_s)
        return x

    def left(error: Error) -> float:
        x = moved(error)[good]
        if not np.isfinite(x).any(axis=0).all():
            return math.inf  # so far moved, nothing of the surface is left
        x = np.where(np.isfinite(x), x, np.nanmean(x, axis=0))
        x = x - x.mean(axis=0)
        shown = (x, z) if basis is None else (basis.T @ x, basis.T @ z)
        estimate = np.linalg.lstsq(*shown, rcond=None)[0]
        return float(np.mean((shown[1] - shown[0] @ estimate) ** 2))

    best = min(tried, key=left)
    size = abs(best.late) + best.follows
    if not max(LATE_S, record.dt) < size < max(abs(e.late) + e.follows for e in tried):
        return None  # in time, or no best one among those tried
    x = moved(best)
    x = np.column_stack([x, np.gradient(x[:, at], record.dt)])
    slope = len(equation.parameters)
    try:
        if basis is None:
            fit, _ = regress(record, replace(equation, regressors=x))
            value, error = fit.estimate, fit.se_coloured
        else:
            there = good & np.isfinite(x).all(axis=1)
            value, error = instrumented(x[there] - x[there].mean(axis=0), z[there[good]], basis[there[good]])
    except (NotIdentifiable, np.linalg.LinAlgError):
        return None
    return best if size > SURE * abs(error[slope] / value[at]) else None


def undone(record: FlightRecord, errors: Mapping[str, Error]) -> FlightRecord:
    """The record with its signals as they were."""
    return _of_motion(
        record, {**record.motion, **{n: e.undone(record.motion[n], record.t_s) for n, e in errors.items()}}
    )


def _of_motion(record: FlightRecord, motion: Mapping[str, Array]) -> FlightRecord:
    alpha, beta = flow_angles(motion, record.aircraft)
    made = coefficients(motion, record.airframe, alpha, record.dt)
    return replace(record, motion=motion, alpha=alpha, beta=beta, coefficients=made)


def filtered(record: FlightRecord, errors: Mapping[str, Error]) -> dict[str, float]:
    """Lags (s), stated or in `errors`, of signals that are so late that they may come through a filter instead."""
    late = {n: e.late for n, e in errors.items()}
    for name, instrument in record.aircraft.instruments.items():
        late[name] = late.get(name, 0.0) + instrument.latency
    return {n: x for n, x in late.items() if x > FILTERS_S and n in REGRESSED and n in record.motion}


def biases(record: FlightRecord, table: InstrumentTable | str | None, axes: Axes, shown: Mapping[str, Shown]) -> Doubts:
    """Signals that the others contradict and surfaces that the profile does. `shown`: derivatives by the input's
    history.

    A lag that was undone as a delay may be that of a filter: by how much derivatives differ is part of it.
    """
    errors = contradicted(record, table) if isinstance(table, InstrumentTable) else {}
    # Of the others, for a late gyro is an early surface.
    errors |= out_of_time(undone(record, errors) if errors else record, axes)
    late = filtered(record, errors)
    wrong: dict[str, float] = {}
    of_mended = shown
    if errors or late:
        mended = undone(record, errors)
        of_mended = by_input(mended, axes, longitudinal=False)
        before, after = _estimates(record, axes), _estimates(mended, axes)
        other = _estimates(through_filters(mended, late), axes) if late else after
        wrong = {
            n: math.hypot(after[n] - x, other.get(n, after[n]) - after[n]) for n, x in before.items() if n in after
        }
        # What least squares and the input's history make of the same error differs.
        by_history = {
            n: abs(of_mended[n].value - shown[n].value) for n in shown.keys() & of_mended.keys() & wrong.keys()
        }
        wrong |= {n: max(x, wrong[n]) for n, x in by_history.items()}
    scales = surface_scales.contradicted(record.aircraft, of_mended)
    by_surfaces = surface_scales.wrong_by(scales, {n: of.value for n, of in of_mended.items()})
    words = [error.worded(name) for name, error in errors.items()]
    words += [scale.worded(surface) for surface, scale in scales.items()]
    return Doubts(errors, wrong, by_surfaces, "; ".join(words))


def through_filters(record: FlightRecord, late: Mapping[str, float]) -> FlightRecord:
    """The record whose signals, late by `late` (s) and moved back by it, had come through first-order lags instead."""
    motion = dict(record.motion)
    for name, lag in late.items():
        seen = Error(late=-lag).undone(motion[name], record.t_s)
        motion[name] = seen + lag * derivative(seen, record.dt)
    return _of_motion(record, motion)


def matters(wrong: Mapping[str, float], results: Iterable[MethodResult]) -> bool:
    """Whether any estimate is wrong by more than half its standard error."""
    return any(
        abs(wrong.get(p.name, 0.0)) > 0.5 * p.sd
        for result in results
        for p in result.parameters
        if p.status is Status.ESTIMATED
    )


def _estimates(record: FlightRecord, axes: Axes) -> dict[str, float]:
    """Least squares' of every equation that has a solution."""
    found: dict[str, float] = {}
    for equation in equations(record, axes):
        try:
            fit, _ = regress(record, equation)
        except (NotIdentifiable, np.linalg.LinAlgError):
            continue
        found |= dict(zip(equation.parameters, fit.estimate.tolist(), strict=False))
    return found
