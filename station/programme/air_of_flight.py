"""The air of a whole recording: vertical gust, its running level between 2 and 7 Hz and the classes' limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from station.estimation.flight_record import FlightRecord
from station.identification.flown import fly
from station.identification.preparation import prepare
from station.identification.request import Request
from station.log import metadata
from station.numerics.turbulence import WINDOW_S, Thresholds
from station.profile import Aircraft
from station.programme.flown_points import banded
from station.programme.programme import Flight
from station.rows import UsageError

Array = NDArray[np.float64]

SPLIT: Final = ("split",)
"""What parts gust and motion."""


@dataclass(frozen=True, slots=True)
class Air:
    """(n,) each."""

    t_s: Array
    gust: Array
    """Vertical, m/s."""
    level: Array
    """Its standard deviation in 2-7 Hz over WINDOW_S, m/s."""
    elevator: Array
    """rad"""
    limits: tuple[float, float, float]
    """From which it is light, moderate, severe."""
    record: FlightRecord


def air_of(flight: Flight, aircraft: Aircraft) -> Air | str:
    """Over all of a recording; the reason where it cannot be had."""
    about = metadata(flight.path).about
    noise = about.noise_si(flight.table.aligned)
    request = Request(SPLIT, card=about.card, imu_position=about.imu_position, noise=noise, log=str(flight.path))
    try:
        ready = prepare(flight.table, aircraft, request)
    except UsageError as error:
        return str(error)
    if ready.refusal:
        return ready.refusal
    record = ready.record
    flown = fly(ready.whole, record, SPLIT, ready.request)
    gust = flown.gust_vertical(record)
    band = banded(record, gust)
    if gust is None or band is None:
        return "the gusts of this recording cannot be had: attitude, vertical velocity or rate are lacking"
    square = uniform_filter1d(band**2, max(1, round(WINDOW_S / record.dt)), mode="nearest")
    speed = float(np.nanmean(record.motion["airspeed"]))
    limits = Thresholds().at(speed, record.noise["alpha_vane"], record.dt)
    return Air(record.t_s, gust - np.nanmean(gust), np.sqrt(square), record.motion["elevator"], limits, record)
