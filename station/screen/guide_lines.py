"""The card's step on the terminal: its condition, the input drawn and the one flown over it, and the verdict."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray
from rich.text import Text

from station.conventions import from_si
from station.flight.guide import Guide, Phase
from station.flight.verdict import Known, Verdict
from station.screen.answers import phase_words
from station.screen.derivative_tables import TITLE, styled

Array = NDArray[np.float64]

MARGIN: Final = 10
ROWS: Final = {1: 5, 2: 3}
"""Lines of a picture, by how many there are."""
FEWEST_ROWS: Final = 3
PHASE_STYLES: Final = {
    Phase.COUNTDOWN: "bold black on yellow",
    Phase.FLYING: "bold black on green",
    Phase.SETTLING: "black on cyan",
}
READY_STYLES: Final = {"READY": "bold black on green", "GET READY": "bold black on yellow"}
KIND_STYLES: Final = {
    "enough": "bold green",
    "repeat": "bold yellow",
    "change": "bold yellow",
    "spent": "yellow",
    "beyond": "yellow",
}


def guide_lines(guide: Guide, width: int) -> list[Text]:
    """Not more than 17 lines, none wider than `width`."""
    return [*_heading(guide), *_condition(guide, width), *_pictures(guide, width), *_outcome(guide, width)]


def guide_keys(guide: Guide) -> tuple[tuple[str, str], ...]:
    """The keys that do something now."""
    match guide.shown.phase:
        case Phase.READY:
            return (("n", "next: count down"), ("s", "skip"))
        case Phase.COUNTDOWN | Phase.FLYING | Phase.SETTLING:
            return (("a", "abort"), ("s", "skip"))
        case Phase.VERDICT:
            return (("n", "next"), ("r", "repeat"), ("s", "skip"))
        case Phase.DONE:
            return ()


def _heading(guide: Guide) -> Iterator[Text]:
    shown = guide.shown
    if shown.phase is Phase.DONE:
        line = styled(f" {phase_words(guide)} ", "bold black on green")
    else:
        line = styled(f" STEP {shown.number}/{len(guide.steps)}", TITLE).append(f"  {guide.step.name}", "bold")
        if shown.run:
            line.append(f"   run {shown.run} of {guide.step.repeats}", "dim")
        words = phase_words(guide)
        if shown.phase is not Phase.VERDICT:  # that stands below, in words
            line.append("   ").append(f" {words} ", PHASE_STYLES.get(shown.phase, READY_STYLES.get(words, "")))
    yield line
    if shown.phase is Phase.DONE:
        for name, how in shown.results:
            yield Text(f"   {name}: ").append(how, KIND_STYLES.get(how, "dim"))


def _condition(guide: Guide, width: int) -> Iterator[Text]:
    shown = guide.shown
    if shown.phase is Phase.DONE:
        return
    if guide.step.condition.configuration:
        yield Text("   ").append(guide.step.condition.configuration, "bold")
    line = Text("  ")
    for check in shown.checks:
        if line.cell_len + len(check.words) + 2 > width:
            yield line
            line = Text("  ")
        line.append(" ").append(check.words, "green" if check.good else "bold white on red").append(" ")
    yield line


def _pictures(guide: Guide, width: int) -> Iterator[Text]:
    if guide.shown.phase is Phase.DONE:
        return
    surfaces = guide.table.surfaces
    for name, drawn in surfaces.items():
        flown = guide.flown.get(name, drawn[:0])
        if len(flown) != len(drawn):  # of another step: the loop goes on meanwhile
            flown = np.full(len(drawn), math.nan)
        yield from _picture(name, drawn, flown, ROWS.get(len(surfaces), FEWEST_ROWS), width - MARGIN - 1)


def _picture(name: str, drawn: Array, flown: Array, rows: int, columns: int) -> Iterator[Text]:
    """The drawn input dim, the flown one over it; positive upwards, scaled to the drawn one's peak."""
    peak = max(float(np.abs(drawn).max()), 1e-6)
    grid = [[" "] * columns for _ in range(rows)]
    place = np.minimum(np.arange(len(drawn)) * columns // len(drawn), columns - 1)
    for values, mark in ((drawn, "·"), (flown, "●")):
        for column in range(columns):
            inside = values[place == column]
            inside = inside[np.isfinite(inside)]
            if len(inside):
                height = round((1 - float(np.clip(inside.mean() / peak, -1, 1))) / 2 * (rows - 1))
                grid[height][column] = mark
    degrees = from_si(peak, "deg")
    labels = {0: f"{degrees:+.1f}°", rows // 2: name[: MARGIN - 1], rows - 1: f"{-degrees:+.1f}°"}
    for i, row in enumerate(grid):
        line = styled(f"{labels.get(i, ''):>{MARGIN - 1}} ", "dim")
        for mark in row:
            line.append(mark, "bold yellow" if mark == "●" else "cyan")
        yield line


def _outcome(guide: Guide, width: int) -> Iterator[Text]:
    """What is wanted, and the verdict on it."""
    verdict, phase = guide.shown.verdict, guide.shown.phase
    if phase is Phase.DONE:
        return
    if verdict is None:
        wanted = ", ".join(f"{name} to {100 * share:g} %" for name, share in guide.step.accept.items())
        yield styled(f"   wanted: {wanted or 'nothing but the record'}", "dim")
        return
    if verdict.known:
        line = Text("  ")
        for k in verdict.known:
            line.append(" ").append(_known(k), "green" if k.enough else "yellow").append(" ")
        yield line
    yield from _words(verdict, width)


def _known(k: Known) -> str:
    have = f"±{100 * k.have:.2g} %" if math.isfinite(k.have) else "–"
    return f"{k.name} {have} ({100 * k.wanted:g})"


def _words(verdict: Verdict, width: int) -> Iterator[Text]:
    for words in textwrap.wrap(verdict.words, width - 4)[:2]:
        yield Text(" ").append(f" {words} ", f"{KIND_STYLES[verdict.kind]} reverse")
