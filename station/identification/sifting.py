"""Sifting: equation error on the spectral lines that a multisine excites, and no others.

Over whole periods of the input its energy lies on harmonics of 1/period alone, while that of gusts lies on all lines:
keeping the excited ones raises the ratio of input to gust energy by the number of periods. Where the lines between give
the same estimates, one model structure describes the response to the input and to gusts. Each axis is fitted on the
lines of its own surfaces, so that of inputs which are flown at once none is taken for another's.

    C(f) = C_a alpha(f) + C_q qhat(f) + C_de de(f),   f on harmonics where the input stands out

Source: Morelli 2012, AIAA 2012-4511 (efficient global aerodynamic modelling: sifted harmonics); Klein and Morelli 2006,
section 9.3.4. Per radian; SI.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.numerics.regression import NotIdentifiable

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

MIN_PERIODS: Final = 2
SIGMAS: Final = 3.0
"""Up to which estimates from the two sets of lines agree."""
SINGULAR: Final = 1e10
"""Condition number of the scaled normal matrix above which regressors are collinear."""
STANDS_OUT: Final = 10.0
"""Power of the input on a line over that of the lines between."""


@dataclass(frozen=True, slots=True)
class Sifted:
    """Parameters (m,) with standard errors from the excited lines, and from the lines between them (NaN where those
    hold nothing)."""

    estimate: Array
    std_error: Array
    between: Array
    between_error: Array
    lines_hz: Array
    periods: int

    @property
    def agree(self) -> bool:
        """Whether no parameter differs by more than three standard errors."""
        apart = np.nan_to_num(np.abs(self.estimate - self.between))
        return bool(np.all(apart <= SIGMAS * np.hypot(self.std_error, self.between_error)))


def sift(
    regressors: Sequence[Array],
    measured: Array,
    surfaces: Sequence[Array],
    dt: float,
    period_s: float,
    band_hz: tuple[float, float],
) -> Sifted:
    """Fit `measured` (n,) by `regressors` (n,) each, on the lines that any of the `surfaces` (n,) excites.

    Uses the last whole periods of a uniform grid, all finite. Raises NotIdentifiable for fewer than two periods, an
    input whose lines do not stand out, or collinear regressors.
    """
    per = period_s / dt
    periods = int(len(measured) / per + 1e-6)
    if periods < MIN_PERIODS:
        raise NotIdentifiable(f"{len(measured) * dt:.0f} s hold fewer than {MIN_PERIODS} periods of {period_s:g} s")
    count = round(periods * per)

    def spectrum(x: Array) -> Complex:
        # Drift would leak onto every line: its slope is that of the periods' means, which a periodic response lacks.
        kept = x[-count:]
        whole = count // periods
        slope = (np.mean(kept[-whole:]) - np.mean(kept[:whole])) / (count - whole)
        level = kept - slope * np.arange(count)
        return np.asarray(np.fft.rfft(level - level.mean()))

    frequencies = np.fft.rfftfreq(count, dt)
    inside = (frequencies >= band_hz[0] - 1e-9) & (frequencies <= band_hz[1] + 1e-9)
    number = np.arange(len(frequencies))
    harmonic = inside & (number % periods == 0)
    rest = inside & ~harmonic
    if not rest.any() or not harmonic.any():
        raise NotIdentifiable("no lines of the input in the band")
    forced = np.zeros_like(harmonic)
    for surface in surfaces:
        power = np.abs(spectrum(surface)) ** 2
        forced |= harmonic & (power > STANDS_OUT * max(float(np.median(power[rest])), 1e-30))
    if np.count_nonzero(forced) <= len(regressors):
        raise NotIdentifiable("the input has no distinct lines: no multisine of this period was flown")
    x = np.array([spectrum(column) for column in regressors])
    z = spectrum(measured)
    estimate, error = _solve(x[:, forced], z[forced])
    try:
        between, between_error = _solve(x[:, rest], z[rest])
    except NotIdentifiable:
        # In calm air there is nothing between the lines.
        between, between_error = np.full(len(x), np.nan), np.full(len(x), np.inf)
    return Sifted(estimate, error, between, between_error, frequencies[forced], periods)


def _solve(x: Complex, z: Complex) -> tuple[Array, Array]:
    normal = (x.conj() @ x.T).real
    scale = np.sqrt(np.diag(normal))
    if (scale == 0).any() or np.linalg.cond(normal / np.outer(scale, scale)) > SINGULAR:
        raise NotIdentifiable("the regressors are collinear")
    inverse = np.linalg.inv(normal)
    estimate = inverse @ (x.conj() @ z).real
    rest = float(np.sum(np.abs(z - x.T @ estimate) ** 2))
    return estimate, np.sqrt(np.diag(inverse) * rest / (2 * len(z) - len(x)))
