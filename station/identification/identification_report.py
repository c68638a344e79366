"""The identification report: one HTML file with its figures inside, for reading after a flight."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes as Panel
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from station.conventions import LATERAL
from station.estimation.method_table import METHODS
from station.estimation.results import MethodResult
from station.identification.boom_page import boom_page
from station.identification.drag_page import drag_page
from station.identification.drag_results import drag_of
from station.identification.handling_pages import derived_page
from station.identification.handling_qualities import identified_qualities
from station.identification.html_page import BLUE, FAINT, INK, ORANGE, image, text, without_frame, write_page
from station.identification.identification_answer import (
    POINTS,
    answer,
    answer_picture,
    answer_table,
    is_usable,
    modelled,
    rounded,
)
from station.identification.identified import Identification
from station.identification.instrument_lag_page import lag_page
from station.identification.instrument_pages import input_pages, kinematic_pages
from station.identification.listing import definitions
from station.identification.spectra_pages import spectra_pages
from station.numerics.regression import autocorrelation

Array = NDArray[np.float64]

FILE_NAME: Final = "identification.html"
LAGS_S: Final = 2.0
"""Of the autocorrelation."""
COLUMNS: Final = 3
"""Panels side by side."""
GRID: Final = "#eceef2"
REGRESSED: Final = ("split", "II", "I")
"""Methods whose fit is shown where the recommended one regresses on no angle of attack."""
SETTINGS: Final = {
    "frequencies_hz": "lowest frequency, step and highest (Hz)",
    "delay_s": "delay (s)",
    "deviance_less_than_quasi_steady": "deviance reduction against the quasi-steady model",
    "sifted_lines_hz": "lines of the multisine (Hz)",
}
"""In words, where a setting's name is not enough."""
NOT_SHOWN: Final = ("all_parameters", "spectra")
"""Settings that are no words."""


def write_report(found: Identification, folder: Path) -> Path:
    """Write `found` into `folder` as identification.html; returns its path. Raises LogError if it cannot be written."""
    body = [
        f"<h1>{text(found.aircraft.name)}: stability and control derivatives</h1>",
        f'<p class="verdict">{text(answer(found))}</p>',
        answer_table(found, groups(found)),
        _answer_picture(found),
        _summary(found),
        *(lag_page(found.instruments) if found.instruments is not None else []),
        "<h2>Estimates</h2>",
        _scale_note(found),
        *(part for names in groups(found) for part in (_estimates(found, names), estimates_table(found, names))),
        _refusals(found),
    ]
    shown, alpha = _fitted(found)
    if alpha is not None:
        body += _fits(found, shown, alpha)
        if not _gives_sideslip(shown):
            lateral = (_fits(found, m, found.record.alpha, LATERAL) for m in found.methods if _gives_sideslip(m))
            body += next(filter(None, lateral), [])
    body += derived_page(identified_qualities(found))
    body += drag_page(drag_of(found.record))
    body.append(_consistency(found))
    body += _spectra(found)
    body += spectra_pages(found.record)
    body += boom_page(found.boom, found.aircraft)
    if found.kinematics is not None:
        body += kinematic_pages(found.kinematics, found.record)
    body += input_pages(found)
    body.append(_settings(found))
    return write_page(f"Identification: {found.aircraft.name}", body, folder / FILE_NAME)


def _scale_note(found: Identification) -> str:
    """What no instrument shows of the derivatives by surfaces."""
    share = found.aircraft.uncertainty.surface_scale
    known = f"{100 * share:g} % of it is in their errors" if share else "the profile takes it for exact"
    return (
        '<p class="note">Derivatives by a surface (CL_de, Cl_da, Cn_dr, ...) stand and fall with the scale of what '
        f"measures the surface, which no other instrument shows: {known} (surface_scale of [uncertainty]).</p>"
    )


def _fitted(found: Identification) -> tuple[str, Array | None]:
    """The method whose fit is shown, the recommended one if it regresses on an angle of attack (n,), and that angle;
    None where no method gives one."""
    for method in (found.recommended or "", *REGRESSED):
        if method in found.methods and found.methods[method].status == "ok":
            alpha = found.record.alpha if METHODS[method].runner else None
            if alpha is None and found.flown is not None:
                alpha = found.flown.alpha(method, found.record)
            if alpha is not None:
                return method, alpha
    return "", None


def _answer_picture(found: Identification) -> str:
    """The fit of the method shown; empty where none has one."""
    method, alpha = _fitted(found)
    return answer_picture(found, method, alpha) if alpha is not None else ""


def _gives_sideslip(method: str) -> bool:
    """Whether a method gives lateral derivatives with the vane's sideslip, which the record has."""
    return METHODS[method].lateral and METHODS[method].angle == "steady"


def _summary(found: Identification) -> str:
    start, end = found.interval_s
    air = found.turbulence
    if math.isfinite(found.gust_sd):
        air += f" (vertical gust {found.gust_sd:.3f} m/s rms, 2 to 7 Hz)"
    rows = {
        "Recording": found.log or "–",
        "Interval": f"{start:.2f} to {end:.2f} s",
        "Turbulence": air,
        "Recommended method": found.recommended or "none: nothing could be estimated",
    }
    lines = "".join(f"<tr><td>{k}</td><td class='words'>{text(v)}</td></tr>" for k, v in rows.items())
    remarks = "".join(f'<p class="note">{text(r)}</p>' for r in (*found.remarks, found.hint) if r)
    return f"<table>{lines}</table>{remarks}"


def groups(found: Identification) -> list[list[str]]:
    """Names of the longitudinal derivatives, and of the lateral ones if there are any."""
    names = list(dict.fromkeys(p.name for result in found.methods.values() for p in result.parameters))
    lateral = [n for n in names if n in LATERAL]
    return [g for g in ([n for n in names if n not in LATERAL], lateral) if g]


def _rows(found: Identification, names: Sequence[str]) -> dict[str, MethodResult]:
    """Methods that have any of these derivatives."""
    return {m: r for m, r in found.methods.items() if any(p.name in names for p in r.parameters)}


def _estimates(found: Identification, names: Sequence[str]) -> str:
    return image(estimates_figure(found, names), "Derivatives by method with two standard errors")


def estimates_figure(found: Identification, names: Sequence[str]) -> Figure:
    """One panel a derivative: every method's estimate with two standard errors; faint where it is not usable."""
    methods = _rows(found, names)
    rows = math.ceil(len(names) / COLUMNS)
    figure = Figure(figsize=(10, 0.6 + rows * (0.5 + 0.21 * len(methods))), layout="constrained", dpi=120)
    grid = figure.subplots(rows, COLUMNS, sharey=True, squeeze=False)
    for panel, name in zip(grid.flat, names, strict=False):
        _estimates_of(panel, name, methods, found.recommended)
    for panel in grid.flat[len(names) :]:
        panel.set_axis_off()
    return figure


def _estimates_of(panel: Panel, name: str, methods: dict[str, MethodResult], recommended: str | None) -> None:
    usable = []
    for y, (method, result) in enumerate(methods.items()):
        p = result.parameter(name)
        if p is None or not math.isfinite(p.value):
            continue
        good = is_usable(result, p)
        colour = BLUE if method == recommended else INK if good else FAINT
        error = 2 * p.sd if math.isfinite(p.sd) else None
        panel.errorbar(p.value, y, xerr=error, fmt="o" if good else "x", color=colour, ms=4, lw=1.2)
        if good:
            usable.append((p.value, error or 0.0))
    if usable:
        # Wide errors of methods that do not apply must not squeeze the others.
        low, high = min(v - e for v, e in usable), max(v + e for v, e in usable)
        margin = 0.15 * (high - low) + 1e-9
        panel.set_xlim(low - margin, high + margin)
    panel.set_title(name, fontsize=10, loc="left", color=INK)
    panel.set_yticks(range(len(methods)), list(methods), fontsize=8)
    panel.set_ylim(len(methods) - 0.5, -0.5)
    panel.xaxis.set_major_locator(MaxNLocator(4))
    panel.tick_params(labelsize=8, length=2)
    panel.grid(axis="x", color=GRID)
    without_frame(panel, "top", "right", "left")


def _fits(found: Identification, method: str, alpha: Array, only: Sequence[str] | None = None) -> list[str]:
    """Measured and modelled coefficients of a method's equations, residuals and their autocorrelation beside.

    `alpha` (n,): what the method regresses on. `only`: of the equations with these derivatives. Empty where the method
    has no values.
    """
    record, shown = found.record, modelled(found, method, alpha, only)
    if not shown:
        return []
    figure = Figure(figsize=(10, 2.6 * len(shown)), layout="constrained", dpi=120)
    grid = figure.subplots(len(shown), 3, squeeze=False, gridspec_kw={"width_ratios": [3, 3, 1.5]})
    for (name, measured, model), panels in zip(shown, grid, strict=True):
        _fit_of(panels, name, record.t_s, measured, model, record.dt)
    return [
        f"<h2>Fit of {text(method)}</h2>",
        image(figure, "Measured and modelled coefficients, residuals and their autocorrelation"),
        '<p class="note">Each model has a free constant. Right: autocorrelation of the residuals over the lag; within '
        "the band (two standard deviations) they are white.</p>",
    ]


def _fit_of(panels: Sequence[Panel], name: str, t_s: Array, measured: Array, model: Array, dt: float) -> None:
    series, rest, correlation = panels
    residual = measured - model
    good = np.isfinite(residual)
    constant = float(np.mean(residual[good])) if good.any() else 0.0
    step = max(1, len(t_s) // POINTS)
    t = t_s[::step]
    series.plot(t, measured[::step], color=INK, lw=1.0, label="measured")
    series.plot(t, (model + constant)[::step], color=ORANGE, lw=1.0, label="model")
    series.set_title(name, fontsize=10, loc="left")
    series.legend(fontsize=8, frameon=False, loc="upper right")
    rest.plot(t, (residual - constant)[::step], color=INK, lw=0.8)
    rest.set_title(f"{name}: residual", fontsize=10, loc="left")
    r = autocorrelation((residual - constant)[good])[: round(LAGS_S / dt)]
    lags = np.arange(len(r)) * dt
    bound = 2 / math.sqrt(good.sum())
    correlation.fill_between([0, lags[-1]], -bound, bound, color="#e8eef6")
    correlation.vlines(lags, 0, r / r[0], color=BLUE, lw=1.0)
    correlation.set_title("autocorrelation", fontsize=10, loc="left")
    for panel, label in ((series, "time, s"), (rest, "time, s"), (correlation, "lag, s")):
        panel.tick_params(labelsize=8, length=2)
        panel.set_xlabel(label, fontsize=8, loc="right")
        without_frame(panel, "top", "right")


def _spectra(found: Identification) -> list[str]:
    """What IV was given: delay, coherence, response of the lift, and the correction of the upwash, over frequency."""
    spectra = found.flown.spectra if found.flown else None
    if spectra is None:
        return []
    good = spectra.believed
    panels: dict[str, tuple[Array, Array | None]] = {
        "delay, s": (spectra.delay_s, 2 * spectra.delay_sd[good]),
        "coherence": (spectra.coherence, None),
        "|S_G|, response of the lift": (spectra.sears, None),
        "1/(1 + k_u)": (1 / (1 + spectra.upwash), None),
    }
    figure = Figure(figsize=(10, 2.6), layout="constrained", dpi=120)
    for panel, (title, (values, error)) in zip(figure.subplots(1, 4), panels.items(), strict=True):
        panel.errorbar(spectra.frequencies_hz[good], values[good], yerr=error, fmt="o", color=BLUE, ms=3, lw=1.0)
        panel.set_xscale("log")
        panel.set_title(title, fontsize=10, loc="left")
        panel.set_xlabel("frequency, Hz", fontsize=8, loc="right")
        panel.tick_params(labelsize=8, length=2)
        panel.grid(color=GRID)
        without_frame(panel, "top", "right")
    return [
        "<h2>Delay and upwash by frequency</h2>",
        image(figure, "Delay, coherence, response of the lift and correction of the upwash over frequency"),
        '<p class="note">From the cross-spectra of lift and vane over the whole recording, with two standard errors: '
        "what method IV corrects by. A positive delay: the vane leads the lift. Pitch rate and elevator make lift too, "
        "so the delay depends on how the aircraft was flown.</p>",
    ]


def estimates_table(found: Identification, names: Sequence[str]) -> str:
    """A row a method, a column a derivative."""
    head = "".join(f"<th>{text(n)}</th>" for n in names)
    rows = []
    for method, result in _rows(found, names).items():
        cells = []
        for p in (result.parameter(name) for name in names):
            if p is None or not math.isfinite(p.value):
                cells.append(f'<td class="faint" title="{text(p.why if p else "")}">–</td>')
                continue
            style = "" if is_usable(result, p) else f' class="faint" title="{text(p.why)}"'
            cells.append(f"<td{style}>{rounded(p.value, p.sd)}</td>")
        chosen = ' class="chosen"' if method == found.recommended else ""
        rows.append(f"<tr{chosen}><td>{text(method)}</td>{''.join(cells)}</tr>")
        beside = {p.name: p for p in result.quasi_steady if is_usable(result, p)}
        if beside.keys() & set(names):
            cells = [f"<td>{rounded(beside[n].value, beside[n].sd) if n in beside else '–'}</td>" for n in names]
            rows.append(f"<tr><td>{text(method)}, quasi-steady</td>{''.join(cells)}</tr>")
    return f'<div class="wide"><table><tr><th>method</th>{head}</tr>{"".join(rows)}</table></div>'


def _refusals(found: Identification) -> str:
    refused = [f"<li>{text(m)}: {text(r.why)}</li>" for m, r in found.methods.items() if r.why]
    own = [m for m, r in found.methods.items() if r.quasi_steady]
    meaning = f" {text(definitions(own))}" if own else ""
    why = f"<p>Not applicable:</p><ul>{''.join(refused)}</ul>" if refused else ""
    return (
        '<p class="note">Estimate ± standard error, per radian, rates normalised with q c/2V, p b/2V, r b/2V; the '
        f"pictures show ± 2 standard errors. Bold: recommended. Grey: not usable; point at it for the reason."
        f"{meaning}</p>{why}"
    )


def _consistency(found: Identification) -> str:
    if found.consistency is None or not found.consistency.pairs:
        return ""
    force = "CL" if found.axes == "wind" else "CZ"
    rows = []
    for pair in found.consistency.pairs:
        numbers = [x for t in (pair.force, pair.moment) for x in (t.t_alpha, t.t_q, t.t_de)]
        cells = "".join(f"<td>{x:.3f}</td>" for x in numbers)
        verdict = "yes" if pair.agree else "no: not the angle of attack alone"
        rows.append(f"<tr><td>{text(pair.method)}</td>{cells}<td>{verdict}</td></tr>")
    head = "".join(f"<th>{t} ({of})</th>" for of in (force, "Cm") for t in ("t_α", "t_q", "t_δe"))
    return (
        f"<h2>Do the methods differ by the angle of attack alone?</h2><p>Each against {text(found.consistency.base)}: "
        "an error of the angle of attack, α' = t_α α + t_q q c/2V + t_δe δe, changes lift and moment derivatives by "
        "the same three numbers; where these differ, the methods differ by something else.</p>"
        f'<div class="wide"><table><tr><th>method</th>{head}<th>agree</th></tr>{"".join(rows)}</table></div>'
    )


def _settings(found: Identification) -> str:
    rows = []
    for method, result in found.methods.items():
        plain = {k: v for k, v in result.settings.items() if k not in NOT_SHOWN}
        words = "; ".join(f"{SETTINGS.get(k, k.replace('_', ' '))}: {_value(v)}" for k, v in plain.items())
        rows.append(f"<tr><td>{text(method)}</td><td class='words' style='white-space:normal'>{text(words)}</td></tr>")
    return f"<h2>Settings</h2><table>{''.join(rows)}</table>"


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(_value(v) for v in value)
    return str(value)
