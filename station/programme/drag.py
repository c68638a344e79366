"""Drag of a test point by the power that the flight shows, without a manoeuvre: `drag_by_energy` at no lift.

CD - induced CL^2 = CD_0
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from station.estimation.flight_record import FlightRecord
from station.model.energy_drag import FEWEST, drag_by_energy


class DragOfPoint(NamedTuple):
    """CD_0 over a point and its standard error, by the scatter of its windows."""

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
    polar = record.aircraft.drag
    at_no_lift = found.CD - (polar.induced if polar else 0.0) * found.CL**2
    return DragOfPoint(float(np.mean(at_no_lift)), found.random(at_no_lift))
