"""Power spectral densities of the last minute, for the page: vane beside what the motion makes of alpha. Pure.

Up to 25 Hz, the Nyquist frequency of the aligned frames; up to the vane's own is for the report of `station identify`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import TICK_HZ, TICK_NS
from station.estimation.method_table import METHODS
from station.rows import AlphaEstimate
from station.screen.drawings import WIDE, Drawing, Label, Strip, axes

Array = NDArray[np.float64]

LENGTH_S: Final = 60
SEGMENT_S: Final = 10
"""Of Welch's method: 11 half-overlapping segments, lines 0.1 Hz apart."""
EVERY_NS: Final = 5_000_000_000
LOW_HZ: Final = 0.1
HIGH: Final = 500.0
DECADES: Final = 6
"""Below the highest line."""
LINES: Final = (
    ("vane", METHODS["II"].colour),
    ("inertial", METHODS["V"].colour),
    ("gust part", METHODS["split+gust"].colour),
    ("corrected", METHODS["split"].colour),
)


class LiveSpectra:
    """Follows the estimates; `drawing` once there is half a minute without a gap."""

    def __init__(self) -> None:
        self._rows: deque[tuple[float, ...]] = deque(maxlen=LENGTH_S * TICK_HZ)
        self._last_ns = 0
        self._due_ns = 0

    def take(self, alphas: Iterable[AlphaEstimate]) -> None:
        for a in alphas:
            row = (a.vane, a.alpha_inertial, a.alpha_gust, a.alpha if a.valid else math.nan)
            if not math.isfinite(sum(row)) or a.t_ns - self._last_ns > 3 * TICK_NS:
                self._rows.clear()  # a spectrum over a gap is none
            if math.isfinite(sum(row)):
                self._rows.append(row)
            self._last_ns = a.t_ns

    def drawing(self, now_ns: int) -> Drawing | None:
        """Every `EVERY_NS`; None while there is nothing new to see."""
        if now_ns < self._due_ns or len(self._rows) < LENGTH_S * TICK_HZ // 2:
            return None
        self._due_ns = now_ns + EVERY_NS
        return spectra_drawing(*densities(np.degrees(np.array(self._rows))))


def densities(values: Array) -> tuple[Array, Array]:
    """Frequencies (Hz) and one-sided power spectral densities (deg2/Hz, a row a signal) of `values` (ticks, signals),
    deg. Welch 1967, Hann window, means removed."""
    length = SEGMENT_S * TICK_HZ
    window = np.hanning(length + 1)[:-1, None]
    starts = range(0, len(values) - length + 1, length // 2)
    segments = (values[s : s + length] - values[s : s + length].mean(axis=0) for s in starts)
    power = np.mean([np.abs(np.fft.rfft(window * s, axis=0)) ** 2 for s in segments], axis=0)
    density = 2 * power / (TICK_HZ * float((window**2).sum()))
    density[[0, -1]] /= 2  # the mean and the Nyquist frequency have no mirror image
    return np.asarray(np.fft.rfftfreq(length, 1 / TICK_HZ), dtype=np.float64), np.asarray(density.T)


def spectra_drawing(f_hz: Array, density: Array) -> Drawing:
    """Both axes logarithmic, a grid line a decade; the names beside the lines' left ends."""
    seen = (f_hz >= LOW_HZ) & (f_hz < f_hz[-1])
    top = math.ceil(math.log10(max(float(density[:, seen].max()), 1e-12)))
    high_hz = float(f_hz[-1])

    def across(f: Array | float) -> Array:
        return np.asarray(WIDE * np.log(np.asarray(f) / LOW_HZ) / math.log(high_hz / LOW_HZ))

    def down(p: Array | float) -> Array:
        return np.asarray(HIGH * np.clip((top - np.log10(np.maximum(p, 1e-30))) / DECADES, 0, 1))

    ticks = [f for f in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20) if f < high_hz]
    frame = axes(
        [(float(across(f)), f"{f:g} Hz") for f in ticks],
        [(float(down(10.0**k)), f"1e{k}") for k in range(top - DECADES, top + 1)],
        HIGH,
    )
    x = across(f_hz[seen])
    strips, labels = list(frame.strips), list(frame.labels)
    labels.append(Label(WIDE / 2, -34.0, "power spectral density over the last minute, deg²/Hz"))
    for i, ((name, colour), line) in enumerate(zip(LINES, density[:, seen], strict=True)):
        strips.append(Strip(np.column_stack((x, down(line))), colour, 1.5))
        labels.append(Label(WIDE + 60, 20.0 + 24 * i, name, colour))
    return Drawing(tuple(strips), tuple(labels))
