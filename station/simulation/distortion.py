"""A measured signal whose gain and timing depend on frequency, as tables of both say: for flights in which the vane is
not modelled but given.

    measured(f) = true(f) exp(+j 2 pi f lead(f)) / correction(f)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.simulation.boom import SecondOrder, second_order_step, settle

Array = NDArray[np.float64]

REACH: Final = 64
"""Ticks that the filter reaches into past and future."""
_POINTS: Final = 4096
_KAISER: Final = 6.0


def distortion_filter(
    frequency: Sequence[float], correction: Sequence[float], lead: Sequence[float], dt: float
) -> Array:
    """Weights of measured less true, (2 REACH + 1,), the newest sample's first.

    The tables (Hz, 1, s) are straight between their points and level beyond them.
    """
    f = np.fft.rfftfreq(_POINTS, dt)
    gain = 1.0 / np.interp(f, frequency, correction)
    response = gain * np.exp(2j * np.pi * f * np.interp(f, frequency, lead))
    impulse = np.fft.irfft(response, _POINTS)
    weights = np.roll(impulse, REACH)[: 2 * REACH + 1] * np.kaiser(2 * REACH + 1, _KAISER)
    weights[REACH] -= 1.0
    return np.asarray(weights)


@njit(cache=True, error_model="numpy")
def distort(weights: Array, vane: SecondOrder, part: Array, out: Array) -> None:
    """Add to `out` (n,) what the distortion of `part` (n + REACH,) does to what a vane shows of it, rad.

    Before its begin `part` is taken as level. `vane`: its dynamics at the samples' interval.
    """
    reach = weights.shape[0] // 2
    state = np.zeros(3)
    for k in range(out.shape[0]):
        added = 0.0
        for j in range(weights.shape[0]):
            added += weights[j] * (part[max(k + reach - j, 0)] - part[0])
        if k == 0:
            settle(state, added)
        out[k] += second_order_step(vane, state, added)
