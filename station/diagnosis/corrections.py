"""What an instrument did to its signal, undone."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.backlash import linearised, lost_motion
from station.diagnosis.memo import Memo
from station.diagnosis.processing import Setting, back, passed, transform
from station.estimation.instrument_errors import DITHER
from station.profile import Aircraft, Instrument

Array = NDArray[np.float64]

CORRECTION_STOP_HZ: Final = (6.0, 9.0)
"""Corrections that would raise noise (lags, backlash) are passed up to the first and stopped from the second."""

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


def corrected(x: Array, found: Instrument | None, s: Setting) -> Array:
    """A signal with its instrument's errors taken out."""
    if found is None:
        return x
    if found.bias:
        x = x - found.bias
    if found.latency or found.lag:
        w = s.omega
        inverse = np.exp(1j * w * found.latency)
        if found.lag:
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
