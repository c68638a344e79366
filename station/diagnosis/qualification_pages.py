"""The page of a qualification: a line a manoeuvre, and each simulated over what was measured, with its tolerances."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from station.conventions import from_si
from station.diagnosis.qualification import ACCELERATION, COMPARED, PITCH, PITCH_RATE, Flown
from station.identification.html_page import BLUE, INK, ORANGE, image, text

Array = NDArray[np.float64]

_BANDS: Final = {"theta": PITCH, "q": PITCH_RATE, "az": ACCELERATION}
_SHOWN: Final = {
    "theta": ("pitch", "deg"), "q": ("pitch rate", "deg/s"), "az": ("normal acceleration", "g"),
    "alpha_vane": ("vane", "deg"), "airspeed": ("airspeed", "m/s"),
}  # fmt: skip
_POINTS: Final = 1500
"""Of a line in a picture."""
_NOTE: Final = (
    "Worst differences in tolerances of 14 CFR part 60, table A2A: of pitch and pitch rate the less restrictive "
    "counts at each instant, and normal acceleration beside; up to 4 Hz, as far as the vane tells the gust. Flown "
    "open loop by the recorded elevator and thrust (else the trim's), the vertical gust that the vane shows, and "
    "the headwind that airspeed less ground speed shows. As in the validation of simulators, initial state and trim "
    "(CL_0, Cm_0, CD_0) are fitted to each manoeuvre, before and after alike. At first, where wing and tail "
    "fly in air that the vane met before the record, it is led as it was flown, and not judged. Bands: the tolerances."
)


def qualification_page(flown: Sequence[Flown]) -> list[str]:
    """Table and pictures."""
    rows = []
    for f in flown:
        if f.why:
            rows.append(
                f"<tr><td>{text(f.record)}</td><td class='words' colspan='6'>not simulated: {text(f.why)}</td></tr>"
            )
        for e in f.entries:
            end = "inside" if e.inside else "outside"
            first = "" if e.outside_s is None else f"{e.outside_s:.1f} s"
            rows.append(
                f"<tr><td>{text(f.record)}</td><td class='words'>{e.name}</td><td class='words'>{e.tolerance}</td>"
                f"<td>{e.before:.2f}</td><td>{e.after:.2f}</td><td class='words'>{end}</td><td>{first}</td></tr>"
            )
    head = "".join(
        f"<th{k}>{h}</th>"
        for h, k in (
            ("manoeuvre", ""), ("entry", " class='words'"), ("tolerance", " class='words'"), ("worst before", ""),
            ("worst after", ""), ("", " class='words'"), ("first outside", ""),
        )
    )  # fmt: skip
    return [
        "<h2>Simulated from the measured inputs</h2>",
        f'<div class="wide"><table><tr>{head}</tr>{"".join(rows)}</table></div>',
        f'<p class="note">{_NOTE}</p>',
        *(image(over_measured(f), f"{f.record}: simulated over measured") for f in flown if not f.why),
    ]


def over_measured(f: Flown) -> Figure:
    """One panel a signal: measured with its tolerance, and from when on it is judged, simulated before and after."""
    figure = Figure(figsize=(10, 1.5 * len(COMPARED) + 0.6), dpi=90)
    panels = figure.subplots(len(COMPARED), 1, sharex=True)
    figure.subplots_adjust(left=0.075, right=0.99, bottom=0.06, top=0.95, hspace=0.12)
    step = max(1, len(f.t_s) // _POINTS)
    t = f.t_s[::step]
    judged = t > f.judged_from_s - 0.5 * (f.t_s[1] - f.t_s[0])
    for panel, name in zip(panels, COMPARED, strict=True):
        word, unit = _SHOWN[name]
        scale = from_si(1.0, unit)
        measured, before, after = (scale * x[name][::step] for x in (f.measured, f.before, f.after))
        band = from_si(_BANDS[name], unit) if name in _BANDS else 0.0
        if band:
            panel.fill_between(t, measured - band, measured + band, color="#dfe6ef", lw=0, label="tolerance")
        panel.plot(t, measured, color=INK, lw=1.0, label="measured")
        before, after = before[judged], after[judged]
        panel.plot(t[judged], before, color=BLUE, lw=1.0, label="before")
        panel.plot(t[judged], after, color=ORANGE, lw=1.0, label="after")
        panel.set_ylabel(f"{word}\n{unit}", fontsize=8)
        panel.set_xlim(t[0], t[-1])
        panel.set_ylim(*_range(measured, band, (before, after)))
        panel.tick_params(labelsize=8, length=2)
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
    panels[0].legend(fontsize=7, frameon=False, ncols=4, loc="upper right", borderaxespad=0.0)
    panels[0].set_title(f.record, fontsize=9, loc="left")
    panels[-1].set_xlabel("s of the manoeuvre", fontsize=8, loc="right")
    return figure


def _range(measured: Array, band: float, simulated: Sequence[Array]) -> tuple[float, float]:
    """Of a panel: what was measured with its tolerance, and what is simulated as far as it is of that size: a
    simulation that departs leaves the picture."""
    low, high = float(measured.min()) - band, float(measured.max()) + band
    wide = max(high - low, 1e-9)
    least, most = min(float(x.min()) for x in simulated), max(float(x.max()) for x in simulated)
    low, high = min(low, max(least, low - wide)), max(high, min(most, high + wide))
    return low - 0.05 * wide, high + 0.15 * wide
