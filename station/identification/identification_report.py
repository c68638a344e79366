"""The identification report: one HTML file with its figures inside, for reading after a flight."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from station.conventions import LATERAL
from station.estimation.flight_record import FlightRecord
from station.estimation.method_table import LIVE, MEASURED
from station.estimation.results import Axes, equations
from station.identification.analysis import flight_record
from station.identification.flown import corrected, fly
from station.identification.html_page import BLUE, FAINT, INK, ORANGE, image, text, write_page
from station.identification.instrument_pages import instrument_pages
from station.identification.kinematics import kinematics
from station.identification.remarks import cleaned
from station.log import Table
from station.numerics.regression import autocorrelation
from station.profile import Aircraft, Card

Array = NDArray[np.float64]

FILE_NAME: Final = "identification.html"
WITH_LATERAL: Final = ("II", "I", "sidpac")
"""Methods that give lateral derivatives."""


def write_report(
    result: Mapping[str, Any],
    table: Table,
    folder: Path,
    *,
    card: Card | None = None,
    imu_position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    noise: Mapping[str, float] | None = None,
    aircraft: Aircraft | None = None,
) -> Path:
    """Write what `identify` found of `table` into `folder` as identification.html; returns its path.

    The keyword arguments are those that identify was given, `aircraft` where it is not the recording's own. Raises
    LogError if the file cannot be written.
    """
    start, end = result["interval_s"]
    subject = aircraft or table.aircraft
    table = corrected(cleaned(table)[0], subject, noise, imu_position)
    record, _ = flight_record(table.between(start, end), subject, imu_position, noise)
    shown = result["recommended"]
    alpha: Array | None = record.alpha
    if shown in LIVE:
        flown = fly(table, record, (shown,), start, result["axes"], card, imu_position, noise, False)
        alpha = flown.alpha(shown, record)
    body = [
        f"<h1>{text(result['aircraft'])}: stability and control derivatives</h1>",
        _summary(result),
        "<h2>Estimates</h2>",
        *(part for names in _groups(result) for part in (_estimates(result, names), _table(result, names))),
        _refusals(result),
    ]
    if shown is not None and alpha is not None:
        body += _fits(result, record, shown, result["axes"], alpha)
        if shown not in WITH_LATERAL:
            beside = [m for m in WITH_LATERAL if m in result["methods"]]
            made = (_fits(result, record, m, result["axes"], record.alpha, LATERAL) for m in beside)
            body += next(filter(None, made), [])
    body.append(_consistency(result))
    body += _spectra(result)
    if "vane_calibration" in result:
        body += instrument_pages(result, kinematics(record), record)
    body.append(_settings(result))
    return write_page(f"Identification: {result['aircraft']}", body, folder / FILE_NAME)


def _summary(result: Mapping[str, Any]) -> str:
    start, end = result["interval_s"]
    air = result["turbulence"]
    std = air["w_std_2_7hz_mps"]
    level = text(air["level"] or "unknown") + ("" if std is None else f" ({std:.3f} m/s vertical gust, 2 to 7 Hz)")
    advice = "nothing could be estimated" if result["recommended"] is None else text(result["recommended"])
    rows = {
        "Recording": text(result["log"] or "–"),
        "Interval": f"{start:.2f} to {end:.2f} s",
        "Air": level,
        "Recommended": advice,
    }
    lines = "".join(f"<tr><td>{k}</td><td style='text-align:left'>{v}</td></tr>" for k, v in rows.items())
    remarks = "".join(f'<p class="note">{text(r)}</p>' for r in (*result["remarks"], result["hint"]) if r)
    return f"<table>{lines}</table>{remarks}"


def _groups(result: Mapping[str, Any]) -> list[list[str]]:
    """Names of the longitudinal derivatives, and of the lateral ones if there are any."""
    found: dict[str, None] = {}
    for method in result["methods"].values():
        found.update(dict.fromkeys(method["parameters"]))
    lateral = [n for n in found if n in LATERAL]
    return [g for g in ([n for n in found if n not in LATERAL], lateral) if g]


def _methods(result: Mapping[str, Any], names: Sequence[str]) -> list[str]:
    """Methods that say anything of these derivatives."""
    return [m for m, found in result["methods"].items() if any(n in found["parameters"] for n in names)]


def _estimates(result: Mapping[str, Any], names: Sequence[str]) -> str:
    """One panel a derivative: every method's estimate with two standard errors; faint where it is not to be used."""
    methods = _methods(result, names)
    columns = 3
    rows = math.ceil(len(names) / columns)
    figure = Figure(figsize=(10, 0.6 + rows * (0.5 + 0.21 * len(methods))), layout="constrained", dpi=120)
    grid = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for i, axes in enumerate(grid.flat):
        if i >= len(names):
            axes.set_axis_off()
            continue
        name = names[i]
        solid = []
        for y, method in enumerate(methods):
            p = result["methods"][method]["parameters"].get(name)
            if p is None or p["estimate"] is None:
                continue
            good = p["status"] == "estimated" and result["methods"][method]["status"] == "ok"
            colour = BLUE if method == result["recommended"] else INK if good else FAINT
            error = None if p["std_error"] is None else 2 * p["std_error"]
            axes.errorbar(p["estimate"], y, xerr=error, fmt="o" if good else "x", color=colour, ms=4, lw=1.2)
            if good:
                solid.append((p["estimate"], error or 0.0))
        if solid:
            # Wide errors of methods that do not apply must not squeeze the others.
            low, high = min(v - e for v, e in solid), max(v + e for v, e in solid)
            margin = 0.15 * (high - low) + 1e-9
            axes.set_xlim(low - margin, high + margin)
        axes.set_title(name, fontsize=10, loc="left", color=INK)
        axes.set_yticks(range(len(methods)), methods, fontsize=8)
        axes.set_ylim(len(methods) - 0.5, -0.5)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.tick_params(labelsize=8, length=2)
        axes.grid(axis="x", color="#eceef2")
        for side in ("top", "right", "left"):
            axes.spines[side].set_visible(False)
    return image(figure, "Derivatives by method with two standard errors")


def _fits(
    result: Mapping[str, Any],
    record: FlightRecord,
    method: str,
    axes_kind: Axes,
    alpha: Array,
    only: Sequence[str] | None = None,
) -> list[str]:
    """Measured and modelled coefficients of a method's equations, residuals and their autocorrelation beside.

    `only`: of the equations with these derivatives. Empty where the method has no values.
    """
    parameters = result["methods"][method]["parameters"]
    shown = []
    for equation in equations(record, axes_kind):
        values = [parameters.get(n, {}).get("estimate") for n in equation.parameters]
        if all(v is not None for v in values) and (only is None or equation.parameters[0] in only):
            x = equation.regressors.copy()
            if equation.parameters[0].endswith("_alpha"):
                x[:, 0] = alpha
            shown.append((equation.name, equation.measured, x @ np.array(values)))
    if not shown:
        return []
    figure = Figure(figsize=(10, 2.6 * len(shown)), layout="constrained", dpi=120)
    grid = figure.subplots(len(shown), 3, squeeze=False, gridspec_kw={"width_ratios": [3, 3, 1.5]})
    step = max(1, len(record.t_s) // 1500)
    for (name, measured, model), (left, middle, right) in zip(shown, grid, strict=True):
        residual = measured - model
        good = np.isfinite(residual)
        constant = float(np.mean(residual[good])) if good.any() else 0.0
        residual = residual - constant
        t = record.t_s[::step]
        left.plot(t, measured[::step], color=INK, lw=1.0, label="measured")
        left.plot(t, (model + constant)[::step], color=ORANGE, lw=1.0, label="model")
        left.set_title(name, fontsize=10, loc="left")
        left.legend(fontsize=8, frameon=False, loc="upper right")
        middle.plot(t, residual[::step], color=INK, lw=0.8)
        middle.set_title("residual", fontsize=10, loc="left")
        r = autocorrelation(residual[good])[: round(2 / record.dt)]
        lags = np.arange(len(r)) * record.dt
        right.fill_between([0, lags[-1]], -2 / math.sqrt(good.sum()), 2 / math.sqrt(good.sum()), color="#e8eef6")
        right.vlines(lags, 0, r / r[0], color=BLUE, lw=1.0)
        right.set_title("autocorrelation", fontsize=10, loc="left")
        for axes in (left, middle, right):
            axes.tick_params(labelsize=8, length=2)
            axes.set_xlabel("s", fontsize=8, loc="right")
            for side in ("top", "right"):
                axes.spines[side].set_visible(False)
    return [
        f"<h2>Fit of {text(method)}</h2>",
        image(figure, "Measured and modelled coefficients, residuals and their autocorrelation"),
        '<p class="note">Each model has a free constant. Bars in the last column are the residuals\' '
        "autocorrelation; inside the band they are white.</p>",
    ]


def _spectra(result: Mapping[str, Any]) -> list[str]:
    """What IV measured: delay, coherence, response of the lift, and the correction of the upwash, over frequency."""
    made = result["methods"].get(MEASURED, {}).get("settings", {}).get("spectra")
    if not made:
        return []
    f = np.array(made["frequency_hz"])
    figure = Figure(figsize=(10, 2.6), layout="constrained", dpi=120)
    panels = {
        "delay, s": (made["delay_s"], 2 * np.array(made["delay_sd_s"])),
        "coherence": (made["coherence"], None),
        "|S|": (made["sears"], None),
        "1/(1 + k_u)": (1 / (1 + np.array(made["upwash"])), None),
    }
    for axes, (title, (values, error)) in zip(figure.subplots(1, 4), panels.items(), strict=True):
        axes.errorbar(f, values, yerr=error, fmt="o", color=BLUE, ms=3, lw=1.0)
        axes.set_xscale("log")
        axes.set_title(title, fontsize=10, loc="left")
        axes.set_xlabel("Hz", fontsize=8, loc="right")
        axes.tick_params(labelsize=8, length=2)
        axes.grid(color="#eceef2")
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    return [
        "<h2>Delay and upwash by frequency</h2>",
        image(figure, "Delay, coherence, response of the lift and correction of the upwash over frequency"),
        '<p class="note">Of the lift against the vane, over the whole recording: what method IV goes by. A positive '
        "delay: the vane is early. Pitch rate and elevator lift too, so it depends on how the aircraft was flown.</p>",
    ]


def _table(result: Mapping[str, Any], names: Sequence[str]) -> str:
    head = "".join(f"<th>{text(n)}</th>" for n in names)
    rows = []
    for method in _methods(result, names):
        found = result["methods"][method]
        cells = []
        for name in names:
            p = found["parameters"].get(name)
            if p is None or p["estimate"] is None:
                cells.append(f'<td class="faint" title="{text(p["why"] if p else "")}">–</td>')
                continue
            usable = p["status"] == "estimated" and found["status"] == "ok"
            style = "" if usable else f' class="faint" title="{text(p["why"])}"'
            cells.append(f"<td{style}>{_rounded(p['estimate'], p['std_error'])}</td>")
        chosen = ' class="chosen"' if method == result["recommended"] else ""
        rows.append(f"<tr{chosen}><td>{text(method)}</td>{''.join(cells)}</tr>")
    return f'<div style="overflow-x:auto"><table><tr><th>method</th>{head}</tr>{"".join(rows)}</table></div>'


def _refusals(result: Mapping[str, Any]) -> str:
    refused = [f"<li>{text(m)}: {text(f['why'])}</li>" for m, f in result["methods"].items() if f["why"]]
    why = f"<p>Not applicable:</p><ul>{''.join(refused)}</ul>" if refused else ""
    return (
        '<p class="note">Estimate ± standard error, per radian, rates normalised with q c/2V, p b/2V, r b/2V. Grey: '
        f"not to be used; the reason shows on pointing at it.</p>{why}"
    )


def _rounded(value: float, error: float | None) -> str:
    """The value to the second significant digit of its error."""
    if error is None or error <= 0:
        return f"{value:.4g}"
    digits = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:.{digits}f} ± {error:.{digits}f}"


def _consistency(result: Mapping[str, Any]) -> str:
    pairs: Sequence[Mapping[str, Any]] = result.get("consistency", {}).get("pairs", ())
    if not pairs:
        return ""
    force = "CL" if result["axes"] == "wind" else "CZ"
    rows = []
    for pair in pairs:
        cells = "".join(f"<td>{pair[of][t]:.3f}</td>" for of in (force, "Cm") for t in ("t_alpha", "t_q", "t_de"))
        verdict = "yes" if pair["agree"] else "no: not the angle of attack alone"
        rows.append(f"<tr><td>{text(pair['to'])}</td>{cells}<td>{verdict}</td></tr>")
    head = "".join(f"<th>{t} ({of})</th>" for of in (force, "Cm") for t in ("t_α", "t_q", "t_δe"))
    return (
        f"<h2>Is it the angle of attack?</h2><p>Against {text(pairs[0]['from'])}. A wrong angle of attack changes "
        "lift and moment derivatives by the same three numbers; where they differ, something else does.</p>"
        f'<div style="overflow-x:auto"><table><tr><th>method</th>{head}<th>agree</th></tr>{"".join(rows)}</table></div>'
    )


def _settings(result: Mapping[str, Any]) -> str:
    rows = []
    for method, found in result["methods"].items():
        plain = {k: v for k, v in found["settings"].items() if k not in ("all_parameters", "spectra")}
        words = "; ".join(f"{k.replace('_', ' ')}: {_value(v)}" for k, v in plain.items())
        rows.append(
            f"<tr><td>{text(method)}</td><td style='text-align:left;white-space:normal'>{text(words)}</td></tr>"
        )
    return f"<h2>Settings</h2><table>{''.join(rows)}</table>"


def _value(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(_value(v) for v in value)
    return str(value)
