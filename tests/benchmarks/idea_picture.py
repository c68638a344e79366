"""The README's diagram: when a gust meets vane, wing and tail of the Twin Otter at 110 kt. Run by hand.

uv run python tests/benchmarks/idea_picture.py .pictures/idea.png
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from station.conventions import to_si
from station.profile import load_aircraft

BLUE, ORANGE, GREEN, GREY = "#0072b2", "#d55e00", "#009e73", "#4a5160"


def silhouette(axes: Axes, vane: float, tail: float) -> None:
    """A side view: boom, fuselage, wing, tail; x is metres aft of the CG."""
    body = [(-3.5, 0.0), (-2.8, 0.7), (-1.4, 1.1), (2.0, 1.1), (tail + 0.8, 0.7), (tail + 0.8, 0.4), (2.0, -0.7)]
    axes.add_patch(Polygon([*body, (-2.0, -0.8), (-3.3, -0.4)], closed=True, fc="#e6e9ee", ec=GREY, lw=1.2))
    fin = [(tail - 0.9, 0.8), (tail - 0.1, 2.5), (tail + 0.9, 2.5), (tail + 0.8, 0.7)]
    axes.add_patch(Polygon(fin, closed=True, fc="#e6e9ee", ec=GREY, lw=1.2))
    axes.plot([-vane, -3.4], [0.0, 0.0], color=GREY, lw=2.5)
    axes.plot([-vane - 0.1, -vane + 0.5], [0.06, -0.06], color=BLUE, lw=4, solid_capstyle="round")
    axes.plot([-0.5, 1.5], [1.25, 1.1], color=ORANGE, lw=7, solid_capstyle="round")
    axes.plot([tail - 0.5, tail + 0.8], [1.55, 1.5], color=GREEN, lw=5, solid_capstyle="round")


def main() -> None:
    aircraft, speed = load_aircraft("twin_otter"), to_si(110, "kt")
    assert aircraft.boom is not None
    vane, tail = aircraft.boom.vane_x, aircraft.unsteady.tail_arm
    early, late = aircraft.boom.vane_x / speed, tail / speed
    figure = Figure(figsize=(10, 3.5), layout="constrained")
    axes = figure.subplots()
    silhouette(axes, vane, tail)
    for x in np.linspace(-11.5, -7.0, 6):
        axes.annotate(
            "", (x, 1.5 - 0.28 * (x + 7.0) ** 2 / 5), (x, -1.6), arrowprops={"arrowstyle": "-|>", "color": "#8a92a0"}
        )
    axes.annotate("", (-5.9, -1.9), (-11.5, -1.9), arrowprops={"arrowstyle": "-|>", "color": "#8a92a0", "lw": 1.5})
    axes.text(-11.6, -2.5, "a gust, carried past at the airspeed", color=GREY, fontsize=9)
    for x, top, colour, when, what in (
        (
            -vane,
            -0.2,
            BLUE,
            f"{1e3 * early:.0f} ms before",
            "the vane reads it, amplified by\nthe upwash of body and wing",
        ),
        (0.4, 1.0, ORANGE, "now", "the wing's lift follows it,\nlate by a chord or two"),
        (tail, 1.4, GREEN, f"{1e3 * late:.0f} ms after", "the tail meets it,\nin the wing's downwash"),
    ):
        axes.plot([x, x], [-2.9, top], color=colour, lw=1, ls=(0, (3, 3)))
        axes.plot([x], [-2.9], "o", color=colour, ms=6)
        axes.text(x, -3.3, when, color=colour, fontsize=11, ha="center", va="top", weight="bold")
        axes.text(x, -3.95, what, color=GREY, fontsize=9, ha="center", va="top")
    axes.plot([-11.6, 11.5], [-2.9, -2.9], color=GREY, lw=0.8, zorder=0)
    axes.set_xlim(-11.8, 11.5)
    axes.set_ylim(-5.1, 2.7)
    axes.set_aspect("equal")
    axes.axis("off")
    FigureCanvasAgg(figure)
    figure.savefig(Path(sys.argv[1]), dpi=110)


if __name__ == "__main__":
    main()
