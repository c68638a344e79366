"""Recursive Fourier transform of many channels, each first through the same warm high-pass.

X(f) <- X(f) + x exp(-j 2 pi f t) at every sample (Morelli 2000, Real-time parameter estimation in the frequency domain;
Klein and Morelli 2006, section 11.3). The 4th-order 0.02 Hz high-pass runs from the first sample on, so its start has
died away when the transform opens. Any two channels related sample by sample stay so: a
missing sample is left out of all of them and costs nothing but itself.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt_zi

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

HIGH_PASS_HZ: Final = 0.02
HIGH_PASS_ORDER: Final = 4


@njit(cache=True)
def step(
    sos: Array,
    rest: Array,
    z: Array,
    x: Array,
    spectrum: Complex,
    phase: Complex,
    turn: Complex,
    count: Array,
    is_open: bool,
) -> None:
    """One sample of each channel, `x` (channels,), all finite.

    Edits the filters `z` (channels, sections, 2), `spectrum` (channels, frequencies), `phase` (frequencies,) and
    `count` (samples filtered, samples transformed). `rest`: filter state of a constant 1, (sections, 2).
    """
    first = count[0] == 0.0
    count[0] += 1.0
    if is_open:
        count[1] += 1.0
    for c in range(x.shape[0]):
        if first:
            for k in range(sos.shape[0]):
                z[c, k, 0] = rest[k, 0] * x[c]
                z[c, k, 1] = rest[k, 1] * x[c]
        value = x[c]
        for k in range(sos.shape[0]):
            y = sos[k, 0] * value + z[c, k, 0]
            z[c, k, 0] = sos[k, 1] * value - sos[k, 4] * y + z[c, k, 1]
            z[c, k, 1] = sos[k, 2] * value - sos[k, 5] * y
            value = y
        if is_open:
            for i in range(phase.shape[0]):
                spectrum[c, i] += value * phase[i]
    if is_open:
        for i in range(phase.shape[0]):
            phase[i] *= turn[i]


def grid(low: float, high: float, step_hz: float) -> Array:
    """Frequencies low, low + step ... up to high, Hz, (frequencies,)."""
    return np.asarray(low + step_hz * np.arange(math.floor((high - low) / step_hz + 1e-9) + 1), dtype=np.float64)


def central_difference_factor(frequencies_hz: Array, dt: float) -> Array:
    """(w dt)/sin(w dt): what a central difference over two steps loses at each frequency, (frequencies,)."""
    x = 2.0 * np.pi * frequencies_hz * dt
    return np.asarray(x / np.sin(x))


def high_pass(dt: float) -> tuple[Array, Array]:
    """The filter's second-order sections, (sections, 6), and their state at rest under a constant 1, (sections, 2)."""
    sos = butter(HIGH_PASS_ORDER, HIGH_PASS_HZ, "highpass", fs=1.0 / dt, output="sos")
    return sos, np.asarray(sosfilt_zi(sos))


class Transform:
    """The state of `step` for some channels: `spectrum` (channels, frequencies) and `samples` in it."""

    def __init__(self, channels: int, frequencies_hz: Array, dt: float) -> None:
        self.sos, self.rest = high_pass(dt)
        self._z = np.zeros((channels, len(self.sos), 2))
        self.turn = np.exp(-2j * np.pi * frequencies_hz * dt)
        self._phase = np.ones(len(frequencies_hz), dtype=np.complex128)
        self._count = np.zeros(2)
        self.spectrum = np.zeros((channels, len(frequencies_hz)), dtype=np.complex128)
        self.arrays = (self._z, self.spectrum, self._phase, self._count)
        """What `step` edits."""

    @property
    def filtered(self) -> float:
        """Samples that the high-pass has seen."""
        return float(self._count[0])

    @property
    def samples(self) -> float:
        """Samples in the transform."""
        return float(self._count[1])

    def clear(self) -> None:
        """Empty the transform; the high-pass stays warm."""
        self.spectrum[:] = 0.0
        self._phase[:] = 1.0
        self._count[1] = 0.0

    def step(self, x: Array, is_open: bool) -> None:
        """One sample of each channel, (channels,); transformed if `is_open`, else only filtered."""
        step(
            self.sos,
            self.rest,
            self._z,
            x,
            self.spectrum,
            self._phase,
            self.turn,
            self._count,
            is_open,
        )
