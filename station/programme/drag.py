"""Drag of a test point by the power that the flight shows, without a manoeuvre: `drag_by_energy` at no lift; and its
lift, at no angle of attack (model/steady_lift.py).

CD - induced CL^2 = CD_0
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.estimation.flight_record import FlightRecord
from station.model.energy_drag import FEWEST, drag_by_energy
from station.model.steady_lift import SteadyLift


class DragOfPoint(NamedTuple):
    """CD_0 over a point and its standard error: the scatter of its windows, and what a vane of another scale makes of
    the point's motion, which is not that of another point."""

    value: float
    error: float
    lift: SteadyLift | None = None
    """Of the point; None where elevator or pitch rate is missing."""


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
    error = math.hypot(found.random(at_no_lift), found.by_motion)
    return DragOfPoint(float(np.mean(at_no_lift)), error, _lift(record, motion, found.CL))


def _lift(
    record: FlightRecord, motion: Mapping[str, NDArray[np.float64]], lift: NDArray[np.float64]
) -> SteadyLift | None:
    good = record.usable & np.all([np.isfinite(motion[n]) for n in ("airspeed", "q", "elevator")], axis=0)
    if not good.any():
        return None
    rate = motion["q"][good] * record.airframe.chord / (2 * motion["airspeed"][good])
    alpha, elevator = float(np.mean(record.alpha[good])), float(np.mean(motion["elevator"][good]))
    density = float(np.mean(2 * motion["dynamic_pressure"][good] / motion["airspeed"][good] ** 2))
    return SteadyLift(float(np.mean(lift)), alpha, float(np.mean(rate)), elevator, record.has("mass"), density)
