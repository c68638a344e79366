"""Post-flight identification: a recording's table in, every method's estimates and what they rest on out.

The live methods are run by the estimator that flies; the others are in estimation.published. Pure: no file is read or
written here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import import_module
from typing import Final

from station.conventions import LATERAL
from station.estimation.method_table import LIVE, METHODS, recommended
from station.estimation.published import batch, cross_spectra
from station.estimation.published.cross_spectra import VaneSpectra
from station.estimation.results import (
    MethodResult,
    moves_laterally,
    names,
    not_applicable,
    with_airframe_errors,
    with_more_error,
)
from station.identification.advice import SIFTED, NextInput, SiftedMethod, next_input, sifted, sifted_results
from station.identification.angle_consistency import consistency
from station.identification.boom_spectra import BoomSpectra, boom_spectra
from station.identification.by_input import by_input, misled
from station.identification.cross_axis import drowned, refused
from station.identification.flown import WITNESSES, Flown, fly
from station.identification.folding import Folded, about_folding, folded, wrong_by
from station.identification.identified import Identification
from station.identification.instrument_bias import INTEGRATED, Error, biases, matters, undone
from station.identification.instrument_table import InstrumentTable, instrument_table
from station.identification.kinematics import kinematics
from station.identification.left_out import knows_gusts, left_out, mostly_gusts
from station.identification.model_structure import Comparison, structures
from station.identification.pitch_by_rates import RECONSTRUCTED, with_pitch
from station.identification.plausibility import hint
from station.identification.preparation import Prepared, prepare
from station.identification.remarks import (
    about_columns,
    about_contradiction,
    about_disagreement,
    about_gusts,
    about_instruments,
    about_the_band,
)
from station.identification.request import Request
from station.log import Table
from station.numerics.regression import NotIdentifiable
from station.profile import Aircraft
from station.rows import ParamEstimate, Status, UsageError

PREFERRED: Final = ("split", "II", "I", "fe", "oe", "VI", "sidpac")
"""Where `recommended` names none, the first of these that applies is recommended, then any other post-flight method."""
SPECTRA_HZ: Final = 25.0
"""Rate of a record that shows the vane's spectra to the frequencies of the gusts."""
REGRESSED: Final = ("split+gust", "split", "II", "I")
"""Whose residuals are those of the equations that errors are predicted with."""


def identify(table: Table, aircraft: Aircraft, request: Request | None = None) -> Identification:
    """Every requested method's derivatives with errors and status, the turbulence, and which method is recommended.

    Raises UsageError for an unknown method, an empty interval, or a record that no method can use.
    """
    request = request or Request()
    wanted = request.names()
    ready = prepare(table, aircraft, request)
    later = {name: _begun(name, ready) for name in wanted if METHODS[name].begin}
    # The instruments are examined where everything is asked for, or nothing else can be had,
    examined = request.wants_all or bool(ready.refusal)
    made = kinematics(ready.record) if examined else None
    # and before any lateral derivative: their vane and gyros are less often calibrated.
    examined = examined or (not ready.refusal and moves_laterally(ready.record))
    if ready.refusal and (made is None or not made.any_found):
        raise UsageError(f"{request.subject}: {ready.refusal}")
    spectra = _spectra(wanted, ready)
    flown = _flown(wanted, ready, spectra)
    level, gust_sd = ready.record.turbulence(flown.gust_vertical(ready.record) if flown else None)
    results = {name: _result(name, ready, flown, spectra) for name in wanted if name not in later}
    results = {name: later[name]() if name in later else results[name] for name in wanted}
    if request.force:
        results = {name: _forced(name, result, level) for name, result in results.items()}
    lines = _sifted(results, ready, flown)
    if request.sift and lines is not None:
        only = sifted_results(lines, ready.record, request.axes)
        results |= {n: r for n, r in only.items() if n in results}
    instruments = (ready.mistaken or instrument_table(ready.record)) if examined else None
    contradiction = ""
    if not ready.refusal:
        results, contradiction = _with_doubts(results, ready, instruments, flown)
    if ready.mistaken:
        results = {name: _invalid(result, ready.mistaken) for name, result in results.items()}
    best = _recommended(results, level)
    return Identification(
        log=request.log,
        aircraft=aircraft,
        interval_s=(float(ready.cut.t_s[0]), float(ready.cut.t_s[-1])),
        axes=request.axes,
        turbulence=level,
        gust_sd=gust_sd,
        remarks=(*_remarks(ready, results, level, flown), *about_contradiction(contradiction)),
        hint=_hint(ready, table.aircraft, results.get(best or "")),
        methods=results,
        recommended=best,
        consistency=consistency(results, request.axes),
        instruments=instruments,
        kinematics=made,
        structures=_structures(ready, flown),
        sifted=lines,
        next_input=_next_input(ready, results, best),
        boom=_boom(ready),
        record=ready.record,
        flown=flown,
    )


def _boom(ready: Prepared) -> tuple[BoomSpectra, ...] | str:
    """Accelerometers on the boom against the CG's, or why not."""
    try:
        return boom_spectra(ready.record, ready.cut.t_s, ready.cut.columns, ready.request.on_boom)
    except NotIdentifiable as why:
        return str(why)


def _with_doubts(
    results: dict[str, MethodResult], ready: Prepared, instruments: InstrumentTable | str | None, flown: Flown | None
) -> tuple[dict[str, MethodResult], str]:
    """Errors that hold what no residual shows, refusals where nothing is left, and the signals that the others
    contradict, in words where that matters."""
    record, axes = ready.record, ready.request.axes
    as_they_are = [n for n, m in METHODS.items() if m.angle == "none" and not (m.live or m.begin)]
    shown = by_input(record, axes, longitudinal=not knows_gusts(record))
    doubts = biases(record, instruments, axes, shown)
    wrong, own = doubts.wrong(), _of_method(ready, flown, doubts.errors)
    harmed = matters(wrong, results.values()) or any(matters(own[n], [results[n]]) for n in own.keys() & results.keys())
    contradiction = doubts.words if harmed else ""
    whys = {**mostly_gusts(record, instruments), **drowned(record)}
    results = misled(results, shown, record, as_they_are)
    beside = left_out(record, axes)
    folds = _folded(ready)
    for n in results.keys() - set(as_they_are):
        # The likelihood leaves out the frequencies that others fold into (diagnosis.processing.OF_RATE).
        fold = {} if METHODS[n].begin else wrong_by(folds, results[n])
        for more in (doubts.wrong(own.get(n)), beside, fold):
            results[n] = with_more_error(results[n], more, record)
    return {n: refused(r, whys) for n, r in results.items()}, contradiction


def _folded(ready: Prepared) -> dict[str, Folded]:
    return folded(ready.record, ready.request.band_hz, ready.request.axes)


def _of_method(ready: Prepared, flown: Flown | None, errors: Mapping[str, Error]) -> dict[str, dict[str, float]]:
    """By method, by how much its lateral derivatives differ with the instruments' errors undone: of methods that go by
    the input, which an error misleads otherwise than it does least squares, and of those that go by the attitude."""
    by_attitude = bool(errors.keys() & set(INTEGRATED))
    if flown is None or not errors:
        return {}
    names = tuple(n for n in flown.last if METHODS[n].by_input or (by_attitude and METHODS[n].is_split))
    if not names:
        return {}
    whole, axes = with_pitch(ready.whole), ready.request.axes
    columns = {n: e.undone(whole.columns[n], whole.t_s) for n, e in errors.items() if n in whole.columns}
    record = undone(ready.record, errors)
    again = fly(replace(whole, columns={**whole.columns, **columns}), record, names, ready.request)
    found: dict[str, dict[str, float]] = {}
    for n in names:
        values = {p.name: p.value for p in again.result(n, record, axes).parameters}
        before = flown.result(n, ready.record, axes).parameters
        apart = {p.name: abs(values.get(p.name, math.nan) - p.value) for p in before if p.name in LATERAL}
        found[n] = {name: x for name, x in apart.items() if math.isfinite(x)}
    return found


def _spectra(wanted: tuple[str, ...], ready: Prepared) -> VaneSpectra | str | None:
    """The vane's spectra over all of the recording, or why there are none; None where no method needs them."""
    if ready.refusal or not any(METHODS[name].needs_spectra for name in wanted):
        return None
    try:
        if not ready.record.dt <= 1 / SPECTRA_HZ:
            raise NotIdentifiable(f"recorded at {1 / ready.record.dt:.3g} Hz: needs {SPECTRA_HZ:g} Hz or more")
        return cross_spectra.measure(ready.record_of_whole(), ready.request.band_hz)
    except NotIdentifiable as why:
        return str(why)


def _flown(wanted: tuple[str, ...], ready: Prepared, spectra: VaneSpectra | str | None) -> Flown | None:
    """The live methods asked for, and the witnesses of those that go by the vane; None where there are none."""
    if ready.refusal:
        return None
    witnesses = WITNESSES if any(METHODS[name].errors_widened for name in wanted) else ()
    measured = spectra if isinstance(spectra, VaneSpectra) else None
    live = tuple(n for n in LIVE if n in wanted or n in witnesses)
    live += tuple(n for n in wanted if METHODS[n].needs_spectra) if measured else ()
    return fly(with_pitch(ready.whole), ready.record, live, ready.request, measured) if live else None


def _begun(name: str, ready: Prepared) -> Callable[[], MethodResult]:
    if why := ready.refusal or ready.mistaken:
        return lambda: not_applicable(why, names(ready.request.axes))
    module, _, function = METHODS[name].begin.partition(":")
    made: Callable[[], MethodResult] = getattr(import_module(module), function)(ready)
    return made


def _result(name: str, ready: Prepared, flown: Flown | None, spectra: VaneSpectra | str | None) -> MethodResult:
    method, axes = METHODS[name], ready.request.axes
    if ready.refusal:
        return not_applicable(ready.refusal, names(axes))
    if method.needs_spectra and isinstance(spectra, str):
        return not_applicable(spectra, names(axes))
    if flown is not None and not method.runner:
        return flown.result(name, ready.record, axes)
    result = batch.run(name, ready.record, axes)
    if method.errors_widened and flown:
        result = flown.widened(result, ready.record, axes)
    return with_airframe_errors(result, ready.record)


def _forced(name: str, result: MethodResult, level: str) -> MethodResult:
    """A method for turbulence that was applied without any: its result says what that means."""
    if result.status != "ok" or not METHODS[name].turbulence_only or level not in ("calm", "unknown"):
        return result
    air = "in calm air" if level == "calm" else "in air not known to be turbulent"
    why = "all of alpha is delayed as if it were gust"
    if METHODS[name].needs_spectra:
        why += ", by a delay and an upwash measured on the motion"
    return replace(result, why=f"forced {air}: {why}, which biases every derivative")


def _invalid(result: MethodResult, why: str) -> MethodResult:
    """The numbers are kept for comparison, but are no estimates."""
    parameters = tuple(ParamEstimate(p.name, p.value, p.sd, Status.INVALID, why) for p in result.parameters)
    return replace(result, status="not_applicable", why=why, parameters=parameters)


def _recommended(results: Mapping[str, MethodResult], level: str) -> str | None:
    """What needs the whole recording (Method.begin), where it gives as many derivatives of both axes as split does.
    Else as in flight: by the longitudinal ones, or the lateral ones of a flight that shows no others. Else the first of
    PREFERRED that applies."""
    ok = {name: result for name, result in results.items() if result.status == "ok"}
    told = {name: [p.name in LATERAL for p in r.parameters if p.status is Status.ESTIMATED] for name, r in ok.items()}
    of_all = recommended({name: len(of) for name, of in told.items()}, level)
    if of_all and METHODS[of_all].begin:
        return of_all
    live = {name: of for name, of in told.items() if not METHODS[name].begin}
    given = {name: of.count(False) for name, of in live.items()}
    given = given if any(given.values()) else {name: of.count(True) for name, of in live.items()}
    others = (name for name in ok if METHODS[name].runner)
    return recommended(given, level) or next((name for name in (*PREFERRED, *others) if name in ok), None)


def _remarks(ready: Prepared, results: Mapping[str, MethodResult], level: str, flown: Flown | None) -> tuple[str, ...]:
    can_judge = not (ready.mistaken or ready.refusal)
    return (
        *ready.remarks,
        *about_columns(ready.cut),
        *ready.record.remarks,
        *(() if ready.record.has("theta") or flown is None else (RECONSTRUCTED,)),
        *(about_gusts(results, level) if can_judge else ()),
        *(about_disagreement(results) if can_judge else ()),
        *(flown.warnings() if flown else ()),
        *about_instruments(ready.record.aircraft),
        *about_the_band(ready.record, ready.request.band_hz),
        *(about_folding(_folded(ready), ready.record.dt) if can_judge else ()),
    )


def _hint(ready: Prepared, recorded: Aircraft, best: MethodResult | None) -> str:
    """What contradicts the signs and units, or the profile."""
    if ready.mistaken:
        return f"{ready.mistaken}: no estimate is valid; correct it where the record was made or imported"
    return "" if ready.refusal else hint(ready.record.aircraft, recorded, ready.record, best)


def _structures(ready: Prepared, flown: Flown | None) -> Mapping[str, Comparison] | str | None:
    if flown is None or not ready.request.wants_all:
        return None
    return structures(ready.record, flown.t_s, flown.alphas)


def _sifted(
    results: Mapping[str, MethodResult], ready: Prepared, flown: Flown | None
) -> Mapping[str, SiftedMethod] | str | None:
    request = ready.request
    if ready.refusal or not (request.wants_all or request.sift):
        return None
    alphas = {n: flown.alpha(n, ready.record) for n in SIFTED if n in results} if flown else {}
    return sifted(ready.record, alphas, request.card, request.axes)


def _next_input(ready: Prepared, results: Mapping[str, MethodResult], best: str | None) -> NextInput | str | None:
    if ready.refusal or not ready.request.wants_all:
        return None
    fit = next((results[n].fit for n in REGRESSED if n in results and results[n].fit), None)
    return next_input(ready.record, results.get(best or "II"), fit)
