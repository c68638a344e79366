"""Lines and labels that the page draws on plain 2-D views: no axes of time, so no time series. Pure.

x to the right, y down, as on a screen.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.screen.brief import StepBrief

Array = NDArray[np.float64]

DRAWN: Final = 0x56B4E9FF
FLOWN: Final = 0xF0E442FF
AXIS: Final = 0x555F68FF
WIDE: Final = 1000.0
"""Of a drawing, in its own units; a view fits it to its size."""
HIGH: Final = 300.0
_SIDE: Final = 20.0


@dataclass(frozen=True, slots=True)
class Strip:
    """One line: points (n, 2), colour RGBA, width in pixels."""

    points: Array
    colour: int
    width: float = 1.5


@dataclass(frozen=True, slots=True)
class Label:
    """Words at a place."""

    x: float
    y: float
    words: str
    colour: int = 0xC8D0D8FF


@dataclass(frozen=True, slots=True)
class Drawing:
    strips: tuple[Strip, ...]
    labels: tuple[Label, ...] = ()


def step_drawing(step: StepBrief) -> Drawing:
    """The input as drawn and, over it, as flown: a row a surface, to one scale each; time to the right."""
    strips: list[Strip] = []
    labels: list[Label] = []
    rows = len(step.pictures)
    for i, picture in enumerate(step.pictures):
        drawn, flown = np.array(picture.drawn), np.array(picture.flown)
        height = HIGH / rows
        middle = (i + 0.5) * height
        peak = max(float(np.abs(drawn).max()), 1e-6)
        scale = 0.40 * height / peak
        x = np.linspace(_SIDE, WIDE - _SIDE, len(drawn))
        strips.append(Strip(np.array([[x[0], middle], [x[-1], middle]]), AXIS, 1.0))
        strips.append(Strip(np.column_stack((x, middle - scale * drawn)), DRAWN, 1.5))
        strips += [
            Strip(part, FLOWN, 3.0) for part in unbroken(x, middle - scale * np.clip(flown, -1.2 * peak, 1.2 * peak))
        ]
        labels.append(Label(x[-1] - 70, middle - 0.42 * height, f"{picture.surface} ±{peak:.1f}°"))
    if 0 < step.since_s < step.length_s:
        now = _SIDE + (WIDE - 2 * _SIDE) * step.since_s / step.length_s
        strips.append(Strip(np.array([[now, 0.0], [now, HIGH]]), AXIS, 1.0))
    return Drawing(tuple(strips), tuple(labels))


def unbroken(x: Array, y: Array) -> Iterator[Array]:
    """Runs of what is known, two points at least."""
    known = np.isfinite(y)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], known, [False])).astype(int)))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        if end - first > 1:
            yield np.column_stack((x[first:end], y[first:end]))


def axes(x_ticks: Sequence[tuple[float, str]], y_ticks: Sequence[tuple[float, str]], high: float) -> Drawing:
    """A grid over the whole drawing with its ticks' labels, in drawing units."""
    strips = [Strip(np.array([[x, 0.0], [x, high]]), AXIS, 0.5) for x, _ in x_ticks]
    strips += [Strip(np.array([[0.0, y], [WIDE, y]]), AXIS, 0.5) for y, _ in y_ticks]
    labels = [Label(x, high + 5, words) for x, words in x_ticks]
    labels += [Label(-45, y - 14, words) for y, words in y_ticks]
    return Drawing(tuple(strips), tuple(labels))


def key_drawing(lines: Sequence[tuple[str, int, float]]) -> Drawing:
    """What the lines of a tab are: name, colour and width, side by side."""
    each = WIDE / len(lines)
    strips = tuple(
        Strip(np.array([[i * each, 0.0], [(i + 0.5) * each, 0.0]]), colour, width)
        for i, (_, colour, width) in enumerate(lines)
    )
    labels = tuple(Label((i + 0.25) * each, 22.0, name, colour) for i, (name, colour, _) in enumerate(lines))
    return Drawing(strips, labels)
