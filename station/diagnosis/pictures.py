"""Pictures of a diagnosis: spectra, errors of each manoeuvre, series over time, and what each effect would explain."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullFormatter, NullLocator
from numpy.typing import NDArray

from station.diagnosis.likelihood import Problem
from station.diagnosis.manoeuvre import Manoeuvre
from station.diagnosis.procedure import Diagnosis
from station.diagnosis.processing import HIGH_HZ, back, transform, without_line
from station.diagnosis.refits import ASKED
from station.diagnosis.reported import alone
from station.diagnosis.residuals import SERIES, series
from station.diagnosis.series_spectra import Spectra
from station.identification.html_page import BLUE, FAINT, INK, ORANGE
from station.profile import Aircraft

Array = NDArray[np.float64]

_ABREAST: Final = 6
"""Manoeuvres beside each other in a picture."""
_YELLOW: Final = "#e69f00"
BEFORE, AFTER, FITTED = "before", "after", "as fitted"
_COLOURS: Final = {"measured": INK, BEFORE: BLUE, AFTER: ORANGE, FITTED: ORANGE}
MEANING: Final = {
    "theta": ("attitude minus integral of pitch rate", "deg", "deg"),
    "v_down": ("sink rate minus integral of accelerations", "m/s", "m/s"),
    "v_north": ("ground speed minus integral of accelerations", "m/s", "m/s"),
    "alpha_vane": ("vane minus inertial flow angle: the gust", "deg", "deg"),
    "lift": ("lift coefficient minus model", "1", ""),
    "moment": ("pitching-moment coefficient minus model", "1", ""),
    "drag": ("drag coefficient minus model", "1", ""),
    "bank": ("bank minus integral of rates", "deg", "deg"),
    "heading": ("heading minus integral of rates", "deg", "deg"),
    "v_across": ("speed across the heading minus integral of accelerations", "m/s", "m/s"),
    "beta_vane": ("vane minus inertial sideslip: the side gust", "deg", "deg"),
    "side_force": ("side-force coefficient minus model", "1", ""),
    "roll": ("rolling-moment coefficient minus model", "1", ""),
    "yaw": ("yawing-moment coefficient minus model", "1", ""),
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


@dataclass(frozen=True, slots=True)
class Compared:
    """One manoeuvre beside what noise, gust and what the model misses make of its series."""

    manoeuvre: Manoeuvre
    use: str
    aircraft: Mapping[str, Aircraft]
    """By label: before and after, or one where nothing was changed."""
    spectra: Mapping[str, Spectra]
    expected: Array
    """(bins, series judged) variance."""

    @property
    def name(self) -> str:
        return self.manoeuvre.record.name

    @property
    def series(self) -> list[str]:
        """Those judged."""
        return [SERIES[j] for j in self.manoeuvre.setting.judged]

    def errors(self, label: str) -> dict[str, float]:
        """Root mean square of each series over what is expected."""
        rms = np.sqrt((np.abs(self.spectra[label].bins.T) ** 2 / self.expected).mean(0))
        return dict(zip(self.series, rms.tolist(), strict=True))

    def changed(self) -> dict[str, float]:
        """By how much the square of each error changes; where nothing was changed, that square."""
        first, *others = (self.errors(label) for label in self.spectra)
        return {n: abs(x**2 - sum(o[n] ** 2 for o in others)) for n, x in first.items()}


def compared(found: Diagnosis) -> list[Compared]:
    """Every manoeuvre, those held out after the others."""
    crafts = {BEFORE: found.before, AFTER: found.after} if found.effects else {FITTED: found.after}
    fitted = found.problem.manoeuvres
    state = found.found.accepted.state
    uses = [(m, "fitted", state.levels.of(k)) for k, m in enumerate(fitted)]
    if found.held_out:
        # Another day: its noise and gust are its own.
        kept = Problem(found.held_out, found.after, [])
        own = kept.relevelled(kept.state({}, kept.of_profile)).levels
        uses += [(m, "held out", own.of(k)) for k, m in enumerate(found.held_out)]
    made = []
    for m, use, levels in uses:
        expected = (np.abs(m.columns(m.responses(found.after))) ** 2 * levels).sum(-1)
        spectra = {label: m.differences(craft) for label, craft in crafts.items()}
        made.append(Compared(m, use, crafts, spectra, expected))
    return made


def _most_changed(shown: Sequence[Compared]) -> Compared:
    """The manoeuvre that the accepted effects change most, held-out ones first if there are any."""
    pool = [c for c in shown if c.use == "held out"] or shown
    return max(pool, key=lambda c: sum(c.changed().values()))


def _scale(name: str) -> float:
    return math.degrees(1) if MEANING[name][1] == "deg" else 1.0


def spectra_before_and_after(shown: Sequence[Compared]) -> Figure:
    c = _most_changed(shown)
    names = c.series
    rows = math.ceil(len(names) / 2)
    figure = _figure(0.4 + 2.1 * rows, f"{c.name}, {c.use}: amplitude against frequency")
    grid = figure.subplots(rows, 2, squeeze=False, gridspec_kw=_space(figure, rows, 2))
    f = c.manoeuvre.setting.frequencies
    for k, name in enumerate(names):
        axes = grid.flat[k]
        unit = _scale(name)
        level = np.sqrt(c.expected[:, k]) * unit
        axes.fill_between(f, 0.22 * level, 1.73 * level, color=FAINT, alpha=0.45, lw=0, label="expected, 90 %")
        axes.set_xscale("log")
        axes.set_yscale("log")
        for label, own in c.spectra.items():
            axes.plot(f, np.abs(own.bins[k]) * unit, color=_COLOURS[label], lw=1, label=label)
        axes.set_title(f"{name} [{MEANING[name][2] or '1'}]", fontsize=9, loc="left")
        axes.xaxis.set_major_locator(FixedLocator([0.1, 0.2, 0.5, 1, 2, 3]))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.tick_params(labelsize=8)
        if k >= len(names) - 2:
            axes.set_xlabel("Hz", fontsize=8)
    for axes in grid.flat[len(names) :]:
        axes.set_axis_off()
    figure.legend(*grid.flat[0].get_legend_handles_labels(), fontsize=8, frameon=False, ncols=3, loc="upper right")
    return figure


def by_record(shown: Sequence[Compared]) -> Figure:
    """Error of each manoeuvre, fitted and held out, before and after, by series."""
    across = min(len(shown), _ABREAST)
    rows = math.ceil(len(shown) / across)
    figure = _figure(2.2 * rows + 0.3)
    space = _space(figure, rows, across, top=0.6, bottom=0.75, across=0.15, down=1.0)
    grid = figure.subplots(rows, across, sharey=True, squeeze=False, gridspec_kw=space)
    for axes, c in zip(grid.flat, shown, strict=False):
        at = np.arange(len(c.series))
        wide = 0.8 / len(c.spectra)
        for i, label in enumerate(c.spectra):
            place = at + wide * (i - 0.5 * (len(c.spectra) - 1))
            axes.bar(place, list(c.errors(label).values()), wide, color=_COLOURS[label], label=label)
        axes.set_xticks(at, c.series, rotation=40, ha="right", fontsize=7)
        axes.set_title(f"{c.name}\n{c.use}", fontsize=8, loc="left")
        axes.tick_params(axis="y", labelsize=8)
        axes.axhline(1.0, color=INK, lw=0.8, ls=":")
    for axes in grid.flat[len(shown) :]:
        axes.set_axis_off()
    for axes in grid[:, 0]:
        axes.set_ylabel("error over expected", fontsize=8)
    figure.legend(*grid.flat[0].get_legend_handles_labels(), fontsize=8, frameon=False, ncols=2, loc="upper right")
    return figure


def series_in_time(
    shown: Sequence[Compared], count: int | None = None
) -> tuple[str, dict[str, dict[str, tuple[Array, Array]]]]:
    """The manoeuvre that changes most, and over its time (s) the elevator and each series, most changed first, before
    and after; by plot and line."""
    c = _most_changed(shown)
    record, s = c.manoeuvre.record, c.manoeuvre.setting
    changed = c.changed()
    names = sorted(changed, key=lambda n: -changed[n])[:count]
    t: Array = record.start_s + record.dt * np.arange(record.n, dtype=np.float64)
    inside = slice(s.cut, s.n - s.cut)
    plots: dict[str, dict[str, tuple[Array, Array]]] = {
        "elevator, deg": {"measured": (t, np.degrees(record.signals["elevator"]))}
    }
    told = {label: _series_of(c.manoeuvre, craft) for label, craft in c.aircraft.items()}
    for name in names:
        j = SERIES.index(name)
        lines = plots.setdefault(f"{name}, {MEANING[name][2] or '1'}", {})
        for label, x in told.items():
            lines[label] = (t[inside], x[j, inside] * _scale(name))
    return c.name, plots


def times(shown: Sequence[Compared]) -> Figure:
    title, plots = series_in_time(shown, 3)
    figure = _figure(1.6 + 1.9 * (len(plots) - 1), title)
    grid = figure.subplots(len(plots), 1, sharex=True, gridspec_kw=_space(figure, len(plots), down=0.3))
    for axes, (name, lines) in zip(grid, plots.items(), strict=True):
        for label, (t, y) in lines.items():
            axes.plot(t, y, color=_COLOURS[label], lw=1, label=label)
        axes.set_ylabel(name, fontsize=8)
        meaning = MEANING.get(name.partition(",")[0])
        if meaning is not None:
            axes.set_title(meaning[0], fontsize=8, loc="left")
        axes.tick_params(labelsize=8)
        axes.axhline(0, color=FAINT, lw=0.5)
    figure.legend(*grid[-1].get_legend_handles_labels(), fontsize=8, frameon=False, ncols=2, loc="upper right")
    grid[-1].set_xlabel("s", fontsize=8)
    return figure


def _series_of(m: Manoeuvre, aircraft: Aircraft) -> Array:
    """The series (7, n), measured less that aircraft's, without line and above HIGH_HZ."""
    return _smooth(series(m.record.signals, m.loaded(aircraft), m.setting), m)


def _smooth(x: Array, m: Manoeuvre) -> Array:
    s = m.setting
    inside = slice(s.cut, s.n - s.cut)
    out = back(transform(x, s) * (s.omega < 2 * np.pi * HIGH_HZ), s)
    out[..., inside] = without_line(out[..., inside])
    return out


def _with_constant_forces(aircraft: Aircraft) -> Aircraft:
    """An aircraft whose forces do not change: the residual against it is all of what was measured."""
    still = aircraft.unsteady.model_copy(update={"memory": False})
    return aircraft.model_copy(update={"derivatives": {}, "drag": None, "unsteady": still})


_SIGNAL_OF: Final = {"theta": "theta", "v_down": "v_down", "v_north": "v_along", "alpha_vane": "alpha_vane"}
_ZOOM_S: Final = 8.0
"""Time about the largest change, for the picture of measured and predicted."""


def measured_and_predicted(shown: Sequence[Compared]) -> Figure:
    """The series that change most, measured and predicted, about the moment at which they change most."""
    c = _most_changed(shown)
    m, changed = c.manoeuvre, c.changed()
    s, record = m.setting, m.record
    names = sorted(changed, key=lambda n: -changed[n])[:3]
    t = record.start_s + record.dt * np.arange(record.n, dtype=np.float64)
    # Against an aircraft whose forces do not change, the residual is all of what was measured; instruments are their
    # own.
    first = next(iter(c.aircraft.values()))
    whole = _series_of(m, _with_constant_forces(first))
    for name, signal in _SIGNAL_OF.items():
        if signal in record.signals:
            whole[SERIES.index(name)] = _smooth(record.signals[signal], m)
    lines = {label: whole - _series_of(m, craft) for label, craft in c.aircraft.items()}
    inside = np.arange(s.cut, s.n - s.cut)
    j = SERIES.index(names[0])
    # The mean over a second: one instant's noise is no change.
    width = max(1, round(1.0 / record.dt))
    one, other = (whole, *lines.values())[-2:]
    change = np.convolve((one - other)[j, inside] ** 2, np.ones(width), "same")
    middle = t[inside[int(np.argmax(change))]]
    start = min(max(middle - 0.5 * _ZOOM_S, t[inside[0]]), max(t[inside[-1]] - _ZOOM_S, t[inside[0]]))
    at = inside[(t[inside] >= start) & (t[inside] <= start + _ZOOM_S)]
    figure = _figure(0.5 + 1.8 * len(names), f"{c.name}, {c.use}: measured and predicted")
    space = _space(figure, len(names), down=0.3)
    grid = figure.subplots(len(names), 1, sharex=True, squeeze=False, gridspec_kw=space)[:, 0]
    for axes, name in zip(grid, names, strict=True):
        j = SERIES.index(name)
        axes.plot(t[at], whole[j, at] * _scale(name), color=INK, lw=1.6, label="measured")
        for label, line in lines.items():
            axes.plot(t[at], line[j, at] * _scale(name), color=_COLOURS[label], lw=1, label=label)
        axes.set_title(_MEASURED[name], fontsize=8, loc="left")
        axes.set_ylabel(f"{name}, {MEANING[name][2] or '1'}", fontsize=8)
        axes.tick_params(labelsize=8)
    figure.legend(*grid[0].get_legend_handles_labels(), fontsize=8, frameon=False, ncols=3, loc="upper right")
    grid[-1].set_xlabel("s", fontsize=8)
    return figure


def reductions(found: Diagnosis) -> Figure:
    """What each effect alone would explain, the most first."""
    first = alone(found)[:14]
    names = [x.id for x in first]
    alternatives = {x for e in found.effects for x in e.alternatives}
    named = {e.term.id for e in found.effects}
    colours = [ORANGE if n in named else _YELLOW if n in alternatives else FAINT for n in names]
    figure = _figure(0.8 + 0.24 * len(names))
    axes = figure.subplots(gridspec_kw=_space(figure, top=0.1, left=1.9))
    axes.barh(names[::-1], [max(x.reduction, 0.05) for x in first[::-1]], color=colours[::-1])
    axes.axvline(ASKED, color=INK, lw=0.8, ls=":")
    axes.set_xscale("log")
    axes.set_xlabel(
        "deviance reduction, alone (dotted: asked of an effect; orange: named; yellow: confounded)", fontsize=8
    )
    axes.tick_params(labelsize=8)
    return figure
