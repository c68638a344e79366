"""A programme's report: one HTML file with its figures inside.

After Martos 2013: turbulence over the flight with the inputs marked (Figure 40), the vane's spectra (Figures 19, 44,
45, 49 to 51), every method at a point beside the baseline's points (Figures 42, 53, 55), the baseline (Table 7) and
each point's change against it (Tables 8 to 10).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes as Panel
from matplotlib.figure import Figure
from numpy.typing import NDArray

from station.conventions import LONGITUDINAL
from station.identification.html_page import BLUE, FAINT, INK, ORANGE, image, text, without_frame, write_page
from station.identification.spectra_pages import spectra_pages
from station.numerics.random_effects import Pooled
from station.programme.air_of_flight import air_of
from station.programme.changes import CALM, OWN, Change, compared, estimates, recommended
from station.programme.flown_points import FlownPoint
from station.programme.histories_overlaid import histories_overlaid
from station.programme.points_listing import W_BAND, drag_words, rounded
from station.programme.programme import Flight, Programme, significant
from station.rows import ParamEstimate, Status

Array = NDArray[np.float64]

FILE_NAME: Final = "points.html"
GREEN: Final = "#009e73"
"""Of the baseline's points."""
QUOTED: Final = 3
"""Changed points in the sentence, those that stand out most; all are in the table."""
COLUMNS: Final = (
    "point", "condition", "s", "inputs", "air during the input", "w 2–7 Hz, m/s", "CD_0", "method", "changed",
)  # fmt: skip
DRAWN: Final = 6000
"""Values of a line in a picture."""


def write_report(made: Programme, folder: Path) -> Path:
    """Write points.html into `folder`; returns its path. Raises LogError if it cannot be written."""
    body = [
        f"<h1>{text(made.aircraft.name)}: test points</h1>",
        f'<p class="verdict">{text(answer(made))}</p>',
        _points(made),
        *(f'<p class="note">{text(r)}</p>' for r in made.remarks),
        *(part for flight in made.flights for part in _air(made, flight)),
        *_baseline(made),
        *histories_overlaid(made),
        *(part for place, point in enumerate(made.points) for part in _point(made, place, point)),
        '<p class="note">Estimate ± 2 standard errors, per radian, rates normalised with q c/2V. Change against the '
        "baseline in per cent with its 95 % interval, which holds the baseline's own error and the scatter between its "
        "points; mass and inertia of the profile are in both and in neither's error. Bold: recommended. –: not "
        "estimated.</p>",
    ]
    return write_page(f"Test points: {made.aircraft.name}", body, folder / FILE_NAME)


def answer(made: Programme) -> str:
    """One sentence to quote: what has changed where, where nothing significant has, and what could not be used."""
    changed, same, unused = [], [], []
    for place, p in enumerate(made.points):
        if p.title in made.baseline.points:
            continue
        words = ", ".join(significant(made.change(place)))
        if words:
            changed.append((_stands_out(made.change(place)), f"{p.name}: {words}"))
        elif not any(c.is_known for c in made.change(place).values()):
            unused.append(p.name)
        else:
            same.append(p.name)
    count = len(made.baseline.points)
    against = f"the baseline of {count} point{'s' * (count > 1)}" if count else "the profile (no baseline flown)"
    more = len(changed) - QUOTED
    least = sorted((size for size, _ in changed), reverse=True)[:QUOTED]
    said = "; ".join(words for size, words in changed if size >= least[-1])
    said += f"; and {more} more in the table" if more > 0 else ""
    clauses = [f"{made.aircraft.name}, changed against {against}: {said or 'nothing significant'} (95 %)"]
    if same:
        clauses.append(f"no significant change: {', '.join(same)}")
    if unused:
        clauses.append(f"no change could be told: {', '.join(unused)}")
    return "; ".join(clauses) + "."


def _stands_out(changes: Mapping[str, Change]) -> float:
    """The largest change, over its interval."""
    return max(abs(c.estimate) / (c.high - c.low) for c in changes.values() if c.is_significant)


def _points(made: Programme) -> str:
    rows = []
    for place, p in enumerate(made.points):
        gust = f"{p.gust_sd:.3f}" if math.isfinite(p.gust_sd) else "–"
        of = "baseline" if p.title in made.baseline.points else ""
        found = "" if of else "; ".join(significant(made.change(place)))
        words = of or ("see below" if found else p.why or "nothing significant")
        drag = drag_words(p) if p.drag is not None else "–"
        cells = (p.name, p.condition, f"{p.start_s:.0f}–{p.end_s:.0f}", len(p.inputs), p.turbulence, gust, drag)
        left = "".join(f"<td>{text(c)}</td>" for c in cells)
        rows.append(f"<tr>{left}<td>{text(recommended(p) or '–')}</td><td class='words'>{text(words)}</td></tr>")
        if found:  # in a line of its own: a column would be as narrow as what the others leave
            like = made.likeness(place)
            said = text(f"{found}: {like}" if like else found)
            rows.append(f"<tr><td></td><td class='words' colspan='{len(COLUMNS) - 1}'>{said}</td></tr>")
    head = "".join(f"<th>{h}</th>" for h in COLUMNS)
    return f"<table><tr>{head}</tr>{''.join(rows)}</table><p class='note'>w 2–7 Hz: {W_BAND}.</p>"


def _air(made: Programme, flight: Flight) -> Iterator[str]:
    """Figure 40."""
    yield f"<h2>Turbulence over the flight: {text(flight.path.name)}</h2>"
    air = air_of(flight, made.aircraft)
    if isinstance(air, str):
        yield f'<p class="note">{text(air)}</p>'
        return
    figure = Figure(figsize=(10, 5.2), layout="constrained", dpi=120)
    gust, level, inputs = figure.subplots(3, 1, sharex=True, height_ratios=[2, 2, 1])
    step = max(1, len(air.t_s) // DRAWN)
    gust.plot(air.t_s[::step], air.gust[::step], color=INK, lw=0.6)
    gust.set_ylabel("vertical gust, m/s")
    level.plot(air.t_s[::step], air.level[::step], color=BLUE, lw=1.0)
    for name, limit in zip(("light", "moderate", "severe"), air.limits, strict=True):
        if limit < 1.5 * np.nanmax(air.level) or name == "light":
            level.axhline(limit, color=FAINT, lw=0.8)
            level.annotate(f"{name} above", (air.t_s[0], limit), fontsize=8, va="bottom", color="#5a6270")
    level.set_ylabel("sd in 2–7 Hz, m/s")
    inputs.plot(air.t_s[::step], np.degrees(air.elevator[::step]), color=INK, lw=0.8)
    inputs.set_ylabel("elevator, deg")
    inputs.set_xlabel("time, s", loc="right")
    for p in (p for p in made.points if p.log == str(flight.path)):
        for panel in (gust, level, inputs):
            panel.axvspan(p.start_s, p.end_s, color=GREEN if p.title in made.baseline.points else ORANGE, alpha=0.08)
        gust.annotate(p.name, (p.start_s, 1.0), xycoords=("data", "axes fraction"), fontsize=8, va="top")
        for one in p.inputs:
            inputs.axvspan(one.start_s, one.end_s, color=ORANGE, alpha=0.35, lw=0)
    for panel in (gust, level, inputs):
        without_frame(panel, "top", "right")
        panel.tick_params(labelsize=8)
    yield image(figure, "Vertical gust, its level in 2 to 7 Hz and the elevator over the flight, test points marked")
    yield '<p class="note">Shaded: test points, the baseline\'s green; below, the inputs that were found in them.</p>'
    yield from spectra_pages(air.record, f"Spectra of the vane over the flight: {flight.path.name}")


def _baseline(made: Programme) -> Iterator[str]:
    """Table 7."""
    baseline = made.baseline
    yield "<h2>Baseline</h2>"
    drag = [] if baseline.drag is None else [baseline.drag]
    head = "".join(f"<th>{n}</th>" for n in (*LONGITUDINAL, *("CD_0" for _ in drag)))
    rows = []
    for definition, called in ((OWN, "own"), (CALM, "quasi-steady")):
        values = baseline.values.get(definition, {})
        if not values:
            continue
        for p in (p for p in made.points if p.title in baseline.points):
            found = estimates(p, recommended(p) or "").get(definition, {})
            cells = "".join(f"<td>{_estimate(found, n)}</td>" for n in LONGITUDINAL)
            cells += "".join(f"<td>{drag_words(p)}</td>" for _ in drag)
            rows.append(f"<tr><td class='words'>{text(p.title)}, {called}</td>{cells}</tr>")
        shown = [*(values.get(n) for n in LONGITUDINAL), *drag]
        cells = "".join(f"<td>{_pooled(p)}</td>" for p in shown)
        rows.append(f"<tr class='chosen'><td>pooled, {called}</td>{cells}</tr>")
        cells = "".join(f"<td>{_scatter(p)}</td>" for p in shown)
        rows.append(f"<tr class='faint'><td>scatter between points</td>{cells}</tr>")
    yield f'<div class="wide"><table><tr><th></th>{head}</tr>{"".join(rows)}</table></div>'
    if baseline.points:
        yield (
            f'<p class="note">By {text(baseline.method)}; pooled by random effects (restricted maximum '
            "likelihood), the interval Hartung and Knapp's, 95 %.</p>"
        )


def _point(made: Programme, place: int, point: FlownPoint) -> Iterator[str]:
    """Figure and table of one point: every method."""
    yield f"<h2>{text(point.title)}</h2>"
    if point.methods is None:
        yield f"<p>{text(point.why)}</p>"
        return
    yield f"<p>Air during the input: {text(point.turbulence)}. Recommended: {text(recommended(point) or 'none')}.</p>"
    yield _figure(made, point)
    yield (
        '<p class="note">With two standard errors; green: the baseline\'s points. Filled: quasi-steady, what the '
        "manoeuvre gives in calm air; hollow: the aircraft's own derivatives, unsteady lift apart.</p>"
    )
    best = recommended(point)
    rows, refused = [], []
    for name, result in point.methods.items():
        if result.status != "ok":
            refused.append(f"<li>{text(name)}: {text(result.why)}</li>")
            continue
        found = compared(point, name, made.baseline)
        changes = made.changes[place][name]
        cells = "".join(f"<td>{_estimate(found, n)}<br>{_change(changes.get(n))}</td>" for n in LONGITUDINAL)
        chosen = ' class="chosen"' if name == best else ""
        rows.append(f"<tr{chosen}><td>{text(name)}</td>{cells}</tr>")
    head = "".join(f"<th>{n}</th>" for n in LONGITUDINAL)
    yield f'<div class="wide"><table><tr><th>method</th>{head}</tr>{"".join(rows)}</table></div>'
    if refused:
        yield f"<p class='note'>Not applicable:</p><ul class='note'>{''.join(refused)}</ul>"


def _figure(made: Programme, point: FlownPoint) -> str:
    """One panel a derivative: every method with two standard errors, the baseline's points in green beside."""
    methods = {m: r for m, r in (point.methods or {}).items() if r.status == "ok"}
    others = [p for p in made.points if p.title in made.baseline.points and p is not point]
    figure = Figure(figsize=(10, 5.6), layout="constrained", dpi=120)
    for panel, name in zip(figure.subplots(2, 3).flat, LONGITUDINAL, strict=True):
        spread = []
        for x, p in enumerate(others):
            spread += _drawn(panel, x, estimates(p, recommended(p) or ""), name, "s", GREEN)
        for x, method in enumerate(methods, len(others)):
            colour = BLUE if method == recommended(point) else INK
            spread += _drawn(panel, x, estimates(point, method), name, "o", colour)
        labels = [p.name for p in others] + list(methods)
        panel.set_xticks(range(len(labels)), labels, rotation=60, ha="right", fontsize=8)
        panel.set_xlim(-0.5, len(labels) - 0.5)
        panel.set_title(name, fontsize=10, loc="left")
        panel.tick_params(labelsize=8, length=2)
        if not spread:
            panel.annotate("not estimated", (0.5, 0.5), xycoords="axes fraction", ha="center", color="#5a6270")
        without_frame(panel, "top", "right")
        panel.grid(axis="y", color="#eceef2")
    return image(figure, f"Derivatives of {point.title} by method beside the baseline, with two standard errors")


def _drawn(
    panel: Panel, x: int, found: Mapping[str, Mapping[str, ParamEstimate]], name: str, mark: str, colour: str
) -> list[float]:
    """One estimate of each definition, the aircraft's own ones hollow; what was drawn."""
    drawn = []
    for definition, fill, at in ((CALM, colour, x), (OWN, "white", x + (0.25 if CALM in found else 0.0))):
        p = found.get(definition, {}).get(name)
        if p is not None and p.status is Status.ESTIMATED:
            panel.errorbar(at, p.value, yerr=2 * p.sd, fmt=mark, color=colour, mfc=fill, ms=4, lw=1)
            drawn.append(p.value)
    return drawn


def _estimate(found: Mapping[str, ParamEstimate], name: str) -> str:
    p = found.get(name)
    return "–" if p is None or p.status is not Status.ESTIMATED else rounded(p.value, 2 * p.sd)


def _change(change: Change | None) -> str:
    if change is None or not change.is_known:
        return f'<span class="faint" title="{text(change.why if change else "")}">–</span>'
    words = f"{change.estimate:+.1f} ± {0.5 * (change.high - change.low):.1f} %"
    return words if change.is_significant else f'<span class="faint">{words}</span>'


def _pooled(p: Pooled | None) -> str:
    return "–" if p is None else rounded(p.value, p.widening * p.error)


def _scatter(p: Pooled | None) -> str:
    return "–" if p is None or not math.isfinite(p.between) else f"{100 * p.between / abs(p.value):.1f} %"
