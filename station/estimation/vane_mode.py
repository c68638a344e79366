"""The mode of a vane on its boom, found in the spectrum of what it shows.

    S(f) = exp(a) f^b |H(f)|^2, folded at the Nyquist frequency, + exp(c),   H = f0^2/(f0^2 - f^2 + 2 i zeta f0 f)

a gust's spectrum through a second-order instrument, and white noise, fitted to Welch's densities by Whittle's
likelihood (each chi-squared about S): maximum by scoring from several f0. There is a mode where the deviance is less
than without H by more than chance allows anywhere in the band, in which the gusts' spectrum has to be a power of
frequency. A mode of the boom and one of the vane look alike. Hz. Sources: Whittle 1953; Percival and Walden 1993,
chapter 6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from station.numerics.regression import NotIdentifiable

Array = NDArray[np.float64]

LOWEST_HZ: Final = 2.0
"""Below, the aircraft's motion shapes the spectrum."""
LEAST_BINS: Final = 12
BY_CHANCE: Final = 1e-4
"""Probability with which a spectrum without a mode is said to have one."""
STARTS: Final = 8
"""Frequencies that the fit begins with, spread evenly over the band's logarithm."""
START_DAMPING: Final = 0.2
ROUNDS: Final = 40
SETTLED: Final = 1e-3
"""Deviance by which a step no longer improves the fit."""
DAMPED: Final = 0.7
"""From here on there is no peak."""
WITHOUT: Final = 3
"""Parameters of a spectrum without a mode."""
_STEP: Final = 1e-5
"""Of the central differences, in logarithms."""
_STUCK: Final = 1e9
"""Damping of the scoring's steps at which none improves the fit."""


@dataclass(frozen=True, slots=True)
class Mode:
    """Frequency (Hz) and damping with standard deviations; `density` (bins,), the whole model; `floor`, what the noise
    has of it, in the density's unit; `gain`, the deviance less than without a mode."""

    frequency_hz: float
    frequency_sd: float
    damping: float
    damping_sd: float
    density: Array
    floor: float
    gain: float


def find_mode(frequencies_hz: Array, density: Array, independent: Array, nyquist_hz: float) -> Mode:
    """In densities (bins,) that are means of `independent` values of their own each, sampled at twice `nyquist_hz`.
    Raises NotIdentifiable where no mode stands out, saying why."""
    inside = (frequencies_hz >= LOWEST_HZ) & (density > 0)
    f, p, n = frequencies_hz[inside], density[inside], independent[inside]
    seen = _Seen(f, p, n, nyquist_hz)
    if len(f) < LEAST_BINS:
        raise NotIdentifiable(f"{len(f)} bins above {LOWEST_HZ:g} Hz: too few to show a mode")
    line = np.polyfit(np.log(f), np.log(p), 1)
    floor = math.log(float(np.min(p)))
    without, _ = _fitted(np.array([line[1], line[0], floor]), seen)
    best, least = None, math.inf
    for f0 in np.geomspace(f[0], f[-1], STARTS + 2)[1:-1]:
        start = np.array([line[1], line[0], floor, math.log(f0), math.log(START_DAMPING)])
        deviance, found = _fitted(start, seen)
        if deviance < least and f[0] < math.exp(found[3]) < f[-1]:
            best, least = found, deviance
    # A mode may show anywhere in the band: as many chances as it has bins.
    gain = without - least
    if best is None or chi2.sf(gain, 2) * len(f) > BY_CHANCE:
        band = f"{f[0]:.2g} and {f[-1]:.2g} Hz"
        raise NotIdentifiable(f"no mode stands out between {band}: below the noise, or not moved by gusts")
    slopes = _slopes(best, f, nyquist_hz)
    covariance = np.linalg.pinv((slopes * n[:, None]).T @ slopes)
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    f0, zeta = math.exp(best[3]), math.exp(best[4])
    if zeta > DAMPED:
        raise NotIdentifiable(f"what stands out about {f0:.2g} Hz is damped by {zeta:.2g}: no mode")
    everywhere = np.exp(_model(best, frequencies_hz, nyquist_hz))
    return Mode(f0, f0 * float(sd[3]), zeta, zeta * float(sd[4]), everywhere, math.exp(best[2]), gain)


class _Seen(NamedTuple):
    """Densities `p` (bins,) at `f`, Hz, means of `n` values each."""

    f: Array
    p: Array
    n: Array
    nyquist_hz: float


def _model(theta: Array, f: Array, nyquist_hz: float) -> Array:
    """ln S, (bins,)."""
    folded = np.stack([f, 2 * nyquist_hz - f, 2 * nyquist_hz + f])
    through = theta[0] + theta[1] * np.log(folded)
    if len(theta) > WITHOUT:
        ratio, zeta = folded / math.exp(theta[3]), math.exp(theta[4])
        through = through - np.log((1 - ratio**2) ** 2 + (2 * zeta * ratio) ** 2)
    return np.asarray(np.logaddexp(np.logaddexp.reduce(through, axis=0), theta[2]))


def _slopes(theta: Array, f: Array, nyquist_hz: float) -> Array:
    """d ln S/d theta, (bins, parameters)."""
    made = []
    for i in range(len(theta)):
        h = np.zeros(len(theta))
        h[i] = _STEP
        made.append((_model(theta + h, f, nyquist_hz) - _model(theta - h, f, nyquist_hz)) / (2 * _STEP))
    return np.stack(made, axis=1)


def _fitted(theta: Array, seen: _Seen) -> tuple[float, Array]:
    """Deviance (-2 ln of Whittle's likelihood, but for a constant) and parameters of the maximum, by Fisher's scoring
    with damped steps (Levenberg)."""
    f, p, n, nyquist = seen

    def deviance(theta: Array) -> float:
        level = _model(theta, f, nyquist)
        return float(2 * np.sum(n * (level + np.exp(np.log(p) - level))))

    at, damping = deviance(theta), 1e-3
    for _ in range(ROUNDS):
        slopes = _slopes(theta, f, nyquist)
        score = slopes.T @ (n * (np.exp(np.log(p) - _model(theta, f, nyquist)) - 1.0))
        information = (slopes * n[:, None]).T @ slopes
        step = np.linalg.solve(information + damping * np.diag(np.diag(information) + 1e-9), score)
        new = theta + np.clip(step, -1.0, 1.0)
        made = deviance(new)
        if made < at:
            done = at - made < SETTLED
            theta, at, damping = new, made, damping / 10
            if done:
                break
        else:
            damping *= 10
            if damping > _STUCK:
                break
    return at, theta
