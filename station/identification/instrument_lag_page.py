"""The report's section on instruments: every one's lag, scale and zero against the others, as a table and a picture."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.axes import Axes as Panel
from matplotlib.figure import Figure

from station.identification.html_page import BLUE, FAINT, INK, ORANGE, image, text
from station.identification.instrument_table import CI95, KINDS, Instrument, InstrumentTable, cell, heading

SURE: Final = 3.0
"""Standard deviations beyond which a lag or a scale stands out."""
LONG_S: Final = 0.1
"""A lag beside which one of milliseconds is not seen on a linear axis."""
TICKS_MS: Final = (-1000, -300, -100, -20, 0, 20, 100, 300, 1000)


def lag_page(table: InstrumentTable | str, of: str = "") -> list[str]:
    """HTML of the section, for the recording `of` where there are several."""
    head = f"<h2>Instruments against each other{f': {text(of)}' if of else ''}</h2>"
    if isinstance(table, str):
        return [head, f"<p>Not available: {text(table)}.</p>"]
    lines = []
    for row in table.rows:
        cells = "".join(f"<td>{text(cell(row, kind))}</td>" for kind in KINDS)
        whys = dict.fromkeys(f"{kind}: {row.of(kind).why}" for kind in KINDS if row.of(kind).why)
        against = ", ".join(row.against) or "reference"
        lines.append(
            f"<tr><td>{text(row.signal)}</td><td class='words'>{text(against)}</td>{cells}"
            f'<td class="words faint">{text("; ".join(whys))}</td></tr>'
        )
    note = f"{heading(table)}."
    if np.isfinite(table.gust_sd):
        note += f" Vertical gust that the vane shows beside the motion, 0.1 to 2 Hz: {table.gust_sd:.2f} m/s rms."
    return [
        head,
        image(_picture(table), "Lag and scale of each instrument with 95 % intervals"),
        "<table><tr><th>instrument</th><th class='words'>against</th><th>lag</th><th>scale</th><th>zero</th>"
        f"<th class='words'>not told</th></tr>{''.join(lines)}</table>",
        f'<p class="note">{text(note)}</p>',
    ]


def _picture(table: InstrumentTable) -> Figure:
    """Two panels side by side: lags in ms, scales; a row an instrument that has either."""
    rows = [row for row in table.rows if not (row.lag.why and row.scale.why)][::-1]
    figure = Figure(figsize=(10, 1.1 + 0.3 * max(len(rows), 1)), layout="constrained", dpi=120)
    panels = figure.subplots(1, 2, sharey=True)
    for panel, kind, null, factor, title in (
        (panels[0], "lag", 0.0, 1e3, "lag against the attitude, ms"),
        (panels[1], "scale", 1.0, 1.0, "scale"),
    ):
        panel.axvline(null, color=FAINT, lw=0.8, zorder=0)
        for y, row in enumerate(rows):
            _bar(panel, y, row, kind, null, factor)
        panel.set_title(title, fontsize=10, loc="left", color=INK)
        panel.tick_params(labelsize=8, length=0)
        panel.margins(x=0.08)
        for side in ("top", "right", "left"):
            panel.spines[side].set_visible(False)
    if any(abs(row.lag.value) > LONG_S for row in rows if not row.lag.why):
        # A lag of a second beside others of milliseconds.
        panels[0].set_xscale("symlog", linthresh=TICKS_MS[5], linscale=0.6)
        low, high = panels[0].get_xlim()
        panels[0].set_xticks([x for x in TICKS_MS if low <= x <= high], minor=False)
        panels[0].xaxis.set_major_formatter(lambda x, _: f"{x:.0f}")
    panels[0].set_yticks(range(len(rows)), [row.signal for row in rows])
    panels[0].set_ylim(-0.6, len(rows) - 0.4)
    return figure


def _bar(panel: Panel, y: int, row: Instrument, kind: str, null: float, factor: float) -> None:
    v = row.of(kind)
    if v.why:
        return
    stated = row.stated.get(kind, null)
    colour = ORANGE if abs(v.value - stated) > SURE * v.sd else BLUE
    panel.errorbar(factor * v.value, y, xerr=factor * CI95 * v.sd, fmt="o", ms=4, color=colour, lw=1.5, capsize=2.5)
    if kind in row.stated:
        panel.plot(factor * stated, y, marker="|", ms=10, color=INK)
