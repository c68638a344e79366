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

from station.conventions import G0, LATERAL, SIGNALS, TICK_HZ, TICK_NS
from station.estimation.bending import Bending, bends
from station.estimation.flight_record import FlightRecord
from station.estimation.instrument_errors import Corrector, known
from station.estimation.method_table import MEASURED
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
)
from station.log import Table
from station.profile import Aircraft, Card
from station.rows import AlphaEstimate, Frame, MethodEstimate, ParamEstimate, Quality, Status

Array = NDArray[np.float64]

WITNESSES: Final = ("split+gust", "split")
"""What tells how far methods that go by the vane are misled: the first of these that applies."""
LEAD_S: Final = 30.0
"""Flight before the interval that the filters run on."""
HOLD_S: Final = 3.0
"""Without such a flight, trim of this length is put before what there is: filters and delay lines start settled."""
HELD_TRIM: Final = "a held trim"
IN_TRIM: Final = math.radians(1.0)
"""Pitch rate up to which a record may begin in trim."""
MIN_LIVE_HZ: Final = 25.0
SHORTEST_STEP_S: Final = 1e-4
HELD_AGE_S: Final = 0.1
"""Age of a held value, whose own is not in the table."""
DEFAULT_CARD: Final = Card(name="identify", aircraft="", rig="")


@dataclass(frozen=True, slots=True)
class Flown:
    """What the live estimator made of the interval."""

    alphas: tuple[AlphaEstimate, ...]
    t_s: Array
    last: Mapping[str, MethodEstimate]
    settings: Mapping[str, Any]
    refusal: str = ""
    spectra: VaneSpectra | None = None
    statistical: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Of each method, its derivatives' standard errors without what its model may leave out."""
    preference: float | None = None
    """Deviance by which the model of `physical` fits better than the quasi-steady one."""

    def warnings(self) -> list[str]:
        """What the filters' start does to the estimates."""
        settled = str(self.settings.get("filters_settled_on", ""))
        told = f"filters settled on {settled}: begin in trim, or leave flight before the interval in the recording"
        return [told] if "begins pitching" in settled else []

    def gust_vertical(self, record: FlightRecord) -> Array | None:
        """Vertical gust (n,) of the split, m/s, on the record's grid; None where attitude and velocity are lacking."""
        if not self.alphas:
            return None
        gust = np.array([a.gust_vertical for a in self.alphas])
        if np.isfinite(gust).mean() < 0.5:
            return None
        found: Array = np.interp(record.t_s, self.t_s, gust, np.nan, np.nan)
        return found

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
            # The numbers stay for comparison, but nobody is to take them for an estimate.
            found = tuple(ParamEstimate(p.name, p.value, p.sd, Status.INVALID, p.why or why) for p in found)
        settings = {**self.settings, **self._correction(name, record)}
        statistical = self.statistical.get(name, {})
        return MethodResult(status, why, found, self._fit(estimate, record), settings, statistical=statistical)

    def _correction(self, name: str, record: FlightRecord) -> dict[str, Any]:
        """What a method does to all of alpha: its delay, or delay and upwash by frequency."""
        boom = record.aircraft.boom
        if name == MEASURED and self.spectra is not None:
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
        if name in ("III", "V") and boom is not None:
            return {"delay_s": boom.gust_x / float(np.nanmean(record.motion["airspeed"]))}
        if name == "physical" and self.preference is not None:
            preferred = "physical" if self.preference > 0 else "quasi-steady"
            return {"model_preferred": preferred, "deviance_less_than_quasi_steady": self.preference}
        return {"delay_s": 0.0} if name == "II" else {}

    def widened(self, result: MethodResult, record: FlightRecord, axes: Axes) -> MethodResult:
        """A result that goes by the vane, its errors widened where the split shows it misled: each derivative by the
        first witness that has it."""
        if self.refusal:
            return result
        told: set[str] = set()
        for name in WITNESSES:
            witness = self.result(name, record, axes)
            if witness.status == "ok":
                more = tuple(p for p in witness.parameters if p.name not in told)
                told |= {p.name for p in more}
                result = widened(result, replace(witness, parameters=more), name, record.aircraft)
        return result

    def alpha(self, method: str, record: FlightRecord) -> Array | None:
        """The angle of attack (n,) that a method regresses on; None for III to V, whose delays are not rebuilt, and
        for physical, which has none."""
        if method in ("III", "IV", "V", "physical") or not self.alphas:
            return None
        if method == "II":
            angle = np.array([a.vane + a.zero + a.upwash + a.rate for a in self.alphas])
        else:
            angle = np.array([a.alpha for a in self.alphas])
        found: Array = np.interp(record.t_s, self.t_s, angle, np.nan, np.nan)
        return found

    def _fit(self, estimate: MethodEstimate, record: FlightRecord) -> dict[str, EquationFit]:
        """The model with a free constant against the measured coefficients, with the method's own angle of attack."""
        alpha = self.alpha(estimate.method, record)
        if alpha is None:
            return {}
        values = {p.name: p.value for p in estimate.parameters}
        found = {}
        for equation in equations(record, "body" if "CZ_alpha" in values else "wind"):
            if equation.parameters[0] in LATERAL and estimate.method != "II":
                continue  # the record has the vane's sideslip only
            theta = np.array([values.get(name, math.nan) for name in equation.parameters])
            residual = equation.measured - self._model(equation, alpha, theta)
            good = np.isfinite(residual)
            if good.sum() > 10:
                rms, spread = float(np.std(residual[good])), float(np.std(equation.measured[good]))
                found[equation.name] = EquationFit(1 - (rms / spread) ** 2 if spread > 0 else math.nan, rms)
        return found

    @staticmethod
    def _model(equation: Equation, alpha: Array, theta: Array) -> Array:
        """What an equation's regressors and parameters make (n,); a surface that did not move is left out."""
        x = equation.regressors.copy()
        if equation.parameters[0] in LATERAL:
            theta = np.where(np.isfinite(theta) | ~np.isfinite(theta[0]), theta, 0.0)
        else:
            x[:, 0] = alpha
        made: Array = x @ theta
        return made


def corrected(
    table: Table,
    aircraft: Aircraft,
    noise: Mapping[str, float] | None,
    imu_position: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Table:
    """The table with the instrument errors undone that the profile states, as in flight: without the end, for which
    late signals have not come, and the begin that early ones lack; and the boom straightened."""
    if len(table.t_s) < 2:
        return table
    dt = max(float(np.median(np.diff(table.t_s))), SHORTEST_STEP_S)
    made = _undone(table, aircraft, noise, dt) if known(aircraft).errors else table
    if not bends(aircraft) or "alpha_vane" not in made.columns or not len(made.t_s):
        return made
    vane = Bending(aircraft, imu_position, dt).sweep(made.columns)
    lost = np.isnan(vane)
    marks = made.quality.get("alpha_vane", np.zeros(len(vane), dtype=np.uint8))
    quality = {**made.quality, "alpha_vane": np.where(lost, np.uint8(Quality.MISSING), marks)}
    return replace(made, columns={**made.columns, "alpha_vane": vane}, quality=quality)


def _undone(table: Table, aircraft: Aircraft, noise: Mapping[str, float] | None, dt: float) -> Table:
    undoing = Corrector(aircraft, noise or {}, dt, len(table.t_s))
    nothing = np.full(len(table.t_s), np.nan)
    values, ages = [], []
    for name in undoing.names:
        x = table.columns.get(name, nothing)
        held = table.quality.get(name, np.zeros(len(x), dtype=np.uint8)) == Quality.HELD
        values.append(np.where(held & (x == np.concatenate(([np.nan], x[:-1]))), np.nan, x))
        ages.append(np.where(held, HELD_AGE_S, 0.0))
    found, marks = undoing.sweep(table.t_s, np.column_stack(values), np.column_stack(ages))
    columns, quality = dict(table.columns), dict(table.quality)
    for j, name in enumerate(undoing.names):
        if name in table.columns:
            # A table has no ages: what is held here through a gap would pass for newer than it is.
            lost = np.isnan(table.columns[name]) & (marks[:, j] != Quality.FRESH)
            columns[name] = np.where(lost, np.nan, found[:, j])
            quality[name] = np.where(lost, np.uint8(Quality.MISSING), marks[:, j])
    made = replace(table, columns=columns, quality=quality)
    last = max(len(table.t_s) - 1 - undoing.ahead, 0)
    return made.between(float(table.t_s[0]) + undoing.early_s, float(table.t_s[last]))


def fly(
    table: Table,
    record: FlightRecord,
    methods: tuple[str, ...],
    start: float,
    axes: Axes,
    card: Card | None,
    imu_position: tuple[float, float, float],
    noise: Mapping[str, float] | None,
    force: bool,
    spectra: VaneSpectra | None = None,
) -> Flown:
    """Run the live estimator over the interval of a `corrected` table, its filters settled on the flight before or on
    a made-up trim."""
    if not record.dt <= 1 / MIN_LIVE_HZ:
        return Flown((), record.t_s, {}, {}, f"recorded at {1 / record.dt:.3g} Hz: needs {MIN_LIVE_HZ:g} Hz or more")
    used = card if card is not None else DEFAULT_CARD
    estimator = Estimator(
        record.aircraft,
        used.model_copy(update={"warm_up": 0.0, "lateral": used.asks_lateral or moves_laterally(record)}),
        imu_position,
        noise,
        methods,
        axes=axes,
        force=force,
        spectra=spectra,
    )
    before = table.between(start - LEAD_S, start)
    before = before.between(float(before.t_s[0]), start - 1e-9) if len(before.t_s) else before
    led = len(before.t_s) > 1 and start - float(before.t_s[0]) >= used.warm_up
    inside = table.between(start, float(record.t_s[-1]) + 0.5 * record.dt)
    pitching = 0.0 if len(before.t_s) > 1 else _pitching(inside)
    if abs(pitching) > IN_TRIM and (record.t_s[-1] - start) * used.low < 1.0:
        why = f"begins pitching at {math.degrees(pitching):.1f} deg/s: a record shorter than one period of {used.low:g}"
        return Flown((), record.t_s, {}, {}, f"{why} Hz has to begin in trim")
    # What there is of the flight before tells more than a trim made up of an interval that may begin in motion.
    lead = _frames(before) if led else [*_hold(before if len(before.t_s) > 1 else inside), *_frames(before)]
    for frame in lead:
        estimator.step(frame)
    estimator.start_point()
    alphas: list[AlphaEstimate] = []
    last: tuple[MethodEstimate, ...] = ()
    frames = _frames(inside)
    for frame in frames:
        alpha, last = estimator.step(frame)
        alphas.append(alpha)
    settings = {
        "frequencies_hz": [used.low, used.step, used.high],
        "filters_settled_on": _settled_on(start - float(before.t_s[0]) if len(before.t_s) > 1 else 0.0, led, pitching),
    }
    t_s = np.array([(f.t_ns - table.t0_ns) * 1e-9 for f in frames])
    return Flown(
        tuple(alphas),
        t_s,
        {e.method: e for e in last},
        settings,
        spectra=spectra,
        statistical=estimator.statistical(),
        preference=estimator.preference(),
    )


def _settled_on(seconds: float, led: bool, pitching: float) -> str:
    if led:
        return f"{seconds:.0f} s of flight"
    if abs(pitching) > IN_TRIM:
        return f"{HELD_TRIM}, though the record begins pitching at {math.degrees(pitching):.1f} deg/s"
    return f"{HELD_TRIM} and {seconds:.0f} s of flight" if seconds else HELD_TRIM


def _pitching(inside: Table) -> float:
    """Pitch rate that a record begins with, rad/s, less that of a steady turn."""
    if len(inside.t_s) < 2 or not {"q", "airspeed"} <= set(inside.columns):
        return 0.0
    first = {n: float(np.nanmean(c[:5])) for n, c in inside.columns.items() if n in ("q", "airspeed", "phi")}
    phi = first.get("phi", 0.0)
    turn = G0 * math.tan(phi) * math.sin(phi) / max(first["airspeed"], 1.0) if abs(phi) < 1.3 else 0.0
    rate = first["q"] - turn
    return rate if math.isfinite(rate) else 0.0


def _frames(table: Table) -> list[Frame]:
    """The table's rows as frames on the 50 Hz grid; off-grid rows are interpolated, long gaps stay missing."""
    if len(table.t_s) < 2:
        return []
    t = table.t_s
    k = np.round(t * TICK_HZ).astype(np.int64)
    on_grid = bool(np.all(np.abs(t * TICK_HZ - k - (t[0] * TICK_HZ - k[0])) < 1e-3) and np.all(np.diff(k) > 0))
    if on_grid:
        grid, columns, quality = t, dict(table.columns), dict(table.quality)
        number = k
    else:
        number = np.arange(int(np.ceil(t[0] * TICK_HZ)), int(np.floor(t[-1] * TICK_HZ)) + 1)
        grid = number / TICK_HZ
        after = np.clip(np.searchsorted(t, grid, "left"), 1, len(t) - 1)
        far = t[after] - t[after - 1] > 0.1
        columns = {n: np.where(far, np.nan, np.interp(grid, t, c)) for n, c in table.columns.items()}
        quality = {}
    rows = len(grid)
    values = np.full((rows, len(SIGNALS)), np.nan)
    marks = np.full((rows, len(SIGNALS)), int(Quality.MISSING))
    for i, name in enumerate(SIGNALS):
        if name in columns:
            values[:, i] = columns[name]
            fresh = np.where(np.isnan(values[:, i]), int(Quality.MISSING), int(Quality.FRESH))
            marks[:, i] = quality.get(name, fresh)
    ages = np.where(np.isnan(values), np.nan, np.where(marks == int(Quality.HELD), HELD_AGE_S, 0.0))
    return [
        Frame(table.t0_ns + round(t_s * 1e9), n, v, a, m)
        for t_s, n, v, a, m in zip(
            grid.tolist(),
            number.tolist(),
            map(tuple, values.tolist()),
            map(tuple, ages.tolist()),
            map(tuple, marks.tolist()),
            strict=True,
        )
    ]


def _hold(inside: Table) -> list[Frame]:
    """Trim before the record: what its first 0.1 s shows on average, without rates."""
    frames = _frames(inside)
    if not frames:
        return []
    values = np.array([f.values for f in frames[:5]])
    with np.errstate(invalid="ignore"):
        count = np.isfinite(values).sum(axis=0)
        mean = np.where(count > 0, np.nansum(values, axis=0) / np.maximum(count, 1), np.nan)
    for i, name in enumerate(SIGNALS):
        if name in ("p", "q", "r", "pdot", "qdot", "rdot") and count[i]:
            mean[i] = 0.0
    ages = np.where(np.isnan(mean), np.nan, 0.0)
    marks = np.where(np.isnan(mean), int(Quality.MISSING), int(Quality.FRESH))
    row = tuple(mean.tolist()), tuple(ages.tolist()), tuple(marks.tolist())
    ticks = round(HOLD_S * TICK_HZ)
    first = frames[0]
    return [Frame(first.t_ns - n * TICK_NS, first.k - n, *row) for n in range(ticks, 0, -1)]
