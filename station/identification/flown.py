"""A recording flown again: the live estimator over an interval of a table, and its estimates as post-flight results.

Pure: no file is read or written here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from station.conventions import G0, LATERAL
from station.estimation.flight_record import FlightRecord
from station.estimation.method_table import METHODS
from station.estimation.methods import Estimator
from station.estimation.published.cross_spectra import VaneSpectra
from station.estimation.results import (
    Axes,
    Equation,
    EquationFit,
    MethodResult,
    equations,
    moves_laterally,
    names,
    not_applicable,
    widened,
    without_airframe_errors,
)
from station.identification.request import DEFAULT_CARD, Request
from station.identification.table_frames import frames, trim_before
from station.log import Table
from station.rows import AlphaEstimate, Frame, MethodEstimate, ParamEstimate, Status

Array = NDArray[np.float64]

WITNESSES: Final = ("split+gust", "split")
"""Show how far gusts mislead the methods that go by the vane: the first of these that applies."""
LEAD_S: Final = 30.0
"""Flight before the interval that the filters run on."""
CONSTRUCTED_TRIM: Final = "a held trim"
IN_TRIM: Final = math.radians(1.0)
"""Pitch rate up to which a record may begin in trim."""
PERIODS: Final = 1.0
"""Of the lowest frequency, that a record needs which begins pitching."""
MIN_LIVE_HZ: Final = 5.0
"""Below, not even the short period of a transport is in the band that the rate supports."""
LEAST_SHARE: Final = 0.5
"""Of the rows must have a gust, for the record to have one."""
LEAST_ROWS: Final = 10
TRIM_ROWS: Final = 5
ROUNDING_S: Final = 1e-6
"""By which times of nanoseconds and of seconds may differ."""
STEEPEST_BANK: Final = 1.3
"""rad; beyond it a steady turn's pitch rate is not computed."""


@dataclass(frozen=True, slots=True)
class Flown:
    """What the live estimator made of the interval: `alphas` at `t_s` (n,), and each method's `last` estimates."""

    alphas: tuple[AlphaEstimate, ...]
    t_s: Array
    last: Mapping[str, MethodEstimate]
    settings: Mapping[str, Any]
    refusal: str = ""
    spectra: VaneSpectra | None = None
    statistical: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Of each method, its derivatives' standard errors from noise alone, without model error."""
    preference: float | None = None
    """Deviance reduction of `physical` against the quasi-steady model."""
    quasi_steady: Mapping[str, tuple[ParamEstimate, ...]] = field(default_factory=dict)
    """Of methods whose parameters are no quasi-steady derivatives, these."""

    def warnings(self) -> list[str]:
        """On filters that started in motion."""
        settled = str(self.settings.get("filters_settled_on", ""))
        warning = f"filters settled on {settled}: begin in trim, or keep flight before the interval in the recording"
        return [warning] if "begins pitching" in settled else []

    def gust_vertical(self, record: FlightRecord) -> Array | None:
        """Vertical gust (n,) of the split, m/s, on the record's grid; None where attitude and velocity are lacking."""
        if not self.alphas:
            return None
        gust = np.array([a.gust_vertical for a in self.alphas])
        if np.isfinite(gust).mean() < LEAST_SHARE:
            return None
        return self._at(record, gust)

    def result(self, name: str, record: FlightRecord, axes: Axes) -> MethodResult:
        parameters = names(axes)
        if self.refusal:
            return not_applicable(self.refusal, parameters)
        estimate = self.last[name]
        estimated = any(p.status is Status.ESTIMATED for p in estimate.parameters)
        status: Literal["ok", "not_applicable"] = "ok" if estimate.applicable and estimated else "not_applicable"
        why = estimate.why or ("" if estimated else next((p.why for p in estimate.parameters if p.why), ""))
        found = estimate.parameters
        if not estimate.applicable:
            # The numbers are kept for comparison, but are no estimates.
            found = tuple(ParamEstimate(p.name, p.value, p.sd, Status.INVALID, p.why or why) for p in found)
        settings = {**self.settings, **self._correction(name, record)}
        statistical = self.statistical.get(name, {})
        return MethodResult(
            status,
            why,
            found,
            self._fit(estimate, record),
            settings,
            statistical=statistical,
            quasi_steady=self.quasi_steady.get(name, ()),
        )

    def _correction(self, name: str, record: FlightRecord) -> dict[str, Any]:
        """What a method does to all of alpha: its delay, or delay and upwash by frequency."""
        boom = record.aircraft.boom
        method = METHODS[name]
        if method.needs_spectra and self.spectra is not None:
            s = self.spectra
            good = s.believed
            columns = {
                "frequency_hz": s.frequencies_hz,
                "delay_s": s.delay_s,
                "delay_sd_s": s.delay_sd,
                "coherence": s.coherence,
                "sears": s.sears,
                "upwash": s.upwash,
            }
            return {"spectra": {n: c[good].tolist() for n, c in columns.items()}, "segments": s.segments}
        if method.angle == "delayed" and boom is not None:
            return {"delay_s": boom.gust_x / float(np.nanmean(record.motion["airspeed"]))}
        if name == "physical" and self.preference is not None:
            preferred = "physical" if self.preference > 0 else "quasi-steady"
            return {"model_preferred": preferred, "deviance_less_than_quasi_steady": self.preference}
        return {"delay_s": 0.0} if name == "II" else {}

    def widened(self, result: MethodResult, record: FlightRecord, axes: Axes) -> MethodResult:
        """A result of a method that goes by the vane, its errors widened by its distance from the split: each
        derivative by the first witness that has it."""
        if self.refusal:
            return result
        done: set[str] = set()
        for name in WITNESSES:
            witness = without_airframe_errors(self.result(name, record, axes), record)
            if witness.status == "ok":
                more = tuple(p for p in witness.parameters if p.name not in done)
                done |= {p.name for p in more}
                result = widened(result, replace(witness, parameters=more), name, record.aircraft)
        return result

    def alpha(self, method: str, record: FlightRecord) -> Array | None:
        """The angle of attack (n,) that a live method regresses on; None for those that delay all of it, which is not
        reconstructed here, and for those that regress on none."""
        kind = METHODS[method].angle
        if kind in ("delayed", "none") or not self.alphas:
            return None
        if kind == "steady":
            angle = np.array([a.vane + a.zero + a.upwash + a.rate for a in self.alphas])
        else:
            angle = np.array([a.alpha for a in self.alphas])
        return self._at(record, angle)

    def _at(self, record: FlightRecord, values: Array) -> Array:
        """Values (n,) at `t_s` on the record's grid, NaN beyond what was flown."""
        inside = np.clip(record.t_s, self.t_s[0], self.t_s[-1])
        return np.where(np.abs(inside - record.t_s) < ROUNDING_S, np.interp(inside, self.t_s, values), np.nan)

    def _fit(self, estimate: MethodEstimate, record: FlightRecord) -> dict[str, EquationFit]:
        """The model with a free constant against the measured coefficients, with the method's own angle of attack."""
        alpha = self.alpha(estimate.method, record)
        if alpha is None:
            return {}
        values = {p.name: p.value for p in estimate.parameters}
        found = {}
        for equation in equations(record, "body" if "CZ_alpha" in values else "wind"):
            if equation.parameters[0] in LATERAL and METHODS[estimate.method].angle != "steady":
                continue  # the record has the vane's sideslip only
            theta = np.array([values.get(name, math.nan) for name in equation.parameters])
            residual = equation.measured - self._model(equation, alpha, theta)
            good = np.isfinite(residual)
            if good.sum() > LEAST_ROWS:
                rms, spread = float(np.std(residual[good])), float(np.std(equation.measured[good]))
                found[equation.name] = EquationFit(1 - (rms / spread) ** 2 if spread > 0 else math.nan, rms)
        return found

    @staticmethod
    def _model(equation: Equation, alpha: Array, theta: Array) -> Array:
        """An equation's modelled coefficient (n,), without the terms of surfaces that did not move."""
        x = equation.regressors.copy()
        if equation.parameters[0] in LATERAL:
            theta = np.where(np.isfinite(theta) | ~np.isfinite(theta[0]), theta, 0.0)
        else:
            x[:, 0] = alpha
        made: Array = x @ theta
        return made


def fly(
    table: Table,
    record: FlightRecord,
    methods: tuple[str, ...],
    request: Request,
    spectra: VaneSpectra | None = None,
) -> Flown:
    """Run the live estimator over the interval of a corrected table of which `record` is made, its filters settled on
    the flight before or on a constructed trim."""
    if record.dt > 1.001 / MIN_LIVE_HZ:
        return Flown((), record.t_s, {}, {}, f"recorded at {1 / record.dt:.3g} Hz: needs {MIN_LIVE_HZ:g} Hz or more")
    start = float(record.t_s[0]) if request.start_s is None else request.start_s
    card = request.card if request.card is not None else DEFAULT_CARD
    before = table.between(start - LEAD_S, start)
    before = before.between(float(before.t_s[0]), start - 1e-9) if len(before.t_s) else before
    has_lead = len(before.t_s) > 1
    seconds = start - float(before.t_s[0]) if has_lead else 0.0
    led = has_lead and seconds >= card.warm_up
    end = float(record.t_s[-1]) + 0.5 * record.dt
    inside = table.between(start, end)
    pitching = 0.0 if has_lead else _pitching(inside)
    if abs(pitching) > IN_TRIM and (record.t_s[-1] - start) * card.low < PERIODS:
        why = f"begins pitching at {math.degrees(pitching):.1f} deg/s: a record shorter than one period of {card.low:g}"
        return Flown((), record.t_s, {}, {}, f"{why} Hz has to begin in trim")
    estimator = Estimator(
        record.aircraft,
        card.model_copy(update={"warm_up": 0.0, "lateral": card.asks_lateral or moves_laterally(record)}),
        request.imu_position,
        request.noise,
        methods,
        axes=request.axes,
        force=request.force,
        spectra=spectra,
        recorded_hz=1 / record.dt,
    )
    earlier, flown = _frames_about(start, table.between(start - LEAD_S if has_lead else start, end))
    # The flight before shows more than a trim constructed from an interval that may begin in motion.
    for frame in earlier if led else [*trim_before(before if has_lead else inside), *earlier]:
        estimator.step(frame)
    estimator.start_point()
    alphas: list[AlphaEstimate] = []
    last: tuple[MethodEstimate, ...] = ()
    for frame in flown:
        alpha, last = estimator.step(frame)
        alphas.append(alpha)
    return Flown(
        tuple(alphas),
        np.array([(f.t_ns - table.t0_ns) * 1e-9 for f in flown]),
        {e.method: e for e in last},
        {
            "frequencies_hz": [card.low, card.step, card.high],
            "filters_settled_on": _settled_on(seconds, led, pitching),
        },
        spectra=spectra,
        statistical=estimator.statistical(),
        preference=estimator.preference(),
        quasi_steady=estimator.quasi_steady(),
    )


def _frames_about(start: float, table: Table) -> tuple[list[Frame], list[Frame]]:
    """Frames before and from `start`, s of the table's time axis, on."""
    all_of_them = frames(table)
    number = sum(f.t_ns < table.t0_ns + round(start * 1e9) for f in all_of_them)
    return all_of_them[:number], all_of_them[number:]


def _settled_on(seconds: float, led: bool, pitching: float) -> str:
    if led:
        return f"{seconds:.0f} s of flight"
    if abs(pitching) > IN_TRIM:
        return f"{CONSTRUCTED_TRIM}, though the record begins pitching at {math.degrees(pitching):.1f} deg/s"
    return f"{CONSTRUCTED_TRIM} and {seconds:.0f} s of flight" if seconds else CONSTRUCTED_TRIM


def _pitching(inside: Table) -> float:
    """Pitch rate that a record begins with, rad/s, less that of a steady turn."""
    if len(inside.t_s) < TRIM_ROWS or not {"q", "airspeed"} <= set(inside.columns):
        return 0.0
    begun = {n: c[:TRIM_ROWS][np.isfinite(c[:TRIM_ROWS])] for n, c in inside.columns.items()}
    first = {n: float(begun[n].mean()) for n in ("q", "airspeed", "phi") if len(begun.get(n, ()))}
    if not {"q", "airspeed"} <= set(first):
        return 0.0
    phi = first.get("phi", 0.0)
    turn = G0 * math.tan(phi) * math.sin(phi) / max(first["airspeed"], 1.0) if abs(phi) < STEEPEST_BANK else 0.0
    rate = first["q"] - turn
    return rate if math.isfinite(rate) else 0.0
