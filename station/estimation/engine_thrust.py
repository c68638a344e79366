"""The thrust of each frame by the profile's engine, where it is not recorded but the engine's setting is."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from station.conventions import MAX_AGE_S, SIGNAL_INDEX, SIGNALS
from station.model.thrust import setting_of, thrust_by_engine
from station.profile import Aircraft
from station.rows import Frame, Quality

NEEDED: Final = ("airspeed", "static_pressure", "altitude")


class EngineThrust:
    """By propeller or table, N; NaN where the setting is missing, old or beyond the table."""

    def __init__(self, aircraft: Aircraft) -> None:
        assert aircraft.engine is not None
        self._aircraft = aircraft
        self._names = (setting_of(aircraft.engine), *NEEDED)

    def step(self, frame: Frame) -> float:
        motion = {name: np.array([_believed(frame, name)]) for name in self._names}
        if not math.isfinite(motion[self._names[0]][0] + motion["airspeed"][0]):
            return math.nan
        made = thrust_by_engine(self._aircraft, motion)
        return math.nan if made is None else float(made[0])


def _believed(frame: Frame, name: str) -> float:
    """A signal's value, NaN where it is not to be used."""
    k = SIGNAL_INDEX[name]
    value, signal = frame.values[k], SIGNALS[name]
    young = frame.age_s[k] <= MAX_AGE_S[name]
    return value if young and frame.quality[k] < Quality.SUSPECT and signal.low <= value <= signal.high else math.nan
