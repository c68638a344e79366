"""The page of the drag: what it came to, and CD window by window against the profile's polar."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from station.identification.drag_results import DragResult, drag_lines
from station.identification.html_page import BLUE, ORANGE, image, text
from station.model.energy_drag import WINDOW_S


def drag_page(found: DragResult | str) -> list[str]:
    """HTML of the section."""
    words = "<br>".join(text(line) for line in drag_lines(found))
    made = ["<h2>Drag from energy</h2>", f"<p>{words}.</p>"]
    if not isinstance(found, str):
        made.append(image(_over_time(found), "drag coefficient over the flight"))
        made.append(
            f'<p class="note">Thrust less what the motion shows of it, over windows of {WINDOW_S:g} s; the error of '
            "all together is that of thrust, mass, angle of attack and accelerometer, which no window shows.</p>"
        )
    return made


def _over_time(found: DragResult) -> Figure:
    windows = found.windows
    figure = Figure(figsize=(10, 3), dpi=90)
    panel = figure.subplots()
    figure.subplots_adjust(left=0.08, right=0.99, bottom=0.17, top=0.95)
    panel.plot(windows.t_s, windows.CD, ".-", color=BLUE, label="from energy")
    if np.isfinite(windows.expected).any():
        panel.plot(windows.t_s, windows.expected, color=ORANGE, label="the profile's polar")
    panel.fill_between(
        windows.t_s, windows.CD - 2 * windows.systematic, windows.CD + 2 * windows.systematic, color=BLUE, alpha=0.12
    )
    panel.set_ylim(0, None)
    panel.set_xlabel("time [s]")
    panel.set_ylabel("CD")
    panel.legend(loc="lower right", frameon=False)
    return figure
