"""Post-flight identification: a recording's table -> the JSON that contract.md calls station.identify/1.

The live methods are run by the very estimator that flies; the others are in estimation.postflight. Pure: no file is
read or written here.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import LATERAL
from station.estimation.flight_record import FlightRecord
from station.estimation.instrument_errors import known
from station.estimation.method_table import LIVE, MEASURED, METHODS, recommended
from station.estimation.published import batch as postflight
from station.estimation.published import cross_spectra
from station.estimation.published.cross_spectra import VaneSpectra
from station.estimation.results import DOF, Axes, MethodResult, names, not_applicable
from station.identification.advice import SIFTED, next_input_json, sifted_json, sifted_results
from station.identification.flown import DEFAULT_CARD, MIN_LIVE_HZ, WITNESSES, corrected, fly
from station.identification.input_ranking import short_period
from station.identification.kinematic_results import instruments_json, structure_json
from station.identification.kinematics import kinematics
from station.identification.plausibility import hint
from station.identification.remarks import about_columns, cleaned
from station.identification.signs_and_units import mistakes
from station.log import Table
from station.numerics.regression import NotIdentifiable
from station.profile import Aircraft, Card
from station.rows import ParamEstimate, Status, UsageError

Array = NDArray[np.float64]

SCHEMA: Final = "station.identify/1"
FLOWN: Final = (*LIVE, MEASURED)
"""Run by the estimator that flies."""
PREFERRED: Final = ("split", "II", "I", "fe", "oe", "VI", "sidpac")
"""Where `methods.recommended` names none, the first of these that applies is recommended."""
REGRESSED: Final = ("split+gust", "split", "II", "I")
"""Whose residuals are those of the equations that errors are predicted with."""
PAST_THE_PEAK: Final = 1.3
"""How far beyond the short period the band should reach, for damping and stiffness to be told apart."""
BY_VANE: Final = ("I", "VI", "oe", "fe")
"""Methods whose angle of attack is the vane's, with its lead on gusts."""


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
    table, left_out = cleaned(table)
    table = corrected(table, aircraft, noise, imu_position)
    if not len(table.t_s):
        raise UsageError(f"{log or 'log'}: shorter than the delays of the profile's instruments")
    first, last = float(table.t_s[0]), float(table.t_s[-1])
    start, end = first if start_s is None else start_s, last if end_s is None else end_s
    cut = table.between(start, end)
    if not start < end or len(cut.t_s) < 2:
        raise UsageError(
            f"{log or 'log'}: no data from {start:g} to {end:g} s: the recording has {first:g} to {last:g} s"
        )
    mistaken = " or ".join(m.sentence for m in mistakes(cut.t_s, cut.columns, aircraft))
    try:
        record, refusal = flight_record(cut, aircraft, imu_position, noise)
    except NotIdentifiable as why:
        raise UsageError(f"{log or 'log'}: {why}" + (f"\n{mistaken}" if mistaken else "")) from why
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
            result = flown.result(name, record, axes)
            results[name] = _forced(name, result, level) if force else result
        else:
            results[name] = postflight.run(name, record, axes)
            if name in BY_VANE and flown is not None:
                results[name] = flown.widened(results[name], record, axes)
    if ("all" in methods or sift) and not refusal:
        angles: dict[str, Array | None] = {n: flown.alpha(n, record) for n in SIFTED if n in results} if flown else {}
        instruments["sifted"] = sifted_json(record, angles, card, axes)
        if sift:
            only = sifted_results(instruments["sifted"], record, axes)
            results |= {n: r for n, r in only.items() if n in results}
    if mistaken:
        results = {name: _invalid(result, mistaken) for name, result in results.items()}
    recommended = _recommended(results, level)
    if "all" in methods and not refusal:
        told = next((results[n].fit for n in REGRESSED if n in results and results[n].fit), None)
        instruments["next_input"] = next_input_json(record, results.get(recommended or "II"), told)
    return {
        "schema": SCHEMA,
        "log": log,
        "aircraft": aircraft.name,
        "interval_s": [float(cut.t_s[0]), float(cut.t_s[-1])],
        "axes": axes,
        "turbulence": {"level": level if level != "unknown" else None, "w_std_2_7hz_mps": _number(std)},
        "remarks": [
            *left_out,
            *about_columns(cut),
            *record.remarks,
            *([] if mistaken or refusal else _about_gusts(results, level)),
            *(flown.warnings() if flown else ()),
            *_about_instruments(aircraft),
            *_about_the_band(record, card),
        ],
        "hint": _hint(mistaken)
        or ("" if refusal else hint(aircraft, table.aircraft, record, results.get(recommended or ""))),
        "methods": {name: _as_json(r) for name, r in results.items()},
        "recommended": recommended,
        "consistency": _consistency(results, axes),
        **instruments,
    }


def _hint(mistaken: str) -> str:
    return f"{mistaken}: no estimate is valid; put it right where the record was made or imported" if mistaken else ""


def _invalid(result: MethodResult, why: str) -> MethodResult:
    """The numbers stay for comparison, but nobody is to take them for estimates."""
    parameters = tuple(ParamEstimate(p.name, p.value, p.sd, Status.INVALID, why) for p in result.parameters)
    return replace(result, status="not_applicable", why=why, parameters=parameters)


def _about_gusts(results: Mapping[str, MethodResult], level: str) -> list[str]:
    """Where nothing tells the gusts from the motion, nothing tells what they did to the estimates."""
    apart = [n for n in ("split", "split+gust") if n in results]
    if level in ("calm", "unknown") or not apart or any(results[n].status == "ok" for n in apart):
        return []
    return [f"{level} turbulence, and {results[apart[0]].why}: the errors do not hold what gusts do to the estimates"]


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


def _about_instruments(aircraft: Aircraft) -> list[str]:
    """What the profile knows its instruments to do wrong."""
    stated = known(aircraft)
    done = [f"the profile's instrument errors undone: {'; '.join(stated.words)}"] if stated.words else []
    if aircraft.boom is None and not aircraft.kinematics_only:
        done.append(
            "the profile has no boom: the vane is taken for the angle of attack at the CG, and no error holds it"
        )
    return done + [f"an instrument error is not undone: {words}" for words in stated.refused]


def _about_the_band(record: FlightRecord, card: Card | None) -> list[str]:
    """Where the card's band ends before the aircraft's short period does."""
    band = card if card is not None else DEFAULT_CARD
    speed = float(np.nanmean(record.motion["airspeed"]))
    density = float(np.nanmean(2 * record.motion["dynamic_pressure"] / record.motion["airspeed"] ** 2))
    try:
        hz = short_period(record.aircraft, speed, density)[0] / (2 * math.pi)
    except NotIdentifiable:
        return []
    if hz * PAST_THE_PEAK <= band.high:
        return []
    return [
        f"the profile's short period is at {hz:.2g} Hz, the band of the estimates ends at {band.high:g} Hz: "
        f'on the card, high = "{PAST_THE_PEAK * hz:.2g} Hz" or more, and inputs that reach there'
    ]


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


def _forced(name: str, result: MethodResult, level: str) -> MethodResult:
    """A method for turbulence that gives estimates without any was forced to: its result says what that means."""
    if result.status != "ok" or not METHODS[name].turbulence_only or level not in ("calm", "unknown"):
        return result
    air = "in calm air" if level == "calm" else "in air not known to be turbulent"
    why = "all of alpha is delayed as if it were gust"
    if name == MEASURED:
        why += ", by a delay and an upwash measured on the motion"
    return replace(result, why=f"forced {air}: {why}, which biases every derivative")


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
        if known and p.name in result.statistical:
            parameters[p.name]["std_error_statistical"] = _number(result.statistical[p.name])
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
    given = {
        name: sum(p.status is Status.ESTIMATED and p.name not in LATERAL for p in result.parameters)
        for name, result in ok.items()
    }
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
