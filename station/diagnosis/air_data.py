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

SMOOTHED: Final = 0.2
"""Standard deviation of the window that smooths the spectrum, as a share of the frequency, and a line at least: by it
W comes nearest to what it is, of a minute of autoregressions in white noise; by wider ones knees are cut off."""
QUIET_HZ: Final = 1.0
"""Above it an aircraft's speed does not change in calm air: what is seen there is noise, or gusts."""
CONTINUED: Final = 2.0
"""Ratio of the frequencies between which the power is fitted by which a spectrum falls: an octave."""
GENTLEST: Final = -5 / 3
"""The power by which gusts fall (Kolmogorov 1941); what lags falls faster."""
SLOWEST: Final = 0.5
"""Of the mean airspeed: below it, what the accelerations say is an error of theirs."""


class Unseen(NamedTuple):
    """Of a manoeuvre's air and its sensors, what no instrument shows."""

    along: float = 0.0
    """m/s. How much faster the aircraft moves through it than its mean airspeed says."""
    up: float = 0.0
    """m/s. A mean updraught, which hides in the vane's mean as its zero does. Its angle follows the airspeed."""
    noise: float = 0.0
    """Logarithm of the variance of the air data's slow noise over that assumed. The accelerations tell it, which follow
    the air and not the noise; were it taken for known, a lag of the air data would be off by as much as W is."""


STILL: Final = Unseen()
"""Still air, and noise as assumed."""


def air_data(airspeed: Array, pressure: Array, own: Array, s: Setting, noise: float = 0.0) -> tuple[Array, Array]:
    """Airspeed (..., n), m/s, and dynamic pressure, Pa, smoothed about the speed of the `own_motion`; `noise`: see
    Unseen."""
    if s.airspeed_share is not None:
        airspeed = own + _passed(airspeed - own, s.airspeed_share, s, noise)
    if s.pressure_share is not None:
        pressure = own**2 * _passed(pressure / own**2, s.pressure_share, s, noise)
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


def _passed(x: Array, share: Share, s: Setting, noise: float) -> Array:
    level = _level(x, s)
    return x - level + back(transform(level, s) * share.at(s.omega / (2 * np.pi), noise), s)


def share_of(x: Array, dt: float, white: float, slow: float) -> Share:
    """The share of the spectrum of a series (n,), `dt` s apart, that is no noise; 1 below the frequencies judged.

    `white`, `slow`: variances of the noise, the second of correlation time SLOW_S. Of the slow, no more is assumed than
    the spectrum shows above QUIET_HZ."""
    f, power, shown = _spectrum(x, dt)
    shape = slow_spectrum(f, dt)
    quiet = np.where((f > QUIET_HZ) & (f < HIGH_HZ), shape, 0.0)
    seen = float(quiet @ (power - white)) / max(float(quiet @ quiet), 1e-30)
    return _beyond(f, shown, white, min(max(seen, 0.0), slow) * shape)


def share_beyond(x: Array, dt: float, frequencies: Array, noise: Array) -> Share:
    """The same where the spectrum of the noise is known at some frequencies, Hz."""
    f, _, shown = _spectrum(x, dt)
    return _beyond(f, shown, np.interp(f, frequencies, noise))


def _spectrum(x: Array, dt: float) -> tuple[Array, Array, Array]:
    """Frequencies, Hz, the spectrum of a series (n,), which is 1 of white noise of variance 1, and that smoothed: the
    mean of the neighbours, tilted by the power of the frequency by which they fall (prewhitening: Blackman and Tukey
    1958, The Measurement of Power Spectra). A gust's falls so steeply that the mean as it is lies above it."""
    n = len(x)
    window = signal.windows.hann(n, sym=False)
    power = np.abs(fft.rfft(signal.detrend(x) * window)[1:]) ** 2 / (window @ window)
    f = fft.rfftfreq(n, dt)[1:]
    log, height = np.log(f), np.log(np.maximum(power, 1e-300))
    near = np.exp(-0.5 * np.square((f[:, None] - f) / np.hypot(SMOOTHED * f, f[0])[:, None]))
    near /= near.sum(1, keepdims=True)
    middle = near @ log
    slope = (near @ (log * height) - middle * (near @ height)) / (near @ log**2 - middle**2)
    return f, power, (near * np.exp(slope[:, None] * (log[:, None] - log))) @ power


def _beyond(f: Array, shown: Array, known: Array | float, slow: Array | float = 0.0) -> Share:
    noise = known + slow
    judged = (f >= LOW_HZ) / np.maximum(noise + _continued(f, shown - noise, noise), 1e-30)
    return Share(f, known * judged, slow * judged)


def _continued(f: Array, beyond: Array, noise: Array | float) -> Array:
    """(n,) the spectrum of the air, of what is shown `beyond` the noise. Above the last frequency where that is more
    than the noise, it goes on falling by the power of the frequency by which it fell up to there: further up the
    difference of two spectra is chance, and where that is nothing the air would be taken to stand still."""
    told = np.flatnonzero((f >= LOW_HZ) & (beyond > noise))
    if not len(told):
        return beyond
    last = told[-1]
    near = (f >= f[last] / CONTINUED) & (f <= f[last]) & (beyond > 0)
    log, height = np.log(f[near] / f[last]), np.log(beyond[near])
    slope = float(log @ (height - height[-1]) / max(float(log @ log), 1e-30)) if len(log) > 1 else GENTLEST
    tail = beyond[last] * (f / f[last]) ** min(slope, GENTLEST)
    return np.where(f > f[last], tail, beyond)
