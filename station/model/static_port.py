"""Position error of the static port, apart from the pitot's: static pressure over GNSS altitude, by dynamic pressure.

    p shown = p0 exp(-g (h - h0)/(R (T0 + T(h))/2)) + k q + e(t)

The day's pressure p0 is unknown, and walks with the weather and the way flown; k, the error over the dynamic pressure,
shows as the speed changes. q is what the port meets, gusts included: of a speed over the ground less the mean wind it
would have errors, and k would come out small by their share. T(h) is the straight line through the measured
temperatures, which are wrong by an error of their own and make heights wrong by as much. e is white
noise, a process of SLOW_S for the wander of GNSS heights, and the walk, whose variances are the restricted maximum
likelihood's. An error of the pitot is in the airspeed and not here: with q shown = (1 + s) q, the total pressure is
wrong by (s + k) q. SI.

Sources: Gracey 1980, NASA RP-1046 (position error, tracked altitude methods); Haering 1990, NASA TM-104240;
Patterson and Thompson 1971 (restricted likelihood).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from station.conventions import G0, GAS_CONSTANT
from station.numerics.regression import NotIdentifiable

Array = NDArray[np.float64]

SLOW_S: Final = 60.0
TEMPERATURE_ERROR: Final = 0.01
"""Of the measured temperature, relative: 3 K, by radiation and friction."""
LEAST: Final = 10
"""Blocks."""
LEAST_SPAN: Final = 0.3
"""Of the dynamic pressure, between its slow and its fast blocks over its mean: below, the day's pressure and the error
are one. A tenth of the speed either way."""
_LOWEST: Final = 0.1
"""Pa: least standard deviation of a part of what is left."""
_STARTS: Final = ((3.0, 5.0, 0.5), (1.0, 0.3, 0.05))
"""Pa, Pa, and Pa per root of a second: a sensor's, a metre of height in half, 1 hPa in three hours; and of good
instruments in calm air. The likelihood may have a minimum each."""


@dataclass(frozen=True, slots=True)
class StaticPort:
    """What was found; (n,) blocks beside, for a picture."""

    error: float
    """k, over the dynamic pressure."""
    sd: float
    dynamic_pressure: Array
    shown_less: Array
    """Static pressure shown less that of the height and the day, Pa."""


def static_port(time: Array, static: Array, altitude: Array, temperature: Array, dynamic_pressure: Array) -> StaticPort:
    """From block means (n,): s, Pa, m, K and the dynamic pressure of the air met, Pa. Raises NotIdentifiable."""
    if len(time) < LEAST:
        raise NotIdentifiable("too short")
    low, high = np.percentile(dynamic_pressure, (5, 95))
    if high - low < LEAST_SPAN * dynamic_pressure.mean():
        raise NotIdentifiable("flown at one speed: the static port's error and the day's pressure cannot be told apart")
    warm, above = float(temperature.mean()), altitude - altitude.mean()
    lapse = float(above @ temperature) / max(float(above @ above), 1.0)
    standard = static.mean() * np.exp(-G0 * above / (GAS_CONSTANT * (warm + 0.5 * lapse * above)))
    y = static - standard
    density = static.mean() / (GAS_CONSTANT * warm)
    x = np.column_stack([np.ones(len(y)), dynamic_pressure, TEMPERATURE_ERROR * G0 * density * above])
    prior = np.diag([0.0, 0.0, 1.0])

    def solved(logs: Array) -> tuple[float, Array, Array]:
        root = cho_factor(_covariance(time, np.exp(logs)), lower=True)
        white = cho_solve(root, np.column_stack((x, y)))
        seen = prior + x.T @ white[:, :-1]
        found = np.linalg.solve(seen, x.T @ white[:, -1])
        left = float(y @ white[:, -1]) - float((x.T @ white[:, -1]) @ found)
        volume = 2 * float(np.log(np.diag(root[0])).sum()) + float(np.linalg.slogdet(seen)[1])
        return 0.5 * (left + volume), found, np.asarray(np.linalg.inv(seen))

    low_logs = np.log(_LOWEST) * np.array([1.0, 1.0, 2.0])
    tried = [
        minimize(
            lambda logs: solved(np.maximum(logs, low_logs))[0],
            np.log(start),
            method="Nelder-Mead",
            options={"xatol": 0.1, "fatol": 0.05},
        )
        for start in _STARTS
    ]
    best = min(tried, key=lambda r: float(r.fun))
    _, found, spread = solved(np.maximum(best.x, low_logs))
    less = y - x[:, 0] * found[0] - x[:, 2] * found[2]
    return StaticPort(float(found[1]), float(np.sqrt(spread[1, 1])), dynamic_pressure, less)


def _covariance(time: Array, parts: Array) -> Array:
    """(n, n) of white noise, a slow process and a walk from the first block on."""
    apart = np.abs(time[:, None] - time)
    since = np.minimum(time[:, None], time) - time[0]
    made = parts[1] ** 2 * np.exp(-apart / SLOW_S) + parts[2] ** 2 * since
    made[np.diag_indices(len(time))] += parts[0] ** 2
    return np.asarray(made)
