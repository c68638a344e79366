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

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from station.diagnosis.processing import (
    HIGH_HZ,
    LOW_HZ,
    AirShare,
    Setting,
    Share,
    back,
    slow_spectrum,
    transform,
    without_line,
)

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

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


class NoiseOf(NamedTuple):
    """Variances of a sensor's noise."""

    white: float
    slow: float
    """Of correlation time SLOW_S."""


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
    Unseen. Beyond the motion both show the same air: were each smoothed by its own noise, what one loses of a gust
    would be in step with what the other shows of it, and a gust would seem to turn the flow by less than it does."""
    if s.air_share is None:
        return airspeed, pressure
    speeds = {"airspeed": airspeed, "dynamic_pressure": np.sqrt(np.maximum(pressure, 0.0))}
    shares, moved, rest = s.air_share.at(s.omega / (2 * np.pi), noise), 0.0, {}
    for name, share in zip(s.air_share.sensors, shares, strict=True):
        shown = speeds[name] / own
        mean = shown.mean(-1, keepdims=True)
        level = _level(shown / mean, s)
        moved = moved + share * transform(level, s)
        rest[name] = mean, shown / mean - level
    air = back(np.asarray(moved), s)
    speeds |= {name: own * mean * (line + air) for name, (mean, line) in rest.items()}
    return speeds["airspeed"], speeds["dynamic_pressure"] ** 2


def own_motion(airspeed: Array, along: Array, down: Array, s: Setting) -> Array:
    """The speed (..., n) on the path about the mean airspeed, by the integral of the horizontal acceleration and the
    vertical speed, m/s."""
    mean = airspeed.mean(-1, keepdims=True)
    path = np.hypot(np.maximum(mean + _level(along, s), SLOWEST * mean), down)
    return np.asarray(path + mean - path.mean(-1, keepdims=True))


def _level(x: Array, s: Setting) -> Array:
    """Without its line; a periodic series without its mean."""
    return without_line(x) if s.bridge else x - x.mean(-1, keepdims=True)


def air_share(shown: Mapping[str, Array], dt: float, alike: NoiseOf, alone: Mapping[str, NoiseOf]) -> AirShare:
    """How much of each series (n,) `shown`, an airspeed over its mean and over the motion's, `dt` s apart, is taken for
    what the air did; below the frequencies judged, all of their weighted mean. Of the slow noise that they show `alike`
    no more is assumed than the spectrum shows above QUIET_HZ; what each shows `alone` is as given."""
    lines = {}
    for name, x in shown.items():
        f, lines[name] = _lines(x, dt)
    shape = slow_spectrum(f, dt)
    own = np.stack([(np.full(len(f), alone[n].white), alone[n].slow * shape) for n in shown], axis=1)
    together = 1 / (1 / own.sum(0)).sum(0)
    power = np.abs(sum(together / own.sum(0)[k] * y for k, y in enumerate(lines.values()))) ** 2
    quiet = np.where((f > QUIET_HZ) & (f < HIGH_HZ), shape, 0.0)
    seen = float(quiet @ (power - alike.white - together)) / max(float(quiet @ quiet), 1e-30)
    both = np.stack([np.full(len(f), alike.white), min(max(seen, 0.0), alike.slow) * shape])
    noise = both.sum(0) + together
    spectrum = np.maximum(noise + _continued(f, smoothed(f, power) - noise, noise), 1e-30)
    return AirShare(tuple(shown), f, np.where(f >= LOW_HZ, spectrum, np.inf), both, own)


def share_beyond(x: Array, dt: float, frequencies: Array, noise: Array) -> Share:
    """The share of the spectrum of a series (n,), `dt` s apart, that is no noise; 1 below the frequencies judged.
    `noise`: its spectrum at `frequencies`, Hz, between which it is straight."""
    f, lines = _lines(x, dt)
    known = np.interp(f, frequencies, noise)
    spectrum = known + _continued(f, smoothed(f, np.abs(lines) ** 2) - known, known)
    return Share(f, known * (f >= LOW_HZ) / np.maximum(spectrum, 1e-30))


def _lines(x: Array, dt: float) -> tuple[Array, Complex]:
    """Frequencies, Hz, and the lines of a series (n,) there, whose squares are 1 of white noise of variance 1."""
    n = len(x)
    window = signal.windows.hann(n, sym=False)
    return fft.rfftfreq(n, dt)[1:], fft.rfft(signal.detrend(x) * window)[1:] / np.sqrt(window @ window)


def spectrum(x: Array, dt: float) -> tuple[Array, Array]:
    """Frequencies, Hz, and the spectrum of a series (n,) there: 1 of white noise of variance 1."""
    f, lines = _lines(x, dt)
    return f, np.abs(lines) ** 2


def smoothed(f: Array, power: Array) -> Array:
    """A spectrum (n,) smoothed: the mean of the neighbours, tilted by the power of the frequency by which they fall
    (prewhitening: Blackman and Tukey 1958, The Measurement of Power Spectra). A gust's falls so steeply that the mean
    as it is lies above it."""
    log, height = np.log(f), np.log(np.maximum(power, 1e-300))
    near = np.exp(-0.5 * np.square((f[:, None] - f) / np.hypot(SMOOTHED * f, f[0])[:, None]))
    near /= near.sum(1, keepdims=True)
    middle = near @ log
    slope = (near @ (log * height) - middle * (near @ height)) / (near @ log**2 - middle**2)
    return np.asarray((near * np.exp(slope[:, None] * (log[:, None] - log))) @ power)


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
