"""The diagnosis report: one HTML file with its figures inside."""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator
from numpy.typing import NDArray

from station.conventions import from_si
from station.discrepancy import judge
from station.discrepancy.diagnosis import Diagnosis
from station.discrepancy.effects import BY_ID
from station.discrepancy.processing import HIGH_HZ, back, transform
from station.discrepancy.reference import Reference, loaded
from station.discrepancy.residuals import SERIES, series
from station.discrepancy.search import FIRST
from station.discrepancy.structure import GUST
from station.profile import Aircraft
from station.rows import LogError

Array = NDArray[np.float64]

FILE_NAME: Final = "diagnosis.html"
_INK, _FAINT, _AFTER, _BEFORE = "#1f2430", "#a9b0bd", "#d55e00", "#0072b2"
_STYLE: Final = """
body{font:15px/1.5 system-ui,sans-serif;color:#1f2430;max-width:60rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.5rem}h2{font-size:1.15rem;margin-top:2rem}p.verdict{font-size:1.15rem;font-weight:600}
table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:.9rem}
th,td{padding:.2rem .6rem;text-align:right;border-bottom:1px solid #e3e6eb;vertical-align:top}
th:first-child,td:first-child,.words{text-align:left}td:not(.words){white-space:nowrap}img{max-width:100%}p.note{color:#5a6270;font-size:.9rem}
"""
_VERDICT: Final = {
    "no_effect": "Nothing found: the measured flight agrees with the simulation within noise and gusts.",
    "effect_found": "Found what is different, and nothing else could be it.",
    "confounded": "Found what is different, but these manoeuvres cannot tell it from something else.",
    "unexplained": "Something is different that no effect of the catalogue explains. Effects named below are suspect.",
}
_MEANING: Final = {
    "theta": ("attitude less integral of pitch rate", "deg", "deg"),
    "v_down": ("sink rate less integral of accelerations", "m/s", "m/s"),
    "v_north": ("ground speed less integral of accelerations", "m/s", "m/s"),
    "alpha_vane": ("vane less inertial flow angle: the gust", "deg", "deg"),
    "lift": ("lift coefficient less model", "1", ""),
    "moment": ("pitching-moment coefficient less model", "1", ""),
    "drag": ("drag coefficient less model", "1", ""),
}


def write_report(found: Diagnosis, result: Mapping[str, Any], folder: Path) -> Path:
    """Write the page into `folder` as diagnosis.html; returns its path. Raises LogError if it cannot be written."""
    before, after = found.before, found.after
    body = [
        f"<h1>{_text(result['aircraft'])}: measured against simulated</h1>",
        f'<p class="verdict">{_VERDICT[found.verdict]}</p>',
        effects_table(result),
        _left(result),
        _doubted(result["with_model_error"]),
        _next(found),
        _gain(result),
        image(_by_record(found, before, after), "error of each manoeuvre before and after")
        if result["effects"]
        else "",
        "<h2>What differs, by instrument and model</h2>",
        image(_spectra(found, before, after), "spectra of each series before and after"),
        _residuals(result),
        "<h2>In time</h2>",
        image(_times(found, before, after), "each series over time before and after"),
        "<h2>What was checked</h2>",
        image(_drops(found), "how much each effect alone would explain"),
        _checked(result),
        _derivatives(result),
        _settings(result),
    ]
    return write_page(f"Diagnosis: {result['aircraft']}", body, folder / FILE_NAME)


def write_page(title: str, body: Sequence[str], path: Path) -> Path:
    """A page of these pieces of HTML. Raises LogError if it cannot be written."""
    page = (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{_text(title)}</title>'
        f"<style>{_STYLE}</style>{''.join(body)}</html>\n"
    )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error.strerror}") from error
    return path


# --- words and tables


def _text(value: object) -> str:
    return html.escape(str(value))


def _shown(name: str, value: float, unit: str = "1") -> str:
    term = BY_ID.get(name)
    shown = term.shown if term else unit
    return f"{from_si(value, shown):.3g}{'' if shown == '1' else f' {shown}'}"


def effects_table(result: Mapping[str, Any]) -> str:
    """The effects of a result, with values and intervals; nothing where there are none."""
    if not result["effects"]:
        return ""
    rows = []
    for e in result["effects"]:
        low, high = e["ci95"]
        drop, unit = e["evidence"]["drop"], e.get("shown", e["unit"])
        evidence = "seen at once" if drop is None else f"{drop:.1f}"
        rivals = f"Could also be {', '.join(e['confounded_with'])}." if e["confounded_with"] else ""
        suspect = " (suspect)" if e["suspect"] else ""
        rows.append(
            f"<tr><td>{_text(e['id'])}{suspect}</td><td class='words'>{_text(e['sentence'])} {_text(rivals)}</td>"
            f"<td>{_shown(e['id'], e['value'], unit)}</td>"
            f"<td>{_shown(e['id'], low, unit)} to {_shown(e['id'], high, unit)}</td>"
            f"<td>{evidence}</td></tr>"
        )
    head = "<tr><th>effect</th><th class='words'>in words</th><th>value</th><th>95 %</th><th>evidence</th></tr>"
    note = f"Evidence is the drop of -2 log likelihood; {FIRST:g} is asked of a first effect."
    return f'<h2>Effects</h2><table>{head}{"".join(rows)}</table><p class="note">{note}</p>'


def _left(result: Mapping[str, Any]) -> str:
    left = result["unexplained"]
    if not left["present"]:
        return ""
    low, high = left["band_hz"]
    like = f", in step with {left['like']}" if left["like"] else ""
    where = f"{_text(', '.join(left['signals']))} from {low:.2f} to {high:.2f} Hz{_text(like)}"
    numbers = f"log p {left['log_p']:.1f} (limit {judge.LEFT_LOG_P:g}), coherence {left['score']:.1f} "
    return (
        f"<h2>Unexplained</h2><p>What is left has structure: {where}.</p>"
        f'<p class="note">{numbers}(limit {judge.LEFT_SCORE:g}).</p>'
    )


def _doubted(found: Mapping[str, Any] | None) -> str:
    """What was allowed for, where the model is in doubt."""
    if found is None:
        return ""
    missed = ", ".join(f"{100 * v:.0f} % of {n}" for n, v in found["missed"].items())
    words = " ".join(e["sentence"] for e in found["with_the_model_taken_for_right"])
    return (
        "<h2>The model in doubt</h2><p>The aircraft's model does not suffice. Its derivatives and terms were freed, "
        f"and what it still misses ({_text(missed)}) was taken as noise. Instruments "
        "are named only where they contradict each other, without any aerodynamics.</p>"
        + (f'<p class="note">With the model taken for right: {_text(words)}</p>' if words else "")
    )


def _next(found: Diagnosis) -> str:
    advice = [f"{e.term.id} or {', '.join(e.rivals)}: {e.term.separate_by}." for e in found.effects if e.rivals]
    if found.leftover.present:
        advice.append(
            f"Unexplained in {found.leftover.series}: repeat the manoeuvre in calm air, at another amplitude and "
            "at another speed: what follows time, distance, amplitude or load tells what it is."
        )
    if not any(r.setting.gusty for r in found.problem.references) and GUST not in [e.term for e in found.effects]:
        advice.append("The gust path was not judged: all of this was calm. One manoeuvre in turbulence shows it.")
    advice += [f"{_first_upper(r)}." for r in found.remarks]
    lines = "".join(f"<li>{_text(a)}</li>" for a in advice)
    return f"<h2>What to fly or check next</h2><ul>{lines}</ul>" if advice else ""


def _first_upper(words: str) -> str:
    return words[:1].upper() + words[1:]


def _gain(result: Mapping[str, Any]) -> str:
    gain = result["gain"]
    if gain is None:
        why = "nothing was accepted" if not result["effects"] else "no manoeuvre was held out"
        return f'<h2>Gain</h2><p class="note">Not measured: {why}.</p>'
    low, high = gain["ci95"]
    rows = "".join(
        f"<tr><td>{_text(r['record'])}</td><td>{r['before']:.3f}</td><td>{r['after']:.3f}</td></tr>"
        for r in gain["by_record"]
    )
    return (
        f"<h2>Gain</h2><p>Held-out error {gain['before']:.3f} &rarr; {gain['after']:.3f}: "
        f"{gain['reduction_percent']:.1f} % less (95 %: {low:.1f} to {high:.1f} %), "
        "for manoeuvres and air of this kind.</p>"
        f"<table><tr><th>held out</th><th>before</th><th>after</th></tr>{rows}</table>"
        '<p class="note">In standard deviations of noise and gust: 1 is a perfect model.</p>'
    )


def _residuals(result: Mapping[str, Any]) -> str:
    rows = "".join(
        f"<tr><td>{_text(name)}</td><td class='words'>{_MEANING[name][0]}</td><td>{r['rms_before']:.2f}</td>"
        f"<td>{r['rms_after']:.2f}</td><td>{'yes' if r['white'] else 'no'}</td></tr>"
        for name, r in result["residuals"].items()
    )
    head = "<tr><th>series</th><th class='words'>is</th><th>before</th><th>after</th><th>as expected</th></tr>"
    return (
        f"<table>{head}{rows}</table>"
        '<p class="note">Over the noise of the sensors in calm air; gusts raise the vane and drag.</p>'
    )


def _checked(result: Mapping[str, Any]) -> str:
    sizes = {x["id"]: x for x in result["detectable"]}
    rows = ""
    for x in result["excluded"]:
        size = sizes.get(x["id"])
        told = ("–", "–") if size is None else (_shown(x["id"], size["size"]), _shown(x["id"], size["size_named"]))
        rows += f"<tr><td>{_text(x['id'])}</td><td>{_shown(x['id'], x['value'])}</td><td>{x['drop']:.1f}</td>"
        rows += f"<td>{told[0]}</td><td>{told[1]}</td><td>{_text(size['rival']) if size else ''}</td></tr>"
    head = (
        "<tr><th>alone, not accepted</th><th>its best value</th><th>drop</th><th>would be found</th>"
        "<th>and told from</th><th>its nearest rival</th></tr>"
    )
    note = "Sizes that manoeuvres like these, in this air, show nine times in ten."
    return (
        "<details><summary>Every effect alone, and how large it would have to be</summary>"
        f'<table>{head}{rows}</table><p class="note">{note}</p></details>'
    )


def _derivatives(result: Mapping[str, Any]) -> str:
    rows = "".join(
        f"<tr><td>{_text(n)}</td><td>{d['change_percent']:+.1f} %</td><td>{d['in_prior_sd']:+.2f}</td></tr>"
        for n, d in result["derivatives"].items()
    )
    head = "<tr><th>derivative</th><th>best within its prior</th><th>in prior sd</th></tr>"
    note = "Beyond 2 the profile's value, or its stated uncertainty, is doubtful."
    return f'<h2>Derivatives</h2><table>{head}{rows}</table><p class="note">{note}</p>'


def _settings(result: Mapping[str, Any]) -> str:
    lines = []
    for name, gust in result["gust_sigma_mps"].items():
        noise = ", ".join(f"{s} {v:.2g}" for s, v in result["noise"][name].items())
        lines.append(f"<li>{_text(name)}: gust {gust:.2f} m/s; noise found (SI): {_text(noise)}</li>")
    held = _text(", ".join(result["held_out"]) or "none")
    return f"<h2>Records</h2><ul>{''.join(lines)}</ul><p class='note'>Held out: {held}.</p>"


# --- pictures


def image(figure: Figure, words: str) -> str:
    """The figure as an element of the page."""
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(buffer, format="png")
    return f'<img alt="{words}" src="data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}">'


def _most_changed(found: Diagnosis, before: Aircraft, after: Aircraft) -> Reference:
    """The manoeuvre that the accepted effects change most, held-out ones first if there are any."""
    pool = found.held_out or found.problem.references

    def change(r: Reference) -> float:
        one, other = judge.channel_error(r, before), judge.channel_error(r, after)
        return sum(abs(one[n] ** 2 - other[n] ** 2) for n in one)

    return max(pool, key=change)


def _scale(name: str) -> float:
    return math.degrees(1) if _MEANING[name][1] == "deg" else 1.0


def _spectra(found: Diagnosis, before: Aircraft, after: Aircraft) -> Figure:
    r = _most_changed(found, before, after)
    names = [SERIES[j] for j in r.setting.judged]
    rows = math.ceil(len(names) / 2)
    figure = Figure(figsize=(10, 0.4 + 2.1 * rows), layout="constrained", dpi=90)
    figure.suptitle(f"{r.record.name}: amplitude against frequency", x=0.01, ha="left", fontsize=10)
    grid = figure.subplots(rows, 2, squeeze=False)
    f = r.setting.frequencies
    one, other = r.differences(before), r.differences(after)
    inverse = np.linalg.inv(r.bins.rotate)
    gust = max(found.found.accepted.gust) if r in found.held_out else _gust_of(found, r)
    scale = 1 + gust**2 * r.bins.turbulent
    variance = np.einsum("mij,mj,mij->mi", inverse, scale, np.conj(inverse)).real
    for k, name in enumerate(names):
        axes = grid.flat[k]
        unit = _scale(name)
        level = np.sqrt(variance[:, k]) * unit
        axes.fill_between(f, 0.22 * level, 1.73 * level, color=_FAINT, alpha=0.45, lw=0, label="expected, 90 %")
        axes.loglog(f, np.abs(one.bins[k]) * unit, color=_BEFORE, lw=1, label="before")
        axes.loglog(f, np.abs(other.bins[k]) * unit, color=_AFTER, lw=1, label="after")
        axes.set_title(f"{name} [{_MEANING[name][2] or '1'}]", fontsize=9, loc="left")
        axes.xaxis.set_major_locator(FixedLocator([0.1, 0.2, 0.5, 1, 2, 3]))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_locator(NullLocator())
        axes.tick_params(labelsize=8)
        if k >= len(names) - 2:
            axes.set_xlabel("Hz", fontsize=8)
    for axes in grid.flat[len(names) :]:
        axes.set_axis_off()
    grid.flat[0].legend(fontsize=8, frameon=False, loc="lower left")
    return figure


def _by_record(found: Diagnosis, before: Aircraft, after: Aircraft) -> Figure:
    """Error of each manoeuvre, fitted and held out, before and after, by series."""
    records = [(r, "fitted") for r in found.problem.references] + [(r, "held out") for r in found.held_out]
    figure = Figure(figsize=(10, 2.4), layout="constrained", dpi=90)
    grid = figure.subplots(1, len(records), sharey=True, squeeze=False)[0]
    for axes, (r, use) in zip(grid, records, strict=True):
        one, other = judge.channel_error(r, before), judge.channel_error(r, after)
        at = np.arange(len(one))
        axes.bar(at - 0.2, list(one.values()), 0.4, color=_BEFORE, label="before")
        axes.bar(at + 0.2, list(other.values()), 0.4, color=_AFTER, label="after")
        axes.set_xticks(at, list(one), rotation=40, ha="right", fontsize=7)
        axes.set_title(f"{r.record.name}, {use}", fontsize=8, loc="left")
        axes.tick_params(axis="y", labelsize=8)
    grid[0].set_ylabel("error over calm noise", fontsize=8)
    grid[0].legend(fontsize=7, frameon=False)
    return figure


def _gust_of(found: Diagnosis, r: Reference) -> float:
    for reference, gust in zip(found.problem.references, found.found.accepted.gust, strict=True):
        if reference is r:
            return gust
    return r.gust_guess


def series_in_time(
    found: Diagnosis, before: Aircraft, after: Aircraft, count: int | None = None
) -> tuple[str, dict[str, dict[str, tuple[Array, Array]]]]:
    """The manoeuvre that changes most, and over its time (s) the elevator and each series, most changed first, before
    and after; by plot and line."""
    r = _most_changed(found, before, after)
    s = r.setting
    one, other = judge.channel_error(r, before), judge.channel_error(r, after)
    names = sorted(one, key=lambda n: -abs(one[n] ** 2 - other[n] ** 2))[:count]
    t: Array = r.record.start_s + r.record.dt * np.arange(r.record.n, dtype=np.float64)
    inside = slice(s.cut, s.n - s.cut)
    plots: dict[str, dict[str, tuple[Array, Array]]] = {
        "elevator, deg": {"measured": (t, np.degrees(r.record.signals["elevator"]))}
    }
    for name in names:
        j = SERIES.index(name)
        lines = plots.setdefault(f"{name}, {_MEANING[name][2] or '1'}", {})
        for aircraft, label in ((before, "before"), (after, "after")):
            own = loaded(aircraft, r.record, r.mass_share, r.iyy_share)
            whole = back(transform(series(r.record.signals, own, s)[j], s) * (s.omega < 2 * np.pi * HIGH_HZ), s)
            lines[label] = (t[inside], _levelled(whole[inside] * _scale(name)))
    return r.record.name, plots


def _times(found: Diagnosis, before: Aircraft, after: Aircraft) -> Figure:
    title, plots = series_in_time(found, before, after, 3)
    figure = Figure(figsize=(10, 1.6 + 1.9 * (len(plots) - 1)), layout="constrained", dpi=90)
    figure.suptitle(title, x=0.01, ha="left", fontsize=10)
    grid = figure.subplots(len(plots), 1, sharex=True)
    colours = {"measured": _INK, "before": _BEFORE, "after": _AFTER}
    for axes, (name, lines) in zip(grid, plots.items(), strict=True):
        for label, (t, y) in lines.items():
            axes.plot(t, y, color=colours[label], lw=1, label=label)
        axes.set_ylabel(name, fontsize=8)
        meaning = _MEANING.get(name.partition(",")[0])
        if meaning is not None:
            axes.set_title(meaning[0], fontsize=8, loc="left")
        axes.tick_params(labelsize=8)
        axes.axhline(0, color=_FAINT, lw=0.5)
    grid[1].legend(fontsize=8, frameon=False, ncols=2, loc="upper right")
    grid[-1].set_xlabel("s", fontsize=8)
    return figure


def _levelled(y: Array) -> Array:
    """Without its straight line: an integral's drift is judged apart."""
    t = np.linspace(-0.5, 0.5, len(y))
    out: Array = y - y.mean() - float((y * t).sum() / (t * t).sum()) * t
    return out


def _drops(found: Diagnosis) -> Figure:
    fits = [f for f in found.found.singles if math.isfinite(f.cost)][:14]
    names = [f.ids[0] for f in fits]
    drops = [max(found.found.screened - f.cost, 0.05) for f in fits]
    rivals = {x for e in found.effects for x in e.rivals}
    accepted = {e.term.id for e in found.effects}
    colours = [_AFTER if n in accepted else "#e69f00" if n in rivals else _FAINT for n in names]
    figure = Figure(figsize=(10, 0.8 + 0.24 * len(names)), layout="constrained", dpi=90)
    axes = figure.subplots()
    axes.barh(names[::-1], drops[::-1], color=colours[::-1])
    axes.axvline(FIRST, color=_INK, lw=0.8, ls=":")
    axes.set_xscale("log")
    axes.set_xlabel("drop of -2 log likelihood, alone (dotted: asked for; orange: accepted; yellow: rival)", fontsize=8)
    axes.tick_params(labelsize=8)
    return figure
