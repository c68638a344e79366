"""Drag of a test point by the power that the flight shows, without a manoeuvre: `drag_by_energy` at no lift.

CD - induced CL^2 = CD_0
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from station.estimation.flight_record import FlightRecord
from station.model.energy_drag import FEWEST, drag_by_energy


class DragOfPoint(NamedTuple):
    """CD_0 over a point and its standard error: the scatter of its windows, and what a vane of another scale makes of
    the point's motion, which is not that of another point."""

    value: float
    error: float


def drag_of(record: FlightRecord) -> DragOfPoint | None:
    """Of a record; None where thrust is unknown, and of less than FEWEST windows."""
    if not record.thrust_known:
        return None
    motion = {name: np.where(record.usable, x, np.nan) for name, x in record.motion.items()}
    found = drag_by_energy(motion, record.airframe, record.aircraft, record.alpha, record.t_s)
    if len(found.t_s) < FEWEST:
        return None
    # Of each instant's lift: within a window of an input its square has another mean than the mean's.
    polar = record.aircraft.drag
    at_no_lift = found.change + polar.zero_lift if polar else found.CD
    return DragOfPoint(float(np.mean(at_no_lift)), math.hypot(found.random(at_no_lift), found.by_motion))
