"""The thrust of each frame by the profile's engine, where it is not recorded but the engine's setting is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import MAX_AGE_S, SIGNAL_INDEX, SIGNALS
from station.model.thrust import setting_of, thrust_by_engine
from station.profile import Aircraft, ThrustTable
from station.rows import Frame, Quality

Array = NDArray[np.float64]

NEEDED: Final = ("airspeed", "static_pressure", "altitude")


class EngineThrust:
    """By propeller or table, N; NaN where the setting is missing, old or beyond the table."""

    def __init__(self, aircraft: Aircraft) -> None:
        assert aircraft.engine is not None
        self._aircraft = aircraft
        self._names = (setting_of(aircraft.engine), *NEEDED)
        self._needs_altitude = isinstance(aircraft.engine, ThrustTable) and len(aircraft.engine.altitudes) > 1
        self.why = ""
        """Why it gave none at the last frame."""

    def step(self, frame: Frame) -> float:
        motion = {name: np.array([_believed(frame, name)]) for name in self._names}
        lost = next((n for n in (self._names[0], "airspeed") if not math.isfinite(motion[n][0])), "")
        if lost:
            self.why = f"no {lost}, by which the engine's thrust is known"
            return math.nan
        if self._needs_altitude and not any(math.isfinite(motion[n][0]) for n in NEEDED[1:]):
            self.why = "no altitude, by which the engine's thrust is known"
            return math.nan
        made = thrust_by_engine(self._aircraft, motion)
        thrust = math.nan if made is None else float(made[0])
        self.why = "" if math.isfinite(thrust) else f"the engine's table is exceeded ({self._where(motion)})"
        return thrust

    def _where(self, motion: Mapping[str, Array]) -> str:
        """The point at which it is asked, in the units of the table's keys."""
        setting, speed = motion[self._names[0]][0], motion["airspeed"][0]
        return f"{self._names[0]} {setting:.3g}, {speed:.1f} m/s"


def _believed(frame: Frame, name: str) -> float:
    """A signal's value, NaN where it is not to be used."""
    k = SIGNAL_INDEX[name]
    value, signal = frame.values[k], SIGNALS[name]
    young = frame.age_s[k] <= MAX_AGE_S[name]
    return value if young and frame.quality[k] < Quality.SUSPECT and signal.low <= value <= signal.high else math.nan
