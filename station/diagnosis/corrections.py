"""What an instrument did to its signal, undone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from station.diagnosis.backlash import linearised, lost_motion, smoothed
from station.diagnosis.memo import Memo
from station.diagnosis.processing import Setting, back, passed, transform
from station.diagnosis.stacked import some
from station.profile import Aircraft, Instrument

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

QUIET_HZ: Final = 0.5
"""Width over which a spectrum is averaged, where a frequency's share of noise is asked."""
DITHER: Final = 2.0
"""Noise standard deviations of a quietened drive by which a backlash is widened and narrowed again: held for a second,
its few independent values reach one to either side. With more, a drive that never rests is taken to turn late."""
CORRECTION_STOP_HZ: Final = (6.0, 9.0)
"""Corrections that would raise noise (lags, backlash) are passed up to the first and stopped from the second."""

AIR_DATA: Final = ("airspeed", "dynamic_pressure")
PRESENT: Final = {
    "v_along": "v_north",
    "v_ahead": "v_north",
    "v_across": "v_east",
}
"""Series' signals that stand for an instrument of another name."""


def instrument_of(aircraft: Aircraft, name: str) -> Instrument | None:
    return aircraft.instruments.get(PRESENT.get(name, name))


def all_corrected(
    signals: Mapping[str, Array], aircraft: Aircraft, s: Setting, memo: Memo
) -> tuple[dict[str, Instrument | None], dict[str, Array]]:
    """What the aircraft says of each signal's instrument, and the signals (..., n), SI, with that undone."""
    found = {name: instrument_of(aircraft, name) for name in signals}
    return found, {
        name: memo.get("signal", (name, found[name]), partial(corrected, values, found[name], s))
        for name, values in signals.items()
    }


def unlagged(s: NDArray[np.complexfloating], lag: float | Array) -> Complex:
    """What is true over what an instrument with a first-order lag (s) shows, at s = j omega. One below zero shows it as
    much ahead, as an actuator's command does the surface."""
    return np.asarray(np.where(np.less(lag, 0), 1 / (1 - s * np.minimum(lag, 0)), 1 + s * lag))


def corrected(x: Array, found: Instrument | None, s: Setting) -> Array:
    """A signal with its instrument's errors taken out."""
    if found is None:
        return x
    if some(found.bias):
        x = x - found.bias
    if some(found.latency) or some(found.lag):
        w = s.omega
        inverse = np.exp(1j * w * found.latency)
        if some(found.lag):
            stop = np.where(np.greater(found.lag, 0), passed(w, CORRECTION_STOP_HZ), 1.0)
            inverse = inverse * unlagged(1j * w, found.lag) * stop
        x = back(transform(x, s) * inverse, s)
    if some(found.gain - 1):
        x = x / found.gain
    if found.cubic:
        x = linearised(x, found.cubic)
    if found.backlash:
        # Backlash between sensor and surface: the surface follows the sensor late.
        x = x + back(transform(_lost(x, found.backlash, s), s) * passed(s.omega, CORRECTION_STOP_HZ), s)
    return x


def _lost(x: Array, width: float, s: Setting) -> Array:
    """The lost motion of a surface whose drive (..., n) is measured with noise."""
    drive, noise = _quietened(x, s)
    dither = DITHER * noise
    if s.rest is None:
        return smoothed(drive, width + dither)
    if not s.rest:
        return lost_motion(drive, width + dither) - lost_motion(drive, dither)
    still = smoothed(drive, s.rest + dither)
    return still + lost_motion(drive + still, width)


def _quietened(x: Array, s: Setting) -> tuple[Array, float]:
    """The drive of a surface (..., n) with the frequencies left out at which its sensor shows no more than noise
    (Wiener 1949: the motion's share of the power), and the standard deviation of the noise left in it."""
    bins = transform(x, s)
    power = np.abs(bins) ** 2 / (s.n + s.bridge)
    count = max(1, round(QUIET_HZ * (s.n + s.bridge) * s.dt))
    power = uniform_filter1d(power, count, axis=-1, mode="nearest")
    share = np.clip(1 - s.elevator_noise**2 / np.maximum(power, 1e-300), 0, 1)
    return back(bins * share, s), s.elevator_noise * math.sqrt(float(share.mean()))
