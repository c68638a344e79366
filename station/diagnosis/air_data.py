"""Airspeed, dynamic pressure and the gust at the vane, smoothed as far as their own spectra say that they show noise.

They are inputs of the coefficients, with no equation of their own. Taken as they are, what a candidate undoes (a lag)
raises their noise in the coefficients, and predicts worse whether it is there or not. Motion along the path is told by
the accelerations; of what the air data show beyond it, the mean of what the air did keeps of each frequency the share
W = (P - n) / P of the spectrum P that is no noise n, and what is not known of it has the variance W n (Wiener 1949,
Extrapolation, Interpolation, and Smoothing of Stationary Time Series). W is of what was shown, and so the same for all
candidates.

The gust has a series of its own, the vane's. Feeding lift and moment with a share of it only combines the same series
anew: no candidate is likelier for it. But slopes are made of what is fed: of the whole, in calm air they would tell how
the wing follows gusts, by nothing but the vane's noise.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from station.diagnosis.processing import (
    HIGH_HZ,
    LOW_HZ,
    Setting,
    Share,
    back,
    slow_spectrum,
    transform,
    without_line,
)

Array = NDArray[np.float64]

SMOOTHED: Final = 0.12
"""Standard deviation of the window that smooths the spectrum, as a share of the frequency, and a line at least: at 1 Hz
the level is known to a quarter in half a minute, and a peak keeps its place."""
QUIET_HZ: Final = 1.0
"""Above it an aircraft's speed does not change in calm air: what is seen there is noise, or gusts."""
SLOWEST: Final = 0.5
"""Of the mean airspeed: below it, what the accelerations say is an error of theirs."""
LEAST_SHARE: Final = 1e-4
"""That its root can be divided by: a hundredth of the noise is left."""


class Lasting(NamedTuple):
    """Air that moves as long as the manoeuvre lasts, m/s."""

    along: float = 0.0
    """How much faster the aircraft moves through it than its mean airspeed says."""
    up: float = 0.0
    """A mean updraught, which hides in the vane's mean as its zero does. Its angle follows the airspeed."""


STILL: Final = Lasting()


def air_data(airspeed: Array, pressure: Array, own: Array, s: Setting) -> tuple[Array, Array]:
    """Airspeed (..., n), m/s, and dynamic pressure, Pa, smoothed about the speed of the `own_motion`."""
    if s.airspeed_share is not None:
        airspeed = own + _passed(airspeed - own, s.airspeed_share, s)
    if s.pressure_share is not None:
        pressure = own**2 * _passed(pressure / own**2, s.pressure_share, s)
    return airspeed, pressure


def own_motion(airspeed: Array, along: Array, down: Array, s: Setting) -> Array:
    """The speed (..., n) on the path about the mean airspeed, by the integral of the horizontal acceleration and the
    vertical speed, m/s."""
    mean = airspeed.mean(-1, keepdims=True)
    path = np.hypot(np.maximum(mean + _level(along, s), SLOWEST * mean), down)
    return np.asarray(path + mean - path.mean(-1, keepdims=True))


def _level(x: Array, s: Setting) -> Array:
    """Without its line; a periodic series without its mean."""
    return without_line(x) if s.bridge else x - x.mean(-1, keepdims=True)


def _passed(x: Array, share: Share, s: Setting) -> Array:
    level = _level(x, s)
    return x - level + back(transform(level, s) * share.at(s.omega / (2 * np.pi)), s)


def share_of(x: Array, dt: float, white: float, slow: float) -> Share:
    """The share of the spectrum of a series (n,), `dt` s apart, that is no noise; 1 below the frequencies judged.

    `white`, `slow`: variances of the noise, the second of correlation time SLOW_S. Of the slow, no more is assumed than
    the spectrum shows above QUIET_HZ."""
    f, power, shown = _spectrum(x, dt)
    shape = slow_spectrum(f, dt)
    quiet = np.where((f > QUIET_HZ) & (f < HIGH_HZ), shape, 0.0)
    seen = float(quiet @ (power - white)) / max(float(quiet @ quiet), 1e-30)
    return _beyond(f, white + min(max(seen, 0.0), slow) * shape, shown)


def share_beyond(x: Array, dt: float, frequencies: Array, noise: Array) -> Share:
    """The same where the spectrum of the noise is known at some frequencies, Hz."""
    f, _, shown = _spectrum(x, dt)
    return _beyond(f, np.interp(f, frequencies, noise), shown)


def _spectrum(x: Array, dt: float) -> tuple[Array, Array, Array]:
    """Frequencies, Hz, the spectrum of a series (n,), which is 1 of white noise of variance 1, and that smoothed."""
    n = len(x)
    window = signal.windows.hann(n, sym=False)
    power = np.abs(fft.rfft(signal.detrend(x) * window)[1:]) ** 2 / (window @ window)
    f = fft.rfftfreq(n, dt)[1:]
    near = np.exp(-0.5 * np.square((f[:, None] - f) / np.hypot(SMOOTHED * f, f[0])[:, None]))
    return f, power, near @ power / near.sum(1)


def _beyond(f: Array, noise: Array, shown: Array) -> Share:
    share = np.clip(1 - noise / np.maximum(shown, 1e-30), LEAST_SHARE, 1.0)
    return Share(f, np.where(f < LOW_HZ, 1.0, share))
