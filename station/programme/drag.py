"""Drag of a test point by the power that the flight shows, without a manoeuvre.

    CD - induced CL^2 = CD_0

from the accelerations, which hold all that the engines give and the aircraft gains in height and speed (Deiler and
Fezans 2020 detect ice by it). Only where thrust is recorded: without it drag and thrust are one unknown.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.estimation.flight_record import FlightRecord
from station.log import Table
from station.profile import Aircraft

Array = NDArray[np.float64]

BLOCK_S: Final = 10.0
"""Over which drag is a mean: two short periods, and longer than gusts of that length are alike."""
LEAST_BLOCKS: Final = 2


class DragOfPoint(NamedTuple):
    """CD_0 over a point and its standard error, by the scatter of its blocks."""

    value: float
    error: float


def induced(aircraft: Aircraft) -> float:
    """CD per CL squared of the profile; 0 where it states none."""
    return aircraft.drag.induced if aircraft.drag else 0.0


def has_thrust(table: Table) -> bool:
    """Whether the recording has it."""
    return "thrust" in table.columns and bool(np.isfinite(table.columns["thrust"]).any())


def drag_of(record: FlightRecord) -> DragOfPoint | None:
    """Of a record whose thrust is a recorded one; None for less than two blocks."""
    c = record.coefficients
    series = c.CD - induced(record.aircraft) * c.CL**2
    width = round(BLOCK_S / record.dt)
    blocks = []
    for k in range(0, len(series) - width + 1, width):
        piece = series[k : k + width][record.usable[k : k + width]]
        piece = piece[np.isfinite(piece)]
        if len(piece) > width // 2:
            blocks.append(float(np.mean(piece)))
    if len(blocks) < LEAST_BLOCKS:
        return None
    return DragOfPoint(float(np.mean(blocks)), float(np.std(blocks, ddof=1)) / math.sqrt(len(blocks)))
