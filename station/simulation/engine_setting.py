"""What the engine's instruments show while it gives a thrust: the contrary of the thrust that they tell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from station.profile import Propeller, ThrustTable

Array = NDArray[np.float64]


def engine_setting(engine: Propeller | ThrustTable, thrust: Array, speed: Array, altitude: Array) -> tuple[str, Array]:
    """The signal that the engine goes by, SI, and its values (n,) for a thrust (N) at true airspeeds (m/s) and pressure
    altitudes (m); at the table's ends held."""
    if isinstance(engine, Propeller):
        eta = np.interp(speed, engine.speeds, engine.efficiency) if engine.speeds else engine.efficiency[0]
        return "shaft_power", np.maximum(thrust * speed / eta, 0.0)
    v = np.clip(speed, engine.speeds[0], engine.speeds[-1])
    h = np.clip(altitude, engine.altitudes[0], engine.altitudes[-1])
    planes = np.array(engine.thrust)
    if len(engine.altitudes) == 1:
        given = [np.interp(v, engine.speeds, plane[0]) for plane in planes]
    else:
        from scipy.interpolate import RegularGridInterpolator

        at = np.column_stack([h, v])
        given = [np.asarray(RegularGridInterpolator((engine.altitudes, engine.speeds), plane)(at)) for plane in planes]
    known = np.array(given)
    below = np.clip((known <= thrust).sum(axis=0) - 1, 0, len(known) - 2)
    each = np.arange(len(thrust))
    low, high = known[below, each], known[below + 1, each]
    share = np.clip((thrust - low) / np.maximum(high - low, 1e-9), 0.0, 1.0)
    settings = np.array(engine.settings)
    return engine.signal, settings[below] + share * (settings[below + 1] - settings[below])
