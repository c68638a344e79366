"""What an instrument did to its signal, undone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.backlash import linearised, lost_motion
from station.diagnosis.processing import Setting, back, passed, transform
from station.estimation.instrument_errors import DITHER
from station.profile import Aircraft, Instrument

Array = NDArray[np.float64]

CORRECTION_STOP_HZ: Final = (6.0, 9.0)
"""Corrections that would raise noise (lags, backlash) are passed up to the first and stopped from the second."""

PRESENT: Final = {
    "v_along": "v_north",
}
"""Series' signals that stand for an instrument of another name."""


def instrument_of(aircraft: Aircraft, name: str) -> Instrument | None:
    return aircraft.instruments.get(PRESENT.get(name, name))


def corrected(x: Array, found: Instrument | None, s: Setting, moved: Array | None = None) -> Array:
    """A signal with its instrument's errors taken out; `moved` is its true relative change where that is known."""
    if found is None:
        return x
    if found.bias:
        x = x - found.bias
    if found.latency or found.lag:
        w = s.omega
        inverse = np.exp(1j * w * found.latency)
        if found.lag and moved is not None:
            # Its own noise, undone from a long lag, would drown the rest.
            lost = 1j * w * found.lag / (1 + 1j * w * found.lag)
            x = x * (1 + back(transform(moved, s) * lost, s))
        elif found.lag:
            inverse = inverse * (1 + 1j * w * found.lag) * passed(w, CORRECTION_STOP_HZ)
        x = back(transform(x, s) * inverse, s)
    if found.gain != 1:
        x = x / found.gain
    if found.cubic:
        x = linearised(x, found.cubic)
    if found.backlash:
        dither = DITHER * s.elevator_noise
        moved = lost_motion(x, found.backlash + dither) - lost_motion(x, dither)
        # Backlash between sensor and surface: the surface follows the sensor late.
        x = x + back(transform(moved, s) * passed(s.omega, CORRECTION_STOP_HZ), s)
    return x


def own_motion(name: str, signals: Mapping[str, Array], s: Setting) -> Array | None:
    """The relative change of an air datum in calm air, where the aircraft's own speed makes it."""
    power = {"airspeed": 1, "dynamic_pressure": 2}.get(name)
    if power is None or s.gusty or "v_along" not in signals or "v_along" in s.held:
        return None
    along, speed = signals["v_along"], signals["airspeed"].mean(-1, keepdims=True)
    return np.asarray(power * (along - along.mean(-1, keepdims=True)) / speed)


def gain_of(aircraft: Aircraft, name: str) -> float:
    found = aircraft.instruments.get(name)
    return found.gain if found else 1.0
