"""Turbulence level: standard deviation of the vertical gust at the vane between 2 and 7 Hz, and its class.

The gust is what the vane shows beyond the motion (alpha.py), times the airspeed, so an elevator input does not read as
turbulence. Classes for MIL-F-8785C Dryden gusts of L = 1750 ft seen through a 9 Hz vane with 0.05 deg of noise, at 110
kt: calm below 0.15 ft/s, light below 0.75, moderate below 1.5, severe above. The same gusts are met faster at a higher
speed, so that the band has more of them, and noise of an angle is more of a speed: the limits go with both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

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
NOMINAL_SPEED: Final = to_si(110, "kt")
NOISE_SHARE: Final = 2.0 * (HIGH_HZ - LOW_HZ)
"""Of white noise sampled every dt seconds, the share of the variance that is in the band, over dt."""
TURBULENCE_LENGTH: Final = to_si(1750, "ft")
"""L of MIL-F-8785C above 2000 ft, m: integral scale of gusts along the path L, of vertical ones L/2."""
IN_BAND: Final = 0.0759
"""Standard deviation of Dryden gusts of that length in the band over that of all, at NOMINAL_SPEED."""
BOUND: Final = 1.2
"""What a gust is taken to be where it must not be taken for too little, over what `gust_sigma` gives."""
CLASSES: Final = ("calm", "light", "moderate", "severe")


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Upper ends of calm, light and moderate: standard deviation in 2-7 Hz at the vane, m/s.

    They scale with the turbulence length: L = 1000 ft raises the level of the same gusts by 32 %.
    """

    calm: float = to_si(0.15, "ft/s")
    light: float = to_si(0.75, "ft/s")
    moderate: float = to_si(1.5, "ft/s")

    def at(self, speed: float, noise: float, dt: float) -> tuple[float, float, float]:
        """The three at a true airspeed (m/s), with a vane's noise (rad): a quieter one than the nominal is taken for
        it."""
        nominal = NOISE_SHARE * dt * (NOMINAL_SPEED * NOMINAL_NOISE) ** 2
        own = NOISE_SHARE * dt * (speed * max(noise, NOMINAL_NOISE)) ** 2
        met = speed / NOMINAL_SPEED
        calm, light, moderate = (
            math.sqrt(max(limit**2 - nominal, 0.0) * met + own) for limit in (self.calm, self.light, self.moderate)
        )
        return calm, light, moderate


def classified(level: float, speed: float, noise: float, dt: float, thresholds: Thresholds | None = None) -> str:
    """One of CLASSES for a level, m/s, at a true airspeed, with a vane's noise, rad."""
    return CLASSES[sum(level >= limit for limit in (thresholds or Thresholds()).at(speed, noise, dt))]


def in_band(speed: float) -> float:
    """Standard deviation of Dryden gusts in the band over that of all, at a true airspeed, m/s: their spectrum above
    V/L goes with V."""
    return IN_BAND * math.sqrt(max(speed, 1.0) / NOMINAL_SPEED)


def gust_sigma(level: float, speed: float, noise: float, dt: float) -> float:
    """Standard deviation of all of the vertical gust, m/s, from its level in the band with a vane's noise (rad) in
    it."""
    return math.sqrt(max(level**2 - NOISE_SHARE * dt * (noise * speed) ** 2, 0.0)) / in_band(speed)


@njit(cache=True)
def step(sos: Array, z: Array, squares: Array, sums: Array, past: Array, gust: float) -> None:
    """One tick of the vertical gust at the vane, m/s: the sums of `squares` in the band, and of its second difference
    over half of `past`.

    Edits `z` (sections, 2), `squares` (2, window), `sums` (3,) with the count first, and `past` (2 n,) of gusts.
    """
    x = gust
    for k in range(sos.shape[0]):
        y = sos[k, 0] * x + z[k, 0]
        z[k, 0] = sos[k, 1] * x - sos[k, 4] * y + z[k, 1]
        z[k, 1] = sos[k, 2] * x - sos[k, 5] * y
        x = y
    count = int(sums[0])
    n = past.shape[0] // 2
    old = count % (2 * n)
    second = gust - 2.0 * past[(count + n) % (2 * n)] + past[old] if count >= 2 * n else 0.0
    past[old] = gust
    at = count % squares.shape[1]
    for i, new in enumerate((x * x, second * second)):
        sums[1 + i] += new - squares[i, at]
        squares[i, at] = new
    sums[0] += 1.0


class Sharp(NamedTuple):
    """What second differences over so many ticks show, over variances in the ticks: of gusts (those in the band) and of
    white noise."""

    ticks_apart: int
    gusts: float
    white: float


FRESH: Final = Sharp(1, 0.0, 6.0)
"""Of ticks that have a measurement each, gusts left out."""


class Turbulence:
    """Running level and class, and what of it is noise. What a vane's `noise` (rad) adds is not called turbulence.

    `level`, `gust` and `noise_shown` in m/s, NaN before the filter has settled: standard deviations in the band of all
    that is there, of gusts alone, and of the noise of each tick, told by what is sharper than gusts are.
    """

    def __init__(
        self,
        dt: float,
        noise: float,
        thresholds: Thresholds | None = None,
        sharp: Sharp = FRESH,
        sees_band: bool = True,
    ) -> None:
        """Without `sees_band`, of a record too slow for it, level and class stay unknown, and of what is sharper than
        the noise that is stated all is gusts."""
        self._sos = butter(4, [LOW_HZ, HIGH_HZ], "bandpass", fs=1.0 / dt, output="sos")
        self._z = np.zeros((len(self._sos), 2))
        self._squares = np.zeros((2, round(WINDOW_S / dt)))
        self._sums = np.zeros(3)
        self._past = np.zeros(2 * sharp.ticks_apart)
        self._settled = round(SETTLED_S / dt)
        self._thresholds = thresholds or Thresholds()
        self._noise, self._dt, self._sharp, self._sees_band = noise, dt, sharp, sees_band
        self._is_gust, self._start = True, 0.0
        self.level = self.gust = self.noise_shown = math.nan
        self.name = "unknown"

    def restart(self) -> None:
        """Let the filter settle anew."""
        for of in (self._z, self._squares, self._sums, self._past):
            of[:] = 0.0
        self.level = self.gust = self.noise_shown = math.nan
        self.name = "unknown"

    def step(self, angle: float, speed: float, is_gust: bool = True) -> None:
        """One tick: the gust's incidence at the vane, rad, and the true airspeed, m/s.

        Without inertial data all of the vane's angle has to do, `is_gust` false; a change of kind starts anew.
        """
        if self._sums[0] > 0 and is_gust != self._is_gust:
            self.restart()
        if self._sums[0] == 0:
            self._is_gust, self._start = is_gust, angle
        step(self._sos, self._z, self._squares, self._sums, self._past, (angle - self._start) * speed)
        count, *sums = self._sums.tolist()
        if count < self._settled:
            return
        band, second = (max(x, 0.0) / min(count, self._squares.shape[1]) for x in sums)
        _, sharp, white = self._sharp
        if not self._sees_band:
            self.gust = math.sqrt(max(second - white * (self._noise * speed) ** 2, 0.0) / sharp)
            return
        self.level = math.sqrt(band)
        self.name = classified(self.level, speed, self._noise, self._dt, self._thresholds)
        # Gusts and white noise, each by its share of both.
        share = NOISE_SHARE * self._dt / white
        gust = max((band - share * second) / (1.0 - share * sharp), 0.0)
        self.gust = math.sqrt(gust)
        self.noise_shown = math.sqrt(max(second - sharp * gust, 0.0) / white)
