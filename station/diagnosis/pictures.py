"""Pictures of a diagnosis: spectra, errors of each manoeuvre, series over time, and what each effect would explain."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator
from numpy.typing import NDArray

from station.diagnosis import judge
from station.diagnosis.model_error import with_constant_forces
from station.diagnosis.procedure import Diagnosis
from station.diagnosis.processing import HIGH_HZ, back, transform, without_line
from station.diagnosis.reference import Reference, loaded
from station.diagnosis.residuals import SERIES, series
from station.diagnosis.search import FIRST
from station.identification.html_page import BLUE, FAINT, INK, ORANGE
from station.profile import Aircraft

Array = NDArray[np.float64]

_YELLOW: Final = "#e69f00"
MEANING: Final = {
    "theta": ("attitude minus integral of pitch rate", "deg", "deg"),
    "v_down": ("sink rate minus integral of accelerations", "m/s", "m/s"),
    "v_north": ("ground speed minus integral of accelerations", "m/s", "m/s"),
    "alpha_vane": ("vane minus inertial flow angle: the gust", "deg", "deg"),
    "lift": ("lift coefficient minus model", "1", ""),
    "moment": ("pitching-moment coefficient minus model", "1", ""),
    "drag": ("drag coefficient minus model", "1", ""),
}
_MEASURED: Final = {
    "theta": "attitude, and integral of pitch rate",
    "v_down": "sink rate, and integral of accelerations",
    "v_north": "ground speed, and integral of accelerations",
    "alpha_vane": "vane, and the inertial flow angle there: the difference is the gust",
    "lift": "lift coefficient, and that of the model in the measured motion and gust",
    "moment": "pitching-moment coefficient, and that of the model in the measured motion and gust",
    "drag": "drag coefficient, and that of the model in the measured motion and gust",
}


def _figure(height: float, title: str = "") -> Figure:
    """A figure as wide as the page, in inches."""
    figure = Figure(figsize=(10, height), dpi=90)
    if title:
        figure.suptitle(title, x=0.01, y=1 - 0.08 / height, ha="left", va="top", fontsize=10)
    return figure


def _space(
    figure: Figure, rows: int = 1, columns: int = 1, top: float = 0.55, bottom: float = 0.5, left: float = 0.75,
    down: float = 0.5, across: float = 0.6,
) -> dict[str, float]:  # fmt: skip
    """Margins and gaps of axes, given in inches: laying them out by their labels takes longer than drawing them."""
    width, height = figure.get_size_inches()
    wide = (width - left - 0.15 - (columns - 1) * across) / columns
    high = (height - top - bottom - (rows - 1) * down) / rows
    return {
        "left": left / width, "right": 1 - 0.15 / width, "bottom": bottom / height, "top": 1 - top / height,
        "wspace": across / wide, "hspace": down / high,
    }  # fmt: skip


def _most_changed(found: Diagnosis, before: Aircraft, after: Aircraft) -> Reference:
    """The manoeuvre that the accepted effects change most, held-out ones first if there are any."""
    pool = found.held_out or found.problem.references

    def change(r: Reference) -> float:
        one, other = judge.channel_error(r, before), judge.channel_error(r, after)
        return sum(abs(one[n] ** 2 - other[n] ** 2) for n in one)

    return max(pool, key=change)


def _scale(name: str) -> float:
    return math.degrees(1) if MEANING[name][1] == "deg" else 1.0


def spectra_before_and_after(found: Diagnosis, before: Aircraft, after: Aircraft) -> Figure:
    r = _most_changed(found, before, after)
    names = [SERIES[j] for j in r.setting.judged]
    rows = math.ceil(len(names) / 2)
    figure = _figure(0.4 + 2.1 * rows, f"{r.record.name}: amplitude against frequency")
    grid = figure.subplots(rows, 2, squeeze=False, gridspec_kw=_space(figure, rows, 2))
    f = r.setting.frequencies
    one, other = r.differences(before), r.differences(after)
    variance = _expected(found, r)
    for k, name in enumerate(names):
        axes = grid.flat[k]
        unit = _scale(name)
        level = np.sqrt(variance[:, k]) * unit
        axes.fill_between(f, 0.22 * level, 1.73 * level, color=FAINT, alpha=0.45, lw=0, label="expected, 90 %")
        axes.loglog(f, np.abs(one.bins[k]) * unit, color=BLUE, lw=1, label="before")
        axes.loglog(f, np.abs(other.bins[k]) * unit, color=ORANGE, lw=1, label="after")
        axes.set_title(f"{name} [{MEANING[name][2] or '1'}]", fontsize=9, loc="left")
        axes.xaxis.set_major_locator(FixedLocator([0.1, 0.2, 0.5, 1, 2, 3]))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_locator(NullLocator())
        axes.tick_params(labelsize=8)
        if k >= len(names) - 2:
            axes.set_xlabel("Hz", fontsize=8)
    for axes in grid.flat[len(names) :]:
        axes.set_axis_off()
    figure.legend(*grid.flat[0].get_legend_handles_labels(), fontsize=8, frameon=False, ncols=3, loc="upper right")
    return figure


def by_record(found: Diagnosis, before: Aircraft, after: Aircraft) -> Figure:
    """Error of each manoeuvre, fitted and held out, before and after, by series."""
    records = [(r, "fitted") for r in found.problem.references] + [(r, "held out") for r in found.held_out]
    figure = _figure(2.5)
    space = _space(figure, 1, len(records), top=0.25, bottom=0.75, across=0.15)
    grid = figure.subplots(1, len(records), sharey=True, squeeze=False, gridspec_kw=space)[0]
    for axes, (r, use) in zip(grid, records, strict=True):
        one, other = _over_expected(found, r, before), _over_expected(found, r, after)
        at = np.arange(len(one))
        axes.bar(at - 0.2, list(one.values()), 0.4, color=BLUE, label="before")
        axes.bar(at + 0.2, list(other.values()), 0.4, color=ORANGE, label="after")
        axes.set_xticks(at, list(one), rotation=40, ha="right", fontsize=7)
        axes.set_title(f"{r.record.name}, {use}", fontsize=8, loc="left")
        axes.tick_params(axis="y", labelsize=8)
        axes.axhline(1.0, color=INK, lw=0.8, ls=":")
    grid[0].set_ylabel("error over noise and gust", fontsize=8)
    grid[0].legend(fontsize=7, frameon=False)
    grid[0].set_ylim(0, 1.15 * grid[0].get_ylim()[1])
    return figure


def _expected(found: Diagnosis, r: Reference) -> Array:
    """(m, k) variance of each series judged by noise and gust, per frequency."""
    inverse = np.linalg.inv(r.bins.rotate)
    gust = max(found.found.accepted.gust) if r in found.held_out else _gust_of(found, r)
    scale = 1 + gust**2 * r.bins.turbulent
    return np.asarray(np.einsum("mij,mj,mij->mi", inverse, scale, np.conj(inverse)).real)


def _over_expected(found: Diagnosis, r: Reference, aircraft: Aircraft) -> dict[str, float]:
    """Root mean square of each series over what noise and gust make."""
    power = np.abs(r.differences(aircraft).bins.T) ** 2 / _expected(found, r)
    return {SERIES[j]: float(np.sqrt(power[:, k].mean())) for k, j in enumerate(r.setting.judged)}


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
    reported = {"before": _series_of(r, before), "after": _series_of(r, after)}
    for name in names:
        j = SERIES.index(name)
        lines = plots.setdefault(f"{name}, {MEANING[name][2] or '1'}", {})
        for label in reported:
            lines[label] = (t[inside], reported[label][j, inside] * _scale(name))
    return r.record.name, plots


def times(found: Diagnosis, before: Aircraft, after: Aircraft) -> Figure:
    title, plots = series_in_time(found, before, after, 3)
    figure = _figure(1.6 + 1.9 * (len(plots) - 1), title)
    grid = figure.subplots(len(plots), 1, sharex=True, gridspec_kw=_space(figure, len(plots), down=0.3))
    colours = {"measured": INK, "before": BLUE, "after": ORANGE}
    for axes, (name, lines) in zip(grid, plots.items(), strict=True):
        for label, (t, y) in lines.items():
            axes.plot(t, y, color=colours[label], lw=1, label=label)
        axes.set_ylabel(name, fontsize=8)
        meaning = MEANING.get(name.partition(",")[0])
        if meaning is not None:
            axes.set_title(meaning[0], fontsize=8, loc="left")
        axes.tick_params(labelsize=8)
        axes.axhline(0, color=FAINT, lw=0.5)
    figure.legend(*grid[-1].get_legend_handles_labels(), fontsize=8, frameon=False, ncols=2, loc="upper right")
    grid[-1].set_xlabel("s", fontsize=8)
    return figure


def _series_of(r: Reference, aircraft: Aircraft) -> Array:
    """The series (7, n), measured less that aircraft's, without line and above HIGH_HZ."""
    own, s = loaded(aircraft, r.record, r.mass_share, r.iyy_share), r.setting
    return _smooth(series(r.record.signals, own, s), r)


def _smooth(x: Array, r: Reference) -> Array:
    s = r.setting
    inside = slice(s.cut, s.n - s.cut)
    out = back(transform(x, s) * (s.omega < 2 * np.pi * HIGH_HZ), s)
    out[..., inside] = without_line(out[..., inside])
    return out


_SIGNAL_OF: Final = {"theta": "theta", "v_down": "v_down", "v_north": "v_along", "alpha_vane": "alpha_vane"}
_ZOOM_S: Final = 8.0
"""Time about the largest change, for the picture of measured and predicted."""


def measured_and_predicted(found: Diagnosis, before: Aircraft, after: Aircraft) -> Figure:
    """The series that change most, measured and predicted, about the moment at which they change most."""
    r = _most_changed(found, before, after)
    s = r.setting
    one, other = _over_expected(found, r, before), _over_expected(found, r, after)
    names = sorted(one, key=lambda n: -abs(one[n] - other[n]))[:3]
    t = r.record.start_s + r.record.dt * np.arange(r.record.n, dtype=np.float64)
    # Against an aircraft whose forces do not change, the residual is all of what was measured; instruments are their
    # own.
    whole = _series_of(r, with_constant_forces(before))
    for name, signal in _SIGNAL_OF.items():
        if signal in r.record.signals:
            whole[SERIES.index(name)] = _smooth(r.record.signals[signal], r)
    lines = {"before": whole - _series_of(r, before), "after": whole - _series_of(r, after)}
    inside = np.arange(s.cut, s.n - s.cut)
    j = SERIES.index(names[0])
    # The mean over a second: one instant's noise is no change.
    width = max(1, round(1.0 / r.record.dt))
    change = np.convolve((lines["before"] - lines["after"])[j, inside] ** 2, np.ones(width), "same")
    middle = t[inside[int(np.argmax(change))]]
    start = min(max(middle - 0.5 * _ZOOM_S, t[inside[0]]), max(t[inside[-1]] - _ZOOM_S, t[inside[0]]))
    shown = inside[(t[inside] >= start) & (t[inside] <= start + _ZOOM_S)]
    figure = _figure(0.5 + 1.8 * len(names), f"{r.record.name}: measured and predicted")
    space = _space(figure, len(names), down=0.3)
    grid = figure.subplots(len(names), 1, sharex=True, squeeze=False, gridspec_kw=space)[:, 0]
    for axes, name in zip(grid, names, strict=True):
        j = SERIES.index(name)
        axes.plot(t[shown], whole[j, shown] * _scale(name), color=INK, lw=1.6, label="measured")
        for label, colour in (("before", BLUE), ("after", ORANGE)):
            axes.plot(t[shown], lines[label][j, shown] * _scale(name), color=colour, lw=1, label=label)
        axes.set_title(_MEASURED[name], fontsize=8, loc="left")
        axes.set_ylabel(f"{name}, {MEANING[name][2] or '1'}", fontsize=8)
        axes.tick_params(labelsize=8)
    figure.legend(*grid[0].get_legend_handles_labels(), fontsize=8, frameon=False, ncols=3, loc="upper right")
    grid[-1].set_xlabel("s", fontsize=8)
    return figure


def reductions(found: Diagnosis) -> Figure:
    fits = [f for f in found.found.singles if math.isfinite(f.cost)][:14]
    names = [f.ids[0] for f in fits]
    reductions = [max(found.found.screened - f.cost, 0.05) for f in fits]
    alternatives = {x for e in found.effects for x in e.alternatives}
    accepted = {e.term.id for e in found.effects}
    colours = [ORANGE if n in accepted else _YELLOW if n in alternatives else FAINT for n in names]
    figure = _figure(0.8 + 0.24 * len(names))
    axes = figure.subplots(gridspec_kw=_space(figure, top=0.1, left=1.9))
    axes.barh(names[::-1], reductions[::-1], color=colours[::-1])
    axes.axvline(FIRST, color=INK, lw=0.8, ls=":")
    axes.set_xscale("log")
    axes.set_xlabel(
        "deviance reduction, alone (dotted: asked of a first effect; orange: accepted; yellow: confounded)", fontsize=8
    )
    axes.tick_params(labelsize=8)
    return figure
