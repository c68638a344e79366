"""Power and cross spectra by Welch's method, in bins of lines, with the errors that their independent segments allow.

    response = S_xy/S_xx,   coherence = |S_xy|^2/(S_xx S_yy)
    relative sd of the response, and sd of its phase (rad): sqrt((1 - coherence)/(2 n coherence))
    density: chi-squared with 2 n degrees of freedom

n: independent segments times independent lines of a bin. Sources: Welch 1967; Bendat and Piersol 2010, chapter 9.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import get_window
from scipy.stats import chi2

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]

OVERLAPPED: Final = 0.95
"""Independent share of Hann segments that overlap by half (Welch 1967)."""
HANN_LINES: Final = 2.0
"""Neighbouring lines of a Hann window's spectrum that are worth one, where there are many: (sum W^2)^2/sum W^4 = 2.08;
m lines are worth (m + 1)/2."""
MEAN_LINES: Final = 2
"""The lowest lines, which the window leaks the mean into."""


@dataclass(frozen=True, slots=True)
class CrossSpectra:
    """One-sided densities (lines,) of x, y and from x to y, E[X* Y]; `segments` that they are means of."""

    frequencies_hz: Array
    xx: Array
    yy: Array
    xy: Complex
    segments: int


@dataclass(frozen=True, slots=True)
class Bins:
    """Means over lines, (bins,); how many independent values each is a mean of, and how many of them are its own, not
    its neighbours' too: what counts where bins are taken together."""

    frequencies_hz: Array
    xx: Array
    yy: Array
    xy: Complex
    independent: Array
    own: Array

    @property
    def coherence(self) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.nan_to_num(np.abs(self.xy) ** 2 / (self.xx * self.yy)))

    @property
    def response(self) -> Complex:
        """From x to y."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.xy / self.xx)

    @property
    def relative_sd(self) -> Array:
        """Of the response's magnitude, and of its phase, rad."""
        known = np.maximum(self.coherence, 1e-12)
        return np.asarray(np.sqrt(np.maximum(1 - known, 0.0) / (2 * self.independent * known)))

    @property
    def by_chance(self) -> Array:
        """Coherence that two series without a connection exceed once in twenty."""
        return np.asarray(1 - 0.05 ** (1 / np.maximum(self.independent - 1, 1e-6)))

    def band(self, density: Array) -> tuple[Array, Array]:
        """95 % interval of a density."""
        freedom = 2 * self.independent
        return density * freedom / chi2.ppf(0.975, freedom), density * freedom / chi2.ppf(0.025, freedom)


def cross_spectra(x: Array, y: Array, usable: Flags, dt: float, segment: int) -> CrossSpectra:
    """Of two series (n,) by Hann segments of `segment` samples that overlap by half, each less its mean (Welch 1967).

    Only segments whose rows are all `usable`; they begin where such rows begin. `segments` is 0 where none is whole.
    """
    window = get_window("hann", segment)
    scale = 2.0 * dt / float(window @ window)
    frequencies: Array = np.asarray(np.fft.rfftfreq(segment, dt), dtype=np.float64)
    xx, yy = np.zeros(len(frequencies)), np.zeros(len(frequencies))
    xy = np.zeros(len(frequencies), dtype=np.complex128)
    count = 0
    for part in _segments(usable, segment):
        a, b = (np.fft.rfft(window * (s[part] - s[part].mean())) for s in (x, y))
        xx += np.abs(a) ** 2
        yy += np.abs(b) ** 2
        xy += a.conj() * b
        count += 1
    weight = np.full(len(frequencies), scale / max(count, 1))
    weight[0] /= 2.0
    if segment % 2 == 0:
        weight[-1] /= 2.0
    return CrossSpectra(frequencies, xx * weight, yy * weight, xy * weight, count)


def whole_segments(usable: Flags, segment: int) -> int:
    """How many of `segment` samples there are."""
    return sum(1 for _ in _segments(usable, segment))


def _segments(usable: Flags, segment: int) -> Iterator[slice]:
    edges = np.flatnonzero(np.diff(np.concatenate(([0], usable.astype(np.int8), [0]))))
    for begin, end in edges.reshape(-1, 2):
        for start in range(int(begin), int(end) - segment + 1, segment - segment // 2):
            yield slice(start, start + segment)


def binned(found: CrossSpectra, edges_hz: Array) -> Bins:
    """By the edges of the bins, Hz, rising; bins without a line are left out, as are the lines that hold the mean."""
    lines = np.arange(len(found.frequencies_hz))
    member = np.digitize(found.frequencies_hz, edges_hz) * (lines >= MEAN_LINES)
    kept = [np.flatnonzero(member == i) for i in range(1, len(edges_hz))]
    kept = [k for k in kept if len(k)]

    def mean(x: Array | Complex) -> Complex:
        return np.array([np.mean(x[k]) for k in kept], dtype=np.complex128)

    count = np.array([len(k) for k in kept], dtype=np.float64)
    each = OVERLAPPED * found.segments / HANN_LINES
    frequencies, xx, yy = (mean(x).real for x in (found.frequencies_hz, found.xx, found.yy))
    return Bins(frequencies, xx, yy, mean(found.xy), each * (count + 1.0), each * count)
