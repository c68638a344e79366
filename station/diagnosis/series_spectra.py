"""Spectra of the series in which measured and predicted flight are compared, longitudinal or lateral."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from station.diagnosis.processing import Setting

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

TAPER: Final = 0.25
INTEGRALS: Final = 3
"""So many series, the first, are of integrals: of these the slope is what the transform leaves out."""


@dataclass(frozen=True, slots=True)
class Spectra:
    """`bins` (..., k, m): transforms at m frequencies of the k series judged, scaled so that a white series of variance
    s2 has a mean |bin|2 of s2; `steady` (..., k): what the transform leaves out, slope times length for the integrated
    series, mean for the others."""

    bins: Complex
    steady: Array

    def minus(self, other: Spectra) -> Spectra:
        return Spectra(self.bins - other.bins, self.steady - other.steady)


def spectra(differences: Array, s: Setting, rows: tuple[int, ...] | None = None, integrated: bool = True) -> Spectra:
    """Of series (..., 7, n): ends cut, line removed, tapered, transformed. `rows` in place of the setting's judged
    ones; `integrated` tells whether the first three are integrals."""
    c = s.cut
    rows = s.judged if rows is None else rows
    y = differences[..., list(rows), c : s.n - c]
    n = y.shape[-1]
    t, window, square = _window(n)
    mean = y.mean(-1)
    slope = (y @ t) / float(t @ t)
    y = y - mean[..., None] - slope[..., None] * t
    bins = fft.rfft(y * window, axis=-1)[..., s.bins] / math.sqrt(square)
    sums = np.array([integrated and j < INTEGRALS for j in rows], dtype=bool)
    return Spectra(bins, np.where(sums, slope, mean))


@lru_cache(maxsize=16)
def _window(n: int) -> tuple[Array, Array, float]:
    """Time from -1/2 to 1/2, the taper, and the sum of its squares."""
    window = signal.windows.tukey(n, TAPER)
    return np.linspace(-0.5, 0.5, n), window, float((window**2).sum())
