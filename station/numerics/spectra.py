"""Recursive Fourier transform of many channels, each first through the same warm high-pass.

X(f) <- X(f) + x exp(-j 2 pi f t) at every sample (Morelli 2000, Real-time parameter estimation in the frequency domain;
Klein and Morelli 2006, section 11.3). The 4th-order 0.02 Hz high-pass runs from the first sample on, so its start has
died away when the transform opens. Any two channels related sample by sample stay so: a
missing sample is left out of all of them and costs nothing but itself.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray
from scipy.signal import butter

from station.numerics.products import settled

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

HIGH_PASS_HZ: Final = 0.02
HIGH_PASS_ORDER: Final = 4


FILTERED, TRANSFORMED = range(2)
"""Places in State.samples."""


class Design(NamedTuple):
    """What the transform of any channel goes by."""

    sections: Array
    """Second-order sections of the high-pass, (sections, 6)."""
    rest: Array
    """Their state at rest under a constant 1, (sections, 2)."""
    turn: Complex
    """What each line's phase is multiplied by from one sample to the next, (frequencies,)."""


class State(NamedTuple):
    """The transform of some channels, changed in place."""

    filters: Array
    """Of the high-pass, (channels, sections, 2)."""
    spectrum: Complex
    """(channels, frequencies)"""
    phase: Complex
    """Of the next sample, (frequencies,)."""
    samples: Array
    """Filtered, and of these transformed, (2,)."""


@register_jitable
def begin(design: Design, channels: int) -> State:
    """Before the first sample."""
    sections, lines = design.sections.shape[0], design.turn.shape[0]
    return State(
        np.zeros((channels, sections, 2)),
        np.zeros((channels, lines), dtype=np.complex128),
        np.ones(lines, dtype=np.complex128),
        np.zeros(2),
    )


@register_jitable
def clear(state: State) -> None:
    """Empty the transform; the high-pass stays warm."""
    state.spectrum[:] = 0.0
    state.phase[:] = 1.0
    state.samples[TRANSFORMED] = 0.0


@njit(cache=True)
def carry(past: Array, now: Array, close: bool) -> None:
    """Add to the sums `now` (n,) of a segment of a flight those of the segments `past` (n or more,), which take it in
    where it is to `close`. A long flight is cut into segments: over one ever longer transform repeated inputs cancel
    at most lines of the grid."""
    for i in range(now.shape[0]):
        now[i] += past[i]
        if close:
            past[i] = now[i]


@njit(cache=True)
def step(design: Design, state: State, x: Array, is_open: bool) -> None:
    """One sample of the first channels, `x` (channels,), all finite; transformed if `is_open`, else only filtered.

    From Python hand over plain tuples: numba takes a microsecond to see the type of each named one.
    """
    design, state = Design(*design), State(*state)
    sos, z, spectrum, phase = design.sections, state.filters, state.spectrum, state.phase
    first = state.samples[FILTERED] == 0.0
    state.samples[FILTERED] += 1.0
    if is_open:
        state.samples[TRANSFORMED] += 1.0
    for c in range(x.shape[0]):
        if first:
            for k in range(sos.shape[0]):
                z[c, k, 0] = design.rest[k, 0] * x[c]
                z[c, k, 1] = design.rest[k, 1] * x[c]
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
            phase[i] *= design.turn[i]


def grid(low: float, high: float, step_hz: float) -> Array:
    """Frequencies low, low + step ... up to high, Hz, (frequencies,)."""
    return np.asarray(low + step_hz * np.arange(math.floor((high - low) / step_hz + 1e-9) + 1), dtype=np.float64)


def central_difference_factor(frequencies_hz: Array, dt: float) -> Array:
    """(w dt)/sin(w dt): what a central difference over two steps loses at each frequency, (frequencies,)."""
    x = 2.0 * np.pi * frequencies_hz * dt
    return np.asarray(x / np.sin(x))


def design(frequencies_hz: Array, dt: float) -> Design:
    """High-pass and lines for samples `dt` (s) apart."""
    sections = butter(HIGH_PASS_ORDER, HIGH_PASS_HZ, "highpass", fs=1.0 / dt, output="sos")
    return Design(sections, settled(sections), np.exp(-2j * np.pi * frequencies_hz * dt))


class Transform:
    """The state of `step` for some channels: `spectrum` (channels, frequencies) and `samples` in it."""

    def __init__(self, channels: int, frequencies_hz: Array, dt: float) -> None:
        self.design = design(frequencies_hz, dt)
        self.state = begin(self.design, channels)
        self.spectrum = self.state.spectrum
        self.arrays: Any = (tuple(self.design), tuple(self.state))
        """As `step` takes them from Python."""

    @property
    def filtered(self) -> float:
        """Samples that the high-pass has seen."""
        return float(self.state.samples[FILTERED])

    @property
    def samples(self) -> float:
        """Samples in the transform."""
        return float(self.state.samples[TRANSFORMED])

    def clear(self) -> None:
        """Empty the transform; the high-pass stays warm."""
        clear(self.state)

    def step(self, x: Array, is_open: bool) -> None:
        """One sample of each channel, (channels,); transformed if `is_open`, else only filtered."""
        design, state = self.arrays
        step(design, state, x, is_open)
