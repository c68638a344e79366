"""The page of where the extended model holds: maps of its misfit, and its course over time."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.axes import Axes as Panel
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from scipy.spatial import ConvexHull, QhullError

from station.conventions import from_si
from station.diagnosis.model_validity import AXES, LEAST_S, MAPS, SERIES, Validity, validity_lines
from station.identification.html_page import BLUE, FAINT, INK, ORANGE, image, text

_NAMES: Final = {"alpha": "angle of attack, deg", "airspeed": "airspeed, m/s", "elevator": "elevator, deg"}
_WORST: Final = 4.0
"""Misfit from which boxes are equally dark."""
_DARK: Final = 3.0
"""Misfit from which a number stands out in white."""
_SMOOTH_S: Final = 1.0
"""Of the misfit's root mean square over time."""


def validity_page(v: Validity) -> list[str]:
    """Lines, maps and courses."""
    lines = "".join(f"<li>{text(x[:1].upper() + x[1:])}.</li>" for x in validity_lines(v))
    return [
        "<h2>Where the model holds</h2>",
        f"<ul>{lines}</ul>",
        image(maps(v), "misfit of lift and moment over angle of attack, speed and elevator"),
        image(courses(v), "misfit of lift and moment over time"),
        '<p class="note">Misfit: root mean square of the residual over what noise and gusts let expect; 1 where the '
        "extended model holds. Framed boxes fail (0.1 % for all boxes together); boxes flown for less than "
        f"{LEAST_S:g} s are blank. The line is the envelope flown: nothing is extrapolated beyond it.</p>",
    ]


def maps(v: Validity) -> Figure:
    """A row a series, a column a map."""
    figure = Figure(figsize=(10, 6.4), dpi=90)
    grid = figure.subplots(len(SERIES), len(MAPS))
    figure.subplots_adjust(left=0.07, right=0.9, bottom=0.08, top=0.95, wspace=0.2, hspace=0.3)
    norm = TwoSlopeNorm(1.0, 0.0, _WORST)
    for row, series in zip(grid, SERIES, strict=True):
        for panel, axes in zip(row, MAPS, strict=True):
            _map(panel, v, series, axes, norm)
    bar = figure.add_axes((0.925, 0.25, 0.015, 0.5))
    shades = np.linspace(0, _WORST, 100)[:, None]
    bar.imshow(shades, aspect="auto", origin="lower", extent=(0, 1, 0, _WORST), cmap="RdBu_r", norm=norm)
    bar.set_xticks([])
    bar.set_title("misfit", fontsize=8)
    bar.tick_params(labelsize=8)
    return figure


def _map(panel: Panel, v: Validity, series: str, axes: tuple[str, str], norm: TwoSlopeNorm) -> None:
    scale = [from_si(1.0, AXES[a]) for a in axes]
    x, y = (np.concatenate([k * getattr(m, a) for m in v.misfits]) for k, a in zip(scale, axes, strict=True))
    panel.plot(x[::5], y[::5], ".", ms=0.6, color=FAINT, zorder=2, rasterized=True)
    own = [b for b in v.boxes if b.series == series and b.axes == axes]
    for b in sorted(own, key=lambda b: b.fails):
        corner = scale[0] * b.first[0], scale[1] * b.second[0]
        wide, high = scale[0] * (b.first[1] - b.first[0]), scale[1] * (b.second[1] - b.second[0])
        edge, width = (INK, 1.4) if b.fails else ("white", 0.5)
        colour = _colour(norm, b.rms)
        panel.add_patch(Rectangle(corner, wide, high, facecolor=colour, edgecolor=edge, lw=width, zorder=1 + b.fails))
        middle = corner[0] + 0.5 * wide, corner[1] + 0.5 * high
        panel.text(
            *middle,
            f"{b.rms:.1f}",
            fontsize=6.5,
            ha="center",
            va="center",
            color="white" if b.rms > _DARK else INK,
            zorder=4,
        )
    points = np.column_stack([x, y])
    try:
        around = points[ConvexHull(points).vertices]
        panel.plot(*np.vstack([around, around[:1]]).T, color=BLUE, lw=1.0, zorder=3)
    except QhullError:
        pass  # one of them did not move: there is no area to go around
    panel.set_xlabel(_NAMES[axes[0]], fontsize=8)
    panel.set_ylabel(_NAMES[axes[1]], fontsize=8)
    panel.set_title(series, fontsize=9, loc="left")
    _plain(panel)


def _colour(norm: TwoSlopeNorm, rms: float) -> tuple[float, ...]:
    from matplotlib import colormaps

    return tuple(colormaps["RdBu_r"](norm(min(rms, _WORST))))


def courses(v: Validity) -> Figure:
    """The misfit over time, a panel a manoeuvre."""
    n = len(v.misfits)
    figure = Figure(figsize=(10, 1.3 * n + 0.7), dpi=90)
    panels = figure.subplots(n, 1, squeeze=False)[:, 0]
    high = 1.3 * n + 0.7
    figure.subplots_adjust(left=0.07, right=0.99, bottom=0.45 / high, top=1 - 0.25 / high, hspace=0.55)
    for panel, m in zip(panels, v.misfits, strict=True):
        window = max(1, round(_SMOOTH_S / m.dt))
        t = m.start + m.dt * np.arange(len(m.alpha))
        for series, colour in zip(SERIES, (BLUE, ORANGE), strict=True):
            running = np.sqrt(np.convolve(getattr(m, series) ** 2, np.full(window, 1 / window), mode="same"))
            panel.plot(t, running, color=colour, lw=1.0, label=series)
        panel.axhline(1.0, color=FAINT, lw=0.8)
        panel.set_xlim(t[0], t[-1])
        panel.set_ylim(bottom=0)
        panel.set_ylabel("misfit", fontsize=8)
        panel.set_title(m.record, fontsize=8, loc="left")
        _plain(panel)
    panels[0].legend(fontsize=7, frameon=False, ncols=2, loc="upper right")
    panels[-1].set_xlabel("s of the manoeuvre", fontsize=8, loc="right")
    return figure


def _plain(panel: Panel) -> None:
    panel.tick_params(labelsize=8, length=2)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
