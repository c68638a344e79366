"""Thrust by the profile's engine: of a propeller T = eta P/V, or by a table over setting, altitude and airspeed.

SI; thrust along the thrust line, of all engines together. Source: McCormick 1995, Aerodynamics, aeronautics and flight
mechanics, section 6.2 (propeller efficiency).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from station.conventions import MIN_SPEED
from station.numerics.atmosphere import height_at_pressure
from station.profile import Aircraft, Propeller, ThrustTable

Array = NDArray[np.float64]


def setting_of(engine: Propeller | ThrustTable) -> str:
    """The signal that it goes by."""
    return "shaft_power" if isinstance(engine, Propeller) else engine.signal


def thrust_by_engine(aircraft: Aircraft, motion: Mapping[str, Array]) -> Array | None:
    """N (n,): of an engine whose setting is recorded, NaN where that is missing or out of its table; None without."""
    engine = aircraft.engine
    if engine is None or setting_of(engine) not in motion:
        return None
    setting, speed = motion[setting_of(engine)], motion["airspeed"]
    if not np.isfinite(setting).any():
        return None
    if isinstance(engine, Propeller):
        most = np.inf if engine.static_thrust is None else engine.static_thrust
        return np.minimum(efficiency(engine, speed) * setting / np.maximum(speed, MIN_SPEED), most)
    at = [setting, speed] if len(engine.altitudes) == 1 else [setting, _altitude(motion), speed]
    return np.asarray(_table(engine)(np.column_stack(at)))


@lru_cache(maxsize=8)
def _table(engine: ThrustTable) -> RegularGridInterpolator:
    """Over setting, altitude where there is more than one, and airspeed; NaN outside."""
    values, axes = np.array(engine.thrust), [engine.settings, engine.altitudes, engine.speeds]
    if len(engine.altitudes) == 1:
        values, axes = values[:, 0], [engine.settings, engine.speeds]
    return RegularGridInterpolator(axes, values, bounds_error=False)


def efficiency(engine: Propeller, speed: Array) -> Array:
    """Of the propeller at true airspeeds (n,), m/s; beyond its table that of the end."""
    if not engine.speeds:
        return np.full(len(speed), engine.efficiency[0])
    return np.interp(speed, engine.speeds, engine.efficiency)


def _altitude(motion: Mapping[str, Array]) -> Array:
    """Pressure altitude, else the recorded one, m."""
    pressure = motion.get("static_pressure")
    if pressure is not None and np.isfinite(pressure).any():
        return np.array([height_at_pressure(p) if p > 0 else np.nan for p in pressure])
    return motion.get("altitude", np.full(len(motion["airspeed"]), np.nan))
