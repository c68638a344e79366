"""What a vane's own dynamics make of gusts, over what they show of them in the band where turbulence is judged.

Far above the corner V/L gusts' energy falls with the square of frequency: Dryden's, MIL-F-8785C 3.7.1.2.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from station.numerics.second_order import second_order_response, vane_lag
from station.numerics.turbulence import HIGH_HZ, LOW_HZ

Array = NDArray[np.floating[Any]]

_F: Final = np.geomspace(0.02, 2000.0, 601)
"""Hz: from the corner on, to where nothing is left."""
_ENERGY: Final = np.gradient(_F) / _F**2
_BAND: Final = (_F > LOW_HZ) & (_F < HIGH_HZ)
_S: Final = 2j * math.pi * _F
_DRAWN: Final = ((-math.sqrt(3.0), 1 / 6), (0.0, 2 / 3), (math.sqrt(3.0), 1 / 6))
"""Standard deviations and weights by which a Gaussian's mean is taken: Gauss and Hermite's three."""
_LEAST_DAMPING: Final = 0.05


@dataclass(frozen=True, slots=True)
class Shown:
    """A vane as it is recorded: natural frequency (Hz) and damping ratio; `every` s, if seldomer than ticks come, which
    lie on a cubic spline then (0: each tick has its own)."""

    frequency: float
    damping: float
    every: float = 0.0

    @property
    def white(self) -> float:
        """Mean square of the second difference of a recorder's white noise, over its variance in the ticks."""
        theta = np.linspace(0.0, 2 * math.pi, 256, endpoint=False)
        power = _splined(theta) if self.every else np.ones(len(theta))
        return float(((2.0 * np.sin(0.5 * theta)) ** 4 * power).mean() / power.mean())

    @lru_cache(maxsize=64)  # noqa: B019 - frozen, and few
    def sharpness(self, apart: float) -> float:
        """Mean square of the second difference of gusts, over ticks `apart` s apart, over their mean square in the
        band."""
        twice = (2.0 * np.sin(0.5 * _S.imag * apart)) ** 4
        shown = np.abs(second_order_response(self.frequency, self.damping, _S)) ** 2 * _splined(_S.imag * self.every)
        return float((shown * twice * _ENERGY).sum()) / self._in_band

    @lru_cache(maxsize=1024)  # noqa: B019
    def left(self, late: float, late_sd: float, dynamics_sd: tuple[float, float]) -> float:
        """Rms by which gusts, as shown and moved by the vane's lag, differ from what they are, `late` s late (negative:
        early), over their rms in the band.

        `late_sd` (s) and `dynamics_sd` (of frequency and damping, shares of them): how well all that is known.
        """
        moved = np.exp(_S * (vane_lag(self.frequency, self.damping) - late))
        theta = _S.imag * self.every
        power = _splined(theta)
        # Of a Gaussian delay's mean, and of a wave of its own frequency on the spline.
        known = np.exp(-0.5 * (_S.imag * late_sd) ** 2) * np.sinc(_F * self.every) ** 4 * 3.0 / (2.0 + np.cos(theta))
        energy = 0.0
        for (x, weight), (y, other) in itertools.product(_DRAWN, repeat=2):
            damping = max(self.damping * (1 + dynamics_sd[1] * y), _LEAST_DAMPING)
            shown = moved * second_order_response(self.frequency * (1 + dynamics_sd[0] * x), damping, _S)
            off = 1.0 + np.abs(shown) ** 2 * power - 2.0 * shown.real * known
            energy += weight * other * float((off * _ENERGY).sum())
        return math.sqrt(energy / self._in_band)

    @property
    def _in_band(self) -> float:
        """Energy of the gusts in the band that the vane shows."""
        shown = np.abs(second_order_response(self.frequency, self.damping, _S[_BAND])) ** 2
        return float((shown * _ENERGY[_BAND]).sum())


def _splined(theta: Array) -> Array:
    """Energy of the cubic spline through samples of a wave that turns by `theta` from one to the next, over the wave's,
    on average over a spacing: the sampled autocorrelation of the cubic B-spline over the square of its samples (Unser
    1999, IEEE Signal Processing Magazine 16(6))."""
    waves = 2416.0 + 2382.0 * np.cos(theta) + 240.0 * np.cos(2 * theta) + 2.0 * np.cos(3 * theta)
    return np.asarray(waves / 5040.0 * 9.0 / (2.0 + np.cos(theta)) ** 2)
