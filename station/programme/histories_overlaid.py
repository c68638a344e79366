"""A report's time histories of a test point over those of the point that it is compared with, from the first input on.

Its like in another flight is a point of the same name, else one of the baseline's. Thin lines beside each history are
two standard deviations of the noise that the recording's rig states; of the angle of attack, those of the vane's.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from station.conventions import G0
from station.estimation.flight_record import FlightRecord
from station.identification.html_page import BLUE, ORANGE, image, text, without_frame
from station.programme.flown_points import FlownPoint
from station.programme.programme import Programme

Array = NDArray[np.float64]

BEFORE_S: Final = 2.0
"""Of trim, before the first input."""
LONGEST_S: Final = 30.0
"""From there on: later the two have drifted apart by their trims."""
MOST: Final = 8
"""Pairs drawn; the derivatives of all are in the tables."""
PANELS: Final[Mapping[str, tuple[str, float]]] = {
    "elevator": ("elevator, deg", math.degrees(1.0)),
    "alpha": ("alpha at the CG, deg", math.degrees(1.0)),
    "q": ("q, deg/s", math.degrees(1.0)),
    "az": ("az, g", 1.0 / G0),
}
_NOISE: Final = {"alpha": "alpha_vane"}


@dataclass(frozen=True, slots=True)
class History:
    """Of PANELS' signals, (n,) each and SI, with the standard deviation of their noise (NaN: not stated); `t_s` is zero
    where the first input begins."""

    t_s: Array
    values: Mapping[str, Array]
    noise: Mapping[str, float]


def history(point: FlownPoint) -> History | None:
    """None where no input was found in it."""
    if point.found is None or not point.inputs:
        return None
    record: FlightRecord = point.found.record
    t = record.t_s - point.inputs[0].start_s
    seen = (t >= -BEFORE_S) & (t <= LONGEST_S)
    if not seen.any():
        return None
    every = {name: record.alpha if name == "alpha" else record.motion[name] for name in PANELS}
    noise = {name: float(record.noise.get(_NOISE.get(name, name), math.nan)) for name in PANELS}
    return History(t[seen], {name: x[seen] for name, x in every.items()}, noise)


def pairs(made: Programme) -> list[tuple[FlownPoint, FlownPoint]]:
    """Points with what each is laid over: one of the same name in an earlier flight, else the baseline's first."""
    order = {str(flight.path): k for k, flight in enumerate(made.flights)}
    found = []
    first = next((p for p in made.points if p.title in made.baseline.points and history(p) is not None), None)
    for point in made.points:
        like = [p for p in made.points if p.name == point.name and order[p.log] < order[point.log]]
        other = like[0] if like else None if point.title in made.baseline.points else first
        if other is not None and other is not point:
            found.append((point, other))
    return found


def histories_overlaid(made: Programme) -> Iterator[str]:
    """A section of the report; nothing where no point has its like."""
    drawn = [(p, other, history(p), history(other)) for p, other in pairs(made)]
    usable = [(p, other, a, b) for p, other, a, b in drawn if a is not None and b is not None]
    if not usable:
        return
    yield "<h2>Time histories compared</h2>"
    several = len(made.flights) > 1
    for p, other, mine, its in usable[:MOST]:
        called = [f"{x.title}, {x.log.rpartition('/')[2]}" if several else x.title for x in (p, other)]
        yield _figure(called, (mine, its))
    more = len(usable) - MOST
    said = f" {more} more pairs are not drawn." if more > 0 else ""
    yield (
        '<p class="note">From the first input of each point on; thin: two standard deviations of the noise that '
        "the rig states. Other inputs, speeds and trims answer otherwise: what has changed is in the tables."
        f"{text(said)}</p>"
    )


def _figure(called: list[str], flown: tuple[History, History]) -> str:
    figure = Figure(figsize=(10, 7.0), layout="constrained", dpi=120)
    panels = figure.subplots(len(PANELS), 1, sharex=True)
    for panel, (name, (words, scale)) in zip(panels, PANELS.items(), strict=True):
        for label, one, colour in zip(called[::-1], flown[::-1], (BLUE, ORANGE), strict=True):
            x, wide = scale * one.values[name], 2 * scale * one.noise[name]
            panel.plot(one.t_s, x, color=colour, lw=1.1, label=label)
            if math.isfinite(wide):
                for edge in (x - wide, x + wide):
                    panel.plot(one.t_s, edge, color=colour, lw=0.4, alpha=0.6)
        panel.set_ylabel(words)
        panel.tick_params(labelsize=8)
        panel.grid(axis="y", color="#eceef2")
        without_frame(panel, "top", "right")
    panels[-1].set_xlabel("time from the first input, s", loc="right")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", fontsize=8, frameon=False, ncols=2)
    return image(figure, f"Elevator, angle of attack, pitch rate and acceleration of {called[0]} over {called[1]}")
