"""Post-flight identification: a recording's table -> the JSON that contract.md calls station.identify/1.

The live methods are run by the very estimator that flies; the others are in estimation.postflight. Pure: no file is
read or written here.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from station.advice import SIFTED, next_input_json, sifted_json, sifted_results
from station.conventions import SIGNALS, TICK_HZ, TICK_NS
from station.estimation import cross_spectra, postflight
from station.estimation.cross_spectra import VaneSpectra
from station.estimation.kinematics import kinematics
from station.estimation.methods import LIVE, MEASURED, METHODS, Estimator, recommended
from station.estimation.record import FlightRecord
from station.estimation.regression import NotIdentifiable
from station.estimation.results import DOF, Axes, EquationFit, MethodResult, names, not_applicable, widened
from station.instruments import instruments_json, structure_json
from station.log import Table
from station.profile import Aircraft, Card
from station.rows import AlphaEstimate, Frame, MethodEstimate, ParamEstimate, Quality, Status, UsageError

Array = NDArray[np.float64]

SCHEMA: Final = "station.identify/1"
FLOWN: Final = (*LIVE, MEASURED)
"""Run by the estimator that flies."""
PREFERRED: Final = ("split", "II", "I", "fe", "oe", "VI", "sidpac")
"""Where `methods.recommended` names none, the first of these that applies is recommended."""
BY_VANE: Final = ("I", "VI", "oe", "fe")
"""Methods whose angle of attack is the vane's, with its lead on gusts."""
WITNESSES: Final = ("split+gust", "split")
"""What tells how far that misleads them: the first of these that applies."""
LEAD_S: Final = 30.0
"""Flight before the interval that the filters run on."""
HOLD_S: Final = 3.0
"""Without such a flight, trim of this length is put before the record: filters and delay lines start settled."""
MIN_LIVE_HZ: Final = 25.0
DEFAULT_CARD: Final = Card(name="identify", aircraft="", rig="")


def identify(
    table: Table,
    aircraft: Aircraft,
    methods: Sequence[str] = ("all",),
    start_s: float | None = None,
    end_s: float | None = None,
    axes: Axes = "wind",
    *,
    log: str = "",
    card: Card | None = None,
    imu_position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    noise: Mapping[str, float] | None = None,
    force: bool = False,
    sift: bool = False,
) -> dict[str, Any]:
    """Every asked method's derivatives with errors and status, the turbulence, and which method to believe.

    `methods`: names of contract.md, or "all". `start_s`, `end_s` on the table's time axis. `imu_position` (m, body) and
    `noise` (SI) are the rig's, `card` gives the frequencies. `force` applies III, IV and V in calm air too.
    `sift`: II and split from the lines that the card's multisine excites, and from no others. Raises
    UsageError for an unknown method, an empty interval, or a record that no method can use.
    """
    wanted = _wanted(methods)
    first, last = float(table.t_s[0]), float(table.t_s[-1])
    start, end = first if start_s is None else start_s, last if end_s is None else end_s
    cut = table.between(start, end)
    if not start < end or len(cut.t_s) < 2:
        raise UsageError(
            f"{log or 'log'}: no data from {start:g} to {end:g} s: the recording has {first:g} to {last:g} s"
        )
    try:
        record, refusal = flight_record(cut, aircraft, imu_position, noise)
    except NotIdentifiable as why:
        raise UsageError(f"{log or 'log'}: {why}") from why
    # The whole flight's instruments are looked at where everything is asked for, or nothing else can be had.
    instruments = instruments_json(kinematics(record), record) if "all" in methods or refusal else {}
    if refusal and all(section["status"] != "ok" for section in instruments.values()):
        raise UsageError(f"{log or 'log'}: {refusal}")
    spectra, unmeasured = None, ""
    if MEASURED in wanted and not refusal:
        spectra, unmeasured = _measured(table, record, card, imu_position, noise)
    beside = WITNESSES if set(BY_VANE) & set(wanted) else ()
    live = tuple(n for n in LIVE if n in wanted or n in beside) if not refusal else ()
    live += (MEASURED,) if spectra else ()
    flown = fly(table, record, live, start, axes, card, imu_position, noise, force, spectra) if live else None
    gust = flown.gust_vertical(record) if flown else None
    if flown and "all" in methods:
        instruments["model_structure"] = structure_json(
            record, flown.t_s if flown.alphas else np.empty(0), flown.alphas
        )
    level, std = record.turbulence(gust)
    results: dict[str, MethodResult] = {}
    for name in wanted:
        if refusal:
            results[name] = not_applicable(refusal, names(axes))
        elif name == MEASURED and unmeasured:
            results[name] = not_applicable(unmeasured, names(axes))
        elif name in FLOWN and flown is not None:
            results[name] = flown.result(name, record, axes)
        else:
            results[name] = postflight.run(name, record, axes)
            # In calm air I keeps the errors that others publish for it.
            if name in BY_VANE and flown is not None and not (name == "I" and level == "calm"):
                results[name] = flown.widened(results[name], record, axes)
    if ("all" in methods or sift) and not refusal:
        angles: dict[str, Array | None] = {n: flown.alpha(n, record) for n in SIFTED if n in results} if flown else {}
        instruments["sifted"] = sifted_json(record, angles, card, axes)
        if sift:
            only = sifted_results(instruments["sifted"], record, axes)
            results |= {n: r for n, r in only.items() if n in results}
    recommended = _recommended(results, level)
    if "all" in methods and not refusal:
        instruments["next_input"] = next_input_json(record, results.get(recommended or "II"))
    return {
        "schema": SCHEMA,
        "log": log,
        "aircraft": aircraft.name,
        "interval_s": [float(cut.t_s[0]), float(cut.t_s[-1])],
        "axes": axes,
        "turbulence": {"level": level, "w_std_2_7hz_mps": _number(std)},
        "remarks": list(record.remarks),
        "methods": {name: _as_json(r) for name, r in results.items()},
        "recommended": recommended,
        "consistency": _consistency(results, axes),
        **instruments,
    }


def _measured(
    table: Table,
    record: FlightRecord,
    card: Card | None,
    imu_position: tuple[float, float, float],
    noise: Mapping[str, float] | None,
) -> tuple[VaneSpectra | None, str]:
    """The vane's spectra on all of the recording, of which `record` is a part, or why there are none."""
    band = (card.low, card.high) if card is not None else (DEFAULT_CARD.low, DEFAULT_CARD.high)
    try:
        if not record.dt <= 1 / MIN_LIVE_HZ:
            raise NotIdentifiable(f"recorded at {1 / record.dt:.3g} Hz: needs {MIN_LIVE_HZ:g} Hz or more")
        whole = record
        if len(table.t_s) > len(record.t_s):
            whole, _ = flight_record(table, record.aircraft, imu_position, noise)
        return cross_spectra.measure(whole, band), ""
    except NotIdentifiable as why:
        return None, str(why)


def flight_record(
    cut: Table,
    aircraft: Aircraft,
    imu_position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    noise: Mapping[str, float] | None = None,
) -> tuple[FlightRecord, str]:
    """The record of a table, and why no derivative can come of it ("" if one may): a record without elevator or an
    aircraft without aerodynamic data still has kinematics. Raises NotIdentifiable."""
    refusal = ""
    columns = cut.columns
    if aircraft.kinematics_only:
        refusal = f"the profile of {aircraft.name} has no aerodynamic data: no derivatives, kinematics only"
    if "elevator" not in columns or not np.isfinite(columns["elevator"]).any():
        refusal = refusal or "the record has no elevator"
        columns = {**columns, "elevator": np.zeros(len(cut.t_s))}
    record = FlightRecord.of(
        cut.t_s,
        columns,
        aircraft,
        quality={n: q for n, q in cut.quality.items() if n in cut.columns and (n != "elevator" or not refusal)},
        extra=cut.extra,
        imu_position=imu_position,
        noise=noise,
    )
    return record, refusal


def _wanted(methods: Sequence[str]) -> tuple[str, ...]:
    if "all" in methods:
        return tuple(METHODS)
    for name in methods:
        if name not in METHODS:
            near = difflib.get_close_matches(name, METHODS, n=1, cutoff=0.3)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise UsageError(f"no method named {name}{hint}\nknown: all, {', '.join(METHODS)}")
    return tuple(dict.fromkeys(methods))


@dataclass(frozen=True, slots=True)
class Flown:
    """What the live estimator made of the interval."""

    alphas: tuple[AlphaEstimate, ...]
    t_s: Array
    last: Mapping[str, MethodEstimate]
    settings: Mapping[str, Any]
    refusal: str = ""
    spectra: VaneSpectra | None = None

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
        return MethodResult(status, why, found, self._fit(estimate, record), settings)

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
            return {"delay_s": boom.vane_x / float(np.nanmean(record.motion["airspeed"]))}
        return {"delay_s": 0.0} if name == "II" else {}

    def widened(self, result: MethodResult, record: FlightRecord, axes: Axes) -> MethodResult:
        """A result that goes by the vane, its errors widened where the split shows it misled."""
        if not self.refusal:
            for name in WITNESSES:
                witness = self.result(name, record, axes)
                if witness.status == "ok":
                    return widened(result, witness, name)
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
        regressors = [alpha, record.coefficients.qhat, record.motion["elevator"]]
        found = {}
        for i in range(0, len(estimate.parameters), 3):
            of = estimate.parameters[i].name.split("_")[0]
            values = [p.value for p in estimate.parameters[i : i + 3]]
            residual = record.coefficients.named(of) - sum(v * x for v, x in zip(values, regressors, strict=True))
            good = np.isfinite(residual)
            if good.sum() > 10:
                rms = float(np.std(residual[good]))
                spread = float(np.std(record.coefficients.named(of)[good]))
                found[of] = EquationFit(1 - (rms / spread) ** 2 if spread > 0 else math.nan, rms)
        return found


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
    """Run the live estimator over the interval, its filters settled on the flight before or on a made-up trim."""
    if not record.dt <= 1 / MIN_LIVE_HZ:
        return Flown((), record.t_s, {}, {}, f"recorded at {1 / record.dt:.3g} Hz: needs {MIN_LIVE_HZ:g} Hz or more")
    used = card if card is not None else DEFAULT_CARD
    estimator = Estimator(
        record.aircraft,
        used.model_copy(update={"warm_up": 0.0}),
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
    lead = _frames(before) if led else _hold(inside)
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
        "filters_settled_on": f"{start - float(before.t_s[0]):.0f} s of flight" if led else "a held trim",
    }
    t_s = np.array([(f.t_ns - table.t0_ns) * 1e-9 for f in frames])
    return Flown(tuple(alphas), t_s, {e.method: e for e in last}, settings, spectra=spectra)


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
    ages = np.where(np.isnan(values), np.nan, np.where(marks == int(Quality.HELD), 0.1, 0.0))
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


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _as_json(result: MethodResult) -> dict[str, Any]:
    parameters = {}
    for p in result.parameters:
        value, sd = _number(p.value), _number(p.sd)
        known = value is not None and sd is not None
        parameters[p.name] = {
            "estimate": value,
            "std_error": sd,
            "ci95": [p.value - 1.96 * p.sd, p.value + 1.96 * p.sd] if known else None,
            "status": p.status.value,
            "why": p.why,
        }
    fit = {n: {"r2": _number(f.r2), "residual_rms": _number(f.residual_rms)} for n, f in result.fit.items()}
    made: dict[str, Any] = {
        "status": result.status,
        "why": result.why,
        "parameters": parameters,
        "fit": fit,
        "settings": dict(result.settings),
    }
    if result.history:
        made["history"] = dict(result.history)
    return made


def _recommended(results: Mapping[str, MethodResult], level: str) -> str | None:
    """As in flight; where that says nothing, the first of PREFERRED that applies."""
    ok = {name: result for name, result in results.items() if result.status == "ok"}
    given = {name: sum(p.status is Status.ESTIMATED for p in result.parameters) for name, result in ok.items()}
    return recommended(given, level) or next((name for name in PREFERRED if name in ok), None)


def _consistency(results: Mapping[str, MethodResult], axes: Axes) -> dict[str, Any]:
    """What each method makes of alpha against a base method: alpha_base = t_alpha alpha + t_q q c/2V + t_de de.

    Any error of the angle of attack changes lift and moment derivatives by the same three numbers (t_alpha, t_q, t_de):
    CLa' = t_alpha CLa, CLq' = CLq + t_q CLa, CLde' = CLde + t_de CLa. Where the two equations disagree by more than
    their errors, it is not the angle of attack.
    """
    ok = {n: r for n, r in results.items() if r.parameters and all(math.isfinite(p.value) for p in r.parameters[:6])}
    base = next((n for n in ("II", "I", "sidpac") if n in ok), None)
    if base is None or len(ok) < 2:
        return {}
    force = "CL" if axes == "wind" else "CZ"
    reference = {p.name: p for p in ok[base].parameters}
    pairs = []
    for name, result in ok.items():
        if name == base:
            continue
        here = {p.name: p for p in result.parameters}
        rows, errors = {}, {}
        for of in (force, "Cm"):
            slope = reference[f"{of}_alpha"].value
            if slope == 0:
                break
            old, new = [[p[f"{of}_{d}"] for d in DOF] for p in (reference, here)]
            change = [(n.value - o.value) / slope for n, o in zip(new, old, strict=True)]
            rows[of] = {"t_alpha": 1 + change[0], "t_q": change[1], "t_de": change[2]}
            # Both estimates come from one record: the smaller error is nearer to that of their difference.
            errors[of] = [min(n.sd, o.sd) / abs(slope) for n, o in zip(new, old, strict=True)]
        if len(rows) < 2:
            continue
        agree = True
        for t, one, other in zip(rows[force], errors[force], errors["Cm"], strict=True):
            a, b = rows[force][t], rows["Cm"][t]
            size = 0.5 if t == "t_alpha" else max(abs(a), abs(b))
            agree = agree and abs(a - b) <= max(0.1 * size, 2 * math.hypot(one, other))
        pairs.append({"from": base, "to": name, **rows, "agree": agree})
    return {"base": base, "pairs": pairs}
