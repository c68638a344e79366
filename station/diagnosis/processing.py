"""How a manoeuvre's series are processed: filters by Fourier transform, and the path in place of time.

All functions take leading axes: series of (..., n).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import fft

from station.numerics.lagrange import quintic

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

LOW_HZ: Final = 0.1
HIGH_HZ: Final = 3.0
OF_RATE: Final = 0.15
"""Of the sampling rate, up to which is judged: a signal that nothing filters before it is sampled shows there what it
has at six times the frequency too, of a gust a twentieth of the power. Of 20 flights of the second simulation at 10 Hz
n/alpha was 4.8, 4.4, 3.7 and 2.8 % off (rms) when judged up to 0.35, 0.25, 0.2 and 0.15 of it."""
CUT_S: Final = 2.0
BRIDGE_S: Final = 3.6
"""The ends are joined over this time, so that filters by Fourier transform see no step."""
STEP_S: Final = 0.04
"""Between samples, at most where a record has them: four times HIGH_HZ lie below half of that rate. A quintic laid
through them loses 0.1 % at HIGH_HZ."""
THIN_PASS_HZ: Final = (6.0, 12.0)
"""Passed up to the first and stopped from the second where a record is thinned: nothing judged lies between."""
SLOW_S: Final = 0.3
"""Correlation time of the slow part of a sensor's noise."""
LEAST_SHARE: Final = 1e-4
"""That its root can be divided by: a hundredth of the noise is left."""
ALL_NOISE: Final = 30.0
"""Largest logarithm of a noise over that assumed: no signal is left beside it, and exp does not overflow."""
ALIKE: Final = 0.02
"""Of a sample: paths that are no further apart are one."""


@dataclass(frozen=True, slots=True, eq=False)
class Share:
    """The share of a spectrum that is no noise, by frequency."""

    frequencies: Array
    """(n,) Hz."""
    noise: Array
    """(n,) over the spectrum."""

    def at(self, frequencies: Array) -> Array:
        """From LEAST_SHARE to 1, at `frequencies`, Hz."""
        return np.asarray(np.interp(frequencies, self.frequencies, np.clip(1 - self.noise, LEAST_SHARE, 1.0)))


@dataclass(frozen=True, slots=True, eq=False)
class AirShare:
    """How much of what each sensor of the airspeed shows is taken for what the air did, by frequency. Variances are
    relative, of the airspeed; spectra are 1 of white noise of variance 1."""

    sensors: tuple[str, ...]
    frequencies: Array
    """(n,) Hz."""
    shown: Array
    """(n,) spectrum of all sensors together, each by its weight; infinite where nothing is taken out."""
    alike: Array
    """(2, n) spectra of the noise that they show alike: of known size, and slow of the size assumed."""
    alone: Array
    """(2, sensors, n) of what each shows alone."""

    def at(self, frequencies: Array, noise: float | Array = 0.0) -> Array:
        """(sensors, ..., frequencies) at `frequencies`, Hz: the mean of what the air did, given what all show (Wiener
        1949), which sensors of less noise tell more of. Slow noise has exp(`noise`) times the variance assumed: a
        number, or a column (p, 1)."""
        grown = np.exp(np.minimum(noise, ALL_NOISE))
        known, slow = self.alone.reshape(2, len(self.sensors), *[1] * (np.ndim(grown) - 1), len(self.frequencies))
        own = known + grown * slow
        together = 1 / (1 / own).sum(0)
        rest = np.clip(1 - (self.alike[0] + grown * self.alike[1] + together) / self.shown, LEAST_SHARE, 1.0)
        parts = together / own * rest
        rows = parts.reshape(-1, len(self.frequencies))
        out = np.stack([np.interp(frequencies, self.frequencies, row) for row in rows])
        return np.asarray(out.reshape(*parts.shape[:-1], len(frequencies)))


@dataclass(frozen=True, slots=True)
class Setting:
    """How a manoeuvre is processed."""

    dt: float
    n: int
    bridge: int
    """Samples that join the ends; 0 of periodic signals."""
    judged: tuple[int, ...]
    """The series that can be judged."""
    imu: tuple[float, float, float]
    thrust: float
    """N, where none is measured."""
    elevator_noise: float
    rebuilt: bool
    """The vertical speed is integrated from the accelerations."""
    held: Mapping[str, NDArray[np.int64]]
    """Signals that repeat their values, and the samples at which they are fresh."""
    air_share: AirShare | None = None
    gust_share: Share | None = None
    """What of the airspeed, and of the gust, beyond the motion, is no noise: see air_data; None where taken as it
    is."""
    rest: float | None = 0.0
    """rad of a surface's drive: what moves within it is noise, where a backlash is looked for besides; None: the
    backlash is that width itself, and delays nothing."""
    gust_across: Array | None = None
    """(n,) rad, what the flow at the CG turns by in gusts, as `aircraft` without a candidate's changes shows them: near
    enough for what they make of the airspeed, which is of second order. None: nothing."""

    @property
    def omega(self) -> Array:
        """rad/s of the transform over n + bridge samples."""
        return _omega(self.n + self.bridge, self.dt)

    @property
    def cut(self) -> int:
        return round(min(CUT_S, 0.08 * self.n * self.dt) / self.dt)

    @property
    def bins(self) -> NDArray[np.int64]:
        """Numbers of the frequencies judged, in the transform of the cut series."""
        return _judged(self.n - 2 * self.cut, self.dt)[0]

    @property
    def frequencies(self) -> Array:
        return _judged(self.n - 2 * self.cut, self.dt)[1]


@lru_cache(maxsize=16)
def _omega(n: int, dt: float) -> Array:
    w: Array = 2 * np.pi * fft.rfftfreq(n, dt)
    return w


def highest_hz(dt: float) -> float:
    """Up to which a record with a sample every `dt` s is judged."""
    return min(HIGH_HZ, OF_RATE / dt)


@lru_cache(maxsize=16)
def _judged(n: int, dt: float) -> tuple[NDArray[np.int64], Array]:
    """Numbers and values (Hz) of the frequencies judged."""
    f = fft.rfftfreq(n, dt)
    bins = np.flatnonzero((f >= max(LOW_HZ, 1.5 * f[1]) - 1e-9) & (f <= highest_hz(dt)))
    return bins, f[bins]


def slow_spectrum(frequencies: Array, dt: float) -> Array:
    """Of noise of variance 1 and correlation time SLOW_S, sampled every `dt` s, at frequencies in Hz; 1 is the spectrum
    of white noise of variance 1."""
    decay = math.exp(-dt / SLOW_S)
    return np.asarray((1 - decay**2) / (1 - 2 * decay * np.cos(2 * np.pi * frequencies * dt) + decay**2))


def bridge_of(dt: float, n: int) -> int:
    """Samples from the end back to the start that make the transform's length a fast one."""
    return int(fft.next_fast_len(n + min(round(BRIDGE_S / dt), n // 2), real=True)) - n


def _bridged(x: Array, bridge: int) -> Array:
    """(..., n) -> (..., n + bridge): from the end back to the start along half a cosine."""
    edge = min(5, x.shape[-1])
    end, start = x[..., -edge:].sum(-1, keepdims=True) / edge, x[..., :edge].sum(-1, keepdims=True) / edge
    return np.concatenate([x, end + (start - end) * _half_cosine(bridge)], axis=-1)


@lru_cache(maxsize=16)
def _half_cosine(count: int) -> Array:
    out: Array = 0.5 - 0.5 * np.cos(np.pi * (np.arange(count) + 1) / (count + 1))
    return out


def thinned(x: Array, dt: float, every: int) -> Array:
    """Every so many samples of a series (n,), without what these would fold."""
    kept = math.ceil(len(x) / every)
    joined = _bridged(x, every * (kept + bridge_of(every * dt, kept)) - len(x))
    count = len(joined) // every
    bins = fft.rfft(joined)[: count // 2 + 1]
    bins *= passed(_omega(count, every * dt), THIN_PASS_HZ) / every
    return np.asarray(fft.irfft(bins, count)[:kept])


def transform(x: Array, s: Setting) -> Complex:
    """Transform of a series with its ends joined."""
    out: Complex = fft.rfft(_bridged(x, s.bridge), axis=-1)
    return out


def back(x: Complex, s: Setting) -> Array:
    out: Array = fft.irfft(x, s.n + s.bridge, axis=-1)[..., : s.n]
    return out


def passed(omega: Array, band: tuple[float | Array, float | Array]) -> Array:
    """1 below the first frequency (Hz), 0 above the second, half a cosine between; of columns (..., 1), (..., n)."""
    part = np.clip((omega / (2 * np.pi) - band[0]) / (band[1] - band[0]), 0, 1)
    out: Array = 0.5 + 0.5 * np.cos(np.pi * part)
    return out


def rate(x: Array, s: Setting) -> Array:
    """d/dt of a series, by its transform: at ten samples a second central differences of fourth order lose a tenth at
    2.2 Hz."""
    return back(1j * s.omega * transform(x, s), s)


def integral(x: Array, s: Setting) -> Array:
    """Over time, 0 at the first sample."""
    if not s.bridge:  # periodic but for its mean, and exact at few samples a period
        turned = fft.rfft(x, axis=-1)[..., 1:] / (1j * s.omega[1:])
        swing = fft.irfft(np.concatenate([0 * turned[..., :1], turned], axis=-1), s.n, axis=-1)
        return np.asarray(swing - swing[..., :1] + x.mean(-1, keepdims=True) * s.dt * np.arange(s.n))
    slope = rate(x, s)
    out = np.zeros_like(x)
    np.cumsum(0.5 * s.dt * (x[..., 1:] + x[..., :-1]), axis=-1, out=out[..., 1:])
    # Euler-Maclaurin: the trapezium's error is dt2/12 of the change of slope.
    return out - s.dt**2 / 12 * (slope - slope[..., :1])


class Places(NamedTuple):
    """Between the samples of a series, or of one that is `finer` by so many times."""

    whole: NDArray[np.int64]
    part: Array
    finer: int
    bridge: int


def places_of(speed: Array, v0: Array, s: Setting) -> tuple[Places | None, Places | None]:
    """Where the instants of equal distance are in time, and those of equal time in distance; None where that is the
    same."""
    n = s.n
    run = integral(speed / v0 - 1, s) / s.dt
    run = run - run[..., -1:] * np.linspace(0, 1, n)  # both begin and end together
    if np.abs(run).max() < ALIKE:
        return None, None
    at = np.arange(n, dtype=np.float64)
    distance = at + run
    flat = distance.reshape(-1, n)
    time = np.stack([np.interp(at, row, at) for row in flat]).reshape(distance.shape)
    return _split(time, s), _split(distance, s)


def _split(place: Array, s: Setting) -> Places:
    finer = max(1, round(s.dt / STEP_S))
    place = place * finer
    whole = np.clip(np.floor(place).astype(np.int64), 2, finer * (s.n - 1) - 3)
    return Places(whole, place - whole, finer, s.bridge)


def at_places(x: Array, places: Places | None) -> Array:
    """A series (..., n) at places between its samples: the quintic through the six nearest."""
    if places is None:
        return x
    n, k, f = x.shape[-1], places.whole, places.part
    x = _finer(x, places)
    if x.ndim == k.ndim == 1:
        out = np.empty(n)
        _quintic(x[None], k[None], f[None], out[None])
        return out
    shape = np.broadcast_shapes(x.shape[:-1], k.shape[:-1])
    out = np.empty((*shape, n))
    _quintic(_rows(x, shape), _rows(k, shape), _rows(f, shape), out.reshape(-1, n))
    return out


def _rows(x: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """(..., n) -> (rows, n), of so many leading axes."""
    return np.ascontiguousarray(np.broadcast_to(x, (*shape, x.shape[-1]))).reshape(-1, x.shape[-1])


def _finer(x: Array, places: Places) -> Array:
    """A series (..., n) with samples between its own, by its transform: up to its last (..., finer (n - 1) + 1)."""
    if places.finer == 1:
        return x
    joined = _bridged(x, places.bridge)
    longer = fft.irfft(fft.rfft(joined, axis=-1), places.finer * joined.shape[-1], axis=-1)
    return np.asarray(places.finer * longer[..., : places.finer * (x.shape[-1] - 1) + 1])


@njit(cache=True, nogil=True)
def _quintic(x: Array, whole: NDArray[np.int64], part: Array, out: Array) -> None:
    for i in range(x.shape[0]):
        for j in range(out.shape[1]):
            k, f = whole[i, j], part[i, j]
            out[i, j] = quintic(x[i, k - 2], x[i, k - 1], x[i, k], x[i, k + 1], x[i, k + 2], x[i, k + 3], f)


def sinking_line(altitude: Array, down: Array, s: Setting) -> Array:
    """The line (..., n) by which a vertical speed that was integrated is off: its integral then is the way down that
    the altitude shows, but for where that begins."""
    t = np.linspace(-1.0, 1.0, s.n)
    off = integral(down, s) + altitude
    bent = np.polynomial.polynomial.polyfit(t, off.reshape(-1, s.n).T, 2)
    half = 0.5 * (s.n - 1) * s.dt
    line = (bent[1][:, None] + 2 * bent[2][:, None] * t) / half
    return np.asarray(line.reshape(off.shape))


def without_line(x: Array) -> Array:
    """Series (..., n) without their mean and their straight line, by least squares."""
    t = np.linspace(-1.0, 1.0, x.shape[-1])
    apart = x - x.mean(-1, keepdims=True)
    return np.asarray(apart - (apart @ t / (t @ t))[..., None] * t)


OWN_SPEED_HZ: Final = (0.03, 0.08)
"""Without ground speed, the aircraft's own speed is the airspeed below the first and the integral of the acceleration
above the second: half a degree of slow error in the attitude makes 0.2 m/s of it there."""


def own_speed(airspeed: Array, along: Array, s: Setting) -> Array:
    """The speed of the aircraft's own motion where no ground speed shows it: gusts along the path are no motion."""
    apart = airspeed - along
    level = without_line(apart)
    return np.asarray(along + apart - level + back(transform(level, s) * passed(s.omega, OWN_SPEED_HZ), s))


def between_fresh(held: Array, integral: Array, fresh: NDArray[np.int64] | None) -> Array:
    """A speed that repeats its values, filled in between its fresh ones by the integral of the acceleration."""
    if fresh is None:
        return held
    difference = held[..., fresh] - integral[..., fresh]
    at = np.arange(held.shape[-1])
    flat = difference.reshape(-1, len(fresh))
    filled = np.stack([np.interp(at, fresh, row) for row in flat]).reshape(held.shape)
    return np.asarray(integral + filled)
