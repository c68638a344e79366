"""What `station planform` found as a page: numbers beside the profile's, responses, the downwash's arrival."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes as Panel
from matplotlib.figure import Figure

from station.identification.html_page import BLUE, FAINT, INK, ORANGE, image, text, without_frame, write_page
from station.model.outline_responses import FittedResponse, PlanformAnswer
from station.programme.planform_words import RESPONSES, beside, heading, response_difference, shown, sums

FILE_NAME: Final = "planform.html"
_SHOWN: Final = 20.0
"""Chords, and of the downwash tail arms over 5."""


def write_report(made: PlanformAnswer, folder: Path) -> Path:
    """Write planform.html into `folder`; returns its path. Raises LogError if it cannot be written."""
    body = [
        f"<h1>{text(made.aircraft.name)}: outline</h1>",
        f'<p class="verdict">{text(heading(made))}.</p>',
        _numbers(made),
        "<h2>Responses</h2>",
        _responses(made),
        _picture(made),
        '<p class="note">Dots: the vortex lattice; line: the exponentials fitted, which a profile has; dashed: the '
        "profile's now. Differs: between 0.1 and 2 Hz at worst, magnitude and phase together.</p>",
        *_downwash(made),
        *(f'<p class="note">{text(r)}</p>' for r in made.remarks),
    ]
    return write_page(f"Planform: {made.aircraft.name}", body, folder / FILE_NAME)


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    lines = "".join("<tr>" + "".join(f"<td>{text(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="wide"><table><tr>{"".join(f"<th>{text(h)}</th>" for h in head)}</tr>{lines}</table></div>'


def _numbers(made: PlanformAnswer) -> str:
    rows = [
        (n.words, shown(n, n.value), shown(n, n.profile), beside(n.difference), n.key) for n in made.numbers
    ]  # fmt: skip
    return _table(("", "outline", "profile", "profile differs", "key"), rows)


def _responses(made: PlanformAnswer) -> str:
    rows = [
        (RESPONSES[name], sums(fit.indicial), f"{fit.worst:.3f}", response_difference(fit))
        for name, fit in made.responses.items()
    ]
    return _table(("", "1 - sum a exp(-b t), t in chords", "fit's worst", "profile's differs"), rows)


def _draw(panel: Panel, name: str, fit: FittedResponse, scale: float) -> None:
    at = np.linspace(0.0, _SHOWN, 400)
    seen = (fit.chords >= 0) & (fit.chords <= _SHOWN)
    panel.plot(fit.chords[seen], fit.values[seen], ".", color=FAINT, ms=4)
    panel.plot(at, 1 - np.exp(-np.outer(at, fit.indicial.b)) @ fit.indicial.a, color=BLUE)
    if fit.profile is not None:
        panel.plot(at, 1 - np.exp(-np.outer(at / scale, fit.profile.b)) @ fit.profile.a, "--", color=ORANGE)
    panel.set_title(RESPONSES[name], loc="left", fontsize=10, color=INK)
    panel.set_xlabel("chords travelled", loc="right")
    panel.set_ylim(0, 1.1)
    without_frame(panel, "top", "right")


def _picture(made: PlanformAnswer) -> str:
    figure = Figure(figsize=(10, 6), layout="constrained", dpi=120)
    mean = made.aircraft.geometry.wing_area / made.aircraft.geometry.span
    scale = (made.aircraft.unsteady.reference_chord or made.aircraft.geometry.chord) / mean
    panels = figure.subplots(2, 2).ravel()
    for panel in panels[len(made.responses) :]:
        panel.remove()
    for panel, (name, fit) in zip(panels, made.responses.items(), strict=False):
        _draw(panel, name, fit, scale)
    return image(figure, "Indicial responses of the outline, their exponentials, and the profile's")


def _downwash(made: PlanformAnswer) -> list[str]:
    if made.downwash is None:
        return []
    seconds, share = made.downwash
    arm = made.aircraft.unsteady.tail_arm / made.speed
    seen = seconds <= 5 * arm
    figure = Figure(figsize=(10, 3), layout="constrained", dpi=120)
    panel = figure.subplots()
    panel.plot(seconds[seen], share[seen], ".-", color=BLUE, ms=3, lw=0.8)
    panel.plot(seconds, made.downwash_modelled(), "--", color=ORANGE)
    panel.set_xlim(0, 5 * arm)
    panel.axvline(arm, color=FAINT, lw=0.8)
    panel.annotate("tail arm / V", (arm, 0.0), xytext=(4, 4), textcoords="offset points", fontsize=8, color=INK)
    panel.set_xlabel("s after a step of the angle of attack", loc="right")
    without_frame(panel, "top", "right")
    return [
        "<h2>Downwash at the tail</h2>",
        image(figure, "Downwash at the tail after a step of the angle of attack over its steady value"),
        '<p class="note">Over its steady value. Line: the lattice, where the starting vortex of the wing passes; '
        "dashed: what a profile makes of it, the lift of the wing so much later.</p>",
    ]
