"""Diagnosis without aerodynamics: what the instruments of a record say of each other, and what cannot be judged.

For aircraft that nobody has described, and records without an elevator. The vane's bias, scale and delay come from
vane_calibration, biases from the reconstruction of compatibility, lags where gusts hide the calibration, and of the
velocity, from the table of instruments; an effect is named where its estimate is ACCEPTED
standard deviations from its null. Where gusts hide the vane's errors it is not judged, and the result says so.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.checks import Checked, merged
from station.diagnosis.diagnosis_result import Effect, Gain, Verdict, by_reduction, verdict_of
from station.diagnosis.effects import BY_ID, extended
from station.diagnosis.measured_record import held_samples, why_not_flown
from station.estimation.flight_record import FlightRecord
from station.identification.instrument_table import InstrumentTable, instrument_table
from station.identification.kinematics import Kinematics, kinematics
from station.identification.preparation import corrected, flight_record
from station.model.compatibility import Compatibility
from station.model.vane_calibration import VaneCalibration
from station.numerics.regression import NotIdentifiable
from station.numerics.second_order import vane_lag
from station.profile import Aircraft
from station.rows import ParamEstimate, Status, UsageError

Array = NDArray[np.float64]

ACCEPTED: Final = 4.0
"""Standard deviations of an estimate from its null: the evidence that diagnosis asks of a first effect."""
BLOCK_S: Final = 5.0
RESAMPLES: Final = 400
NO_LAG: Final = "no lag against accelerations and attitude"
HELD: Final = ("alpha_vane", "theta", "v_down")
"""Signals that are asked whether they repeat their values."""
AERODYNAMIC: Final = "derivatives, mass, inertia, CG, elevator and the gust's way to wing and tail"


@dataclass(frozen=True, slots=True)
class Judged:
    """One record and its kinematics."""

    name: str
    record: FlightRecord
    made: Kinematics
    instruments: InstrumentTable | str
    seen: tuple[Effect, ...]
    remarks: tuple[str, ...]


def judge(name: str, flown: Checked, aircraft: Aircraft, span: tuple[float, float] = (-math.inf, math.inf)) -> Judged:
    """The kinematics of a span (s) of a recording. Raises UsageError where there is nothing to judge."""
    place, noise = flown.imu_position, flown.noise
    table = flown.table.between(*span)
    try:
        record, _ = flight_record(corrected(table, aircraft, noise, place), aircraft, place, noise)
    except NotIdentifiable as refusal:
        raise UsageError(f"{name}: cannot be diagnosed: {refusal}") from refusal
    made = kinematics(record)
    if isinstance(made.vane, str) and isinstance(made.compatibility, str):
        raise UsageError(f"{name}: nothing can be judged: {made.vane}; {made.compatibility}")
    return Judged(name, record, made, instrument_table(record), flown.seen, flown.remarks)


@dataclass(frozen=True, slots=True)
class KinematicDiagnosis:
    """What instruments say of each other, what was judged and what was not."""

    aircraft: Aircraft
    effects: tuple[Effect, ...]
    seen: tuple[Effect, ...]
    gain: Gain | None
    fitted: tuple[Judged, ...]
    held_out: tuple[Judged, ...]
    judged: tuple[str, ...]
    """Effects that could be judged, found or not."""
    not_judged: Mapping[str, str]
    """What could not be judged, and why."""
    extended: Aircraft

    @property
    def named(self) -> tuple[Effect, ...]:
        return (*self.seen, *self.effects)

    @property
    def verdict(self) -> Verdict:
        return verdict_of(self.named)

    @property
    def remarks(self) -> tuple[str, ...]:
        said = [f"kinematic part only: judged {', '.join(self.judged) or 'nothing'}"]
        said += [f"not judged: {what}: {why}" for what, why in self.not_judged.items()]
        return (*said, *dict.fromkeys(words for j in (*self.fitted, *self.held_out) for words in j.remarks))

    @property
    def missed(self) -> Mapping[str, float]:
        return {}

    @property
    def unexplained(self) -> None:
        return None

    @property
    def vane_rms(self) -> tuple[float, float]:
        """Of the vane against the motion in calm records, rad, before and after its calibration; NaN without any."""
        parts = [j.made.vane for j in self.fitted]
        calm = [v for v in parts if isinstance(v, VaneCalibration) and v.is_calm]
        if not calm:
            return math.nan, math.nan
        before, after = np.sqrt(np.mean([(v.rms_before**2, v.rms_after**2) for v in calm], axis=0))
        return float(before), float(after)


def diagnose_kinematics(fitted: Sequence[Judged], held_out: Sequence[Judged], aircraft: Aircraft) -> KinematicDiagnosis:
    """The kinematic part: an effect is named where its estimate is ACCEPTED standard deviations from its null."""
    estimates, reasons = _estimates(fitted, aircraft)
    pooled = {name: _pooled(found) for name, found in estimates.items()}
    if any(_is_beyond(name, *found) for name, found in pooled.items() if BY_ID[name].of_vane):
        # The reconstruction has no delay of the vane: its residual would be taken for airspeed.
        for name in [n for n in pooled if (k := BY_ID[n].kinematic) and k.sound_vane]:
            del pooled[name]
            reasons[name] = "the vane has an error: correct that first"
    effects = []
    for name, (value, sd) in pooled.items():
        term = BY_ID[name]
        if term.kinematic is not None and _is_beyond(name, value, sd):
            signature = f"{term.target} against the other instruments"
            effects.append(
                Effect(term, value, sd, (value / sd) ** 2, term.kinematic.confounded_with(aircraft), signature)
            )
    not_judged = {name: reason for name, reason in reasons.items() if name not in pooled}
    not_judged[AERODYNAMIC] = why_not_flown(aircraft) or "the record has no elevator"
    values = {e.term.id: e.value for e in effects}
    return KinematicDiagnosis(
        aircraft=aircraft,
        effects=tuple(sorted(effects, key=by_reduction)),
        seen=_seen(fitted),
        gain=_gain(values, held_out),
        fitted=tuple(fitted),
        held_out=tuple(held_out),
        judged=tuple(sorted(pooled)),
        not_judged=not_judged,
        extended=extended(aircraft, values),
    )


def _estimates(
    fitted: Sequence[Judged], aircraft: Aircraft
) -> tuple[dict[str, list[tuple[float, float]]], dict[str, str]]:
    """By effect, its value and standard deviation in each record that determines it; and why others do not."""
    estimates: dict[str, list[tuple[float, float]]] = {}
    reasons: dict[str, str] = {}
    for j in fitted:
        parameters = {p.name: p for p in _parameters(j, aircraft)}
        for term in BY_ID.values():
            p = parameters.get(term.kinematic.parameter) if term.kinematic is not None else None
            if p is not None and p.status is Status.ESTIMATED:
                estimates.setdefault(term.id, []).append((p.value, p.sd))
            elif p is not None:
                reasons.setdefault(term.id, p.why)
        for what, part in (("the vane's bias, scale and delay", j.made.vane), ("biases", j.made.compatibility)):
            if isinstance(part, str):
                reasons.setdefault(what, part)
    return estimates, reasons


def _parameters(j: Judged, aircraft: Aircraft) -> Iterator[ParamEstimate]:
    """What a record says of its instruments, as the difference from the profile; named as in effects.Kinematic."""
    vane, reconstruction = j.made.vane, j.made.compatibility
    if isinstance(vane, VaneCalibration):
        bias, scale, lag = _stated(aircraft)
        status = Status.ESTIMATED if vane.is_calm else Status.UNESTIMATED
        why = "" if vane.is_calm else f"gusts: the motion explains {max(vane.r2, 0.0):.0%} of the reading"
        yield ParamEstimate("vane bias", vane.bias.value - bias, vane.bias.sd, status, why)
        yield ParamEstimate("vane scale", vane.scale.value / scale - 1, vane.scale.sd / scale, status, why)
        delay = ParamEstimate("vane delay", vane.delay.value - lag, vane.delay.sd, status, why)
        found = _late(j.instruments, "alpha_vane", delay, lag)
        # Gusts leave much to the aircraft's answer to them: only a lag that is sure.
        yield found if not vane.is_calm and abs(found.value) >= ACCEPTED * found.sd else delay
    yield _late(j.instruments, "v_down", ParamEstimate("velocity delay", 0.0, math.inf, Status.UNESTIMATED, NO_LAG))
    if isinstance(reconstruction, Compatibility):
        for p in reconstruction.parameters:
            if p.name == "airspeed_scale":  # of the dynamic pressure, which goes with its square
                p = ParamEstimate(p.name, p.value**2 - 1, 2 * p.value * p.sd, p.status, p.why)
            yield p


def _late(table: InstrumentTable | str, signal: str, otherwise: ParamEstimate, stated: float = 0.0) -> ParamEstimate:
    """The lag of an instrument against the others beyond the `stated` one, where it is told; else `otherwise`."""
    for row in () if isinstance(table, str) else table.rows:
        if row.signal == signal and not row.lag.why:
            return ParamEstimate(otherwise.name, row.lag.value - stated, row.lag.sd, Status.ESTIMATED, "")
    return otherwise


def _stated(aircraft: Aircraft) -> tuple[float, float, float]:
    """Zero (rad), scale and delay (s) that the profile gives the vane: a second-order one follows slow motion late."""
    boom = aircraft.boom
    if boom is None:
        return 0.0, 1.0, 0.0
    return boom.zero, 1 / boom.steady_calibration, vane_lag(boom.vane_frequency, boom.vane_damping)


def _is_beyond(name: str, value: float, sd: float) -> bool:
    kinematic = BY_ID[name].kinematic
    return kinematic is not None and abs(value) >= max(ACCEPTED * sd, kinematic.least)


def _pooled(found: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Weighted mean; its sd is widened where the records disagree by more than theirs."""
    values, sds = np.array(found).T
    weight = 1 / sds**2
    mean = float((weight * values).sum() / weight.sum())
    spread = float((weight * (values - mean) ** 2).sum() / max(len(values) - 1, 1))
    return mean, math.sqrt(max(spread, 1.0) / float(weight.sum()))


def _seen(fitted: Sequence[Judged]) -> tuple[Effect, ...]:
    """Signs, units and repeated values."""
    held: dict[str, list[float]] = {}
    for j in fitted:
        for name in HELD:
            column = j.record.motion.get(name)
            fresh = held_samples(column[j.made.rows]) if column is not None else np.empty(0)
            if len(fresh):
                held.setdefault(name, []).append(float(np.median(np.diff(fresh))) * j.record.dt)
    return merged([s for j in fitted for s in j.seen], held, 0.0)


def _gain(values: Mapping[str, float], held_out: Sequence[Judged]) -> Gain | None:
    """Vane against the inertial flow angle in records not used, before and after its bias, scale and delay."""
    own = {k.parameter: v for n, v in values.items() if (k := BY_ID[n].kinematic) and BY_ID[n].of_vane}
    squares: list[tuple[float, float, float]] = []
    for j in held_out:
        part = j.made.vane
        if not own or not isinstance(part, VaneCalibration):
            continue
        bias, scale, lag = _stated(j.record.aircraft)
        reading = j.record.motion["alpha_vane"][j.made.rows]
        t = np.arange(len(reading)) * j.record.dt
        before = (np.interp(t + lag, t, reading) - bias) / scale - part.expected
        late = np.interp(t + lag + own.get("vane delay", 0.0), t, reading)
        found = (bias + own.get("vane bias", 0.0), scale * (1 + own.get("vane scale", 0.0)))
        after = (late - found[0]) / found[1] - part.expected
        width = round(BLOCK_S / j.record.dt)
        squares += [
            (float(before[a : a + width] @ before[a : a + width]), float(after[a : a + width] @ after[a : a + width]),
             float(width))
            for a in range(0, len(reading) - width + 1, width)
        ]  # fmt: skip
    if not squares:
        return None
    table = np.array(squares)

    def reduction(rows: Array) -> float:
        return 1 - math.sqrt(rows[:, 1].sum() / rows[:, 0].sum())

    rng = np.random.default_rng(2)
    draws = [reduction(table[rng.integers(0, len(table), len(table))]) for _ in range(RESAMPLES)]
    low, high = np.quantile(draws, [0.025, 0.975])
    total = table.sum(0)
    before, after = math.sqrt(total[0] / total[2]), math.sqrt(total[1] / total[2])
    metric = "held-out vane against inertial flow angle, rad rms"
    return Gain(before, after, reduction(table), float(low), float(high), metric=metric)


def series_in_time(fitted: Sequence[Judged]) -> dict[str, dict[str, tuple[Array, Array]]]:
    """Vane and motion of each record, deg over s, by plot and line."""
    plots: dict[str, dict[str, tuple[Array, Array]]] = {}
    for j in fitted:
        part = j.made.vane
        if isinstance(part, VaneCalibration):
            t = j.record.t_s[j.made.rows]
            reading = j.record.motion["alpha_vane"][j.made.rows]
            lines = {"vane": reading, "vane, calibrated": part.corrected, "motion": part.expected}
            plots[f"{j.name}: angle of attack, deg"] = {n: (t, np.degrees(y)) for n, y in lines.items()}
    return plots
