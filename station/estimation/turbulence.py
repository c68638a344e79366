"""Turbulence level: standard deviation of the vertical gust at the vane between 2 and 7 Hz, and its class.

The gust is what the vane shows beyond the motion (alpha.py), times the airspeed, so an elevator input does not read as
turbulence. Classes for MIL-F-8785C Dryden gusts of L = 1750 ft seen through a 9 Hz vane with 0.05 deg
of noise: calm below 0.15 ft/s, light below 0.75, moderate below 1.5, severe above.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import butter

from station.conventions import to_si

Array = NDArray[np.float64]

WINDOW_S: Final = 10.0
SETTLED_S: Final = 4.0
LOW_HZ: Final = 2.0
HIGH_HZ: Final = 7.0
NOMINAL_NOISE: Final = to_si(0.05, "deg")
CLASSES: Final = ("calm", "light", "moderate", "severe")


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Upper ends of calm, light and moderate: standard deviation in 2-7 Hz at the vane, m/s.

    They scale with the turbulence length: L = 1000 ft raises the level of the same gusts by 32 %.
    """

    calm: float = to_si(0.15, "ft/s")
    light: float = to_si(0.75, "ft/s")
    moderate: float = to_si(1.5, "ft/s")


@njit(cache=True)
def step(sos: Array, z: Array, ring: Array, state: Array, gust: float) -> float:
    """One tick of the vertical gust at the vane, m/s -> its running standard deviation in the band, m/s.

    Edits `z` (sections, 2), `ring` (window,) of squares, `state` (count, sum).
    """
    x = gust
    for k in range(sos.shape[0]):
        y = sos[k, 0] * x + z[k, 0]
        z[k, 0] = sos[k, 1] * x - sos[k, 4] * y + z[k, 1]
        z[k, 1] = sos[k, 2] * x - sos[k, 5] * y
        x = y
    at = int(state[0]) % ring.shape[0]
    state[1] += x * x - ring[at]
    ring[at] = x * x
    state[0] += 1.0
    return math.sqrt(max(state[1], 0.0) / min(state[0], ring.shape[0]))


class Turbulence:
    """Running level and class. `noise`: the vane's, rad; what it adds beyond 0.05 deg is not called turbulence."""

    def __init__(self, dt: float, noise: float, thresholds: Thresholds | None = None) -> None:
        self._sos = butter(4, [LOW_HZ, HIGH_HZ], "bandpass", fs=1.0 / dt, output="sos")
        self._z = np.zeros((len(self._sos), 2))
        self._ring = np.zeros(round(WINDOW_S / dt))
        self._state = np.zeros(2)
        self._settled = round(SETTLED_S / dt)
        self._thresholds = thresholds or Thresholds()
        # White noise leaves the share of the band in the Nyquist range; what is beyond the nominal widens calm.
        share = 2.0 * dt * (HIGH_HZ - LOW_HZ)
        self._excess = share * max(noise**2 - NOMINAL_NOISE**2, 0.0)
        self._is_gust, self._start = True, 0.0
        self.level = math.nan
        self.name = "unknown"

    def restart(self) -> None:
        """Let the filter settle anew."""
        self._z[:] = 0.0
        self._ring[:] = 0.0
        self._state[:] = 0.0
        self.level, self.name = math.nan, "unknown"

    def step(self, angle: float, speed: float, is_gust: bool = True) -> None:
        """One tick: the gust's incidence at the vane, rad, and the true airspeed, m/s.

        Without inertial data all of the vane's angle has to do, `is_gust` false; a change of kind starts anew.
        """
        if self._state[0] > 0 and is_gust != self._is_gust:
            self.restart()
        if self._state[0] == 0:
            self._is_gust, self._start = is_gust, angle
        level = step(self._sos, self._z, self._ring, self._state, (angle - self._start) * speed)
        if self._state[0] < self._settled:
            return
        self.level = level
        clean = math.sqrt(max(level**2 - self._excess * speed**2, 0.0))
        limits = self._thresholds
        index = (clean >= limits.calm) + (clean >= limits.light) + (clean >= limits.moderate)
        self.name = CLASSES[index]
