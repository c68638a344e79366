"""Aliasing: what lies above half a record's rate folds into the lines that are analysed, and no residual tells of it.

A gust above half the rate reaches vane and wing with another delay than the line that it is taken for, and attenuates
what is fitted. Vane, lift and moment have it from one and the same gust: its share of the lift may come twice, in the
lift and in the angle of attack that the lift is of. Sampling: Bendat and Piersol 2010, Random data, section 10.3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import detrend, periodogram

from station.conventions import LATERAL
from station.estimation.acceptance import EXCITED
from station.estimation.flight_record import FlightRecord
from station.estimation.results import Axes, MethodResult, equations
from station.numerics.default_noise import DEFAULT_NOISE

Array = NDArray[np.float64]

FALLS: Final = -3.0
"""Power of frequency by which an acceleration's spectrum falls above half the rate: -5/3 of the gusts' own (inertial
subrange; Kolmogorov 1941), the rest of the lift's lag over chord and span; so does a control step by an actuator."""
NEXT_TO_HALF: Final = 0.8
"""Share of half the rate above which the spectrum tells how much there is beyond."""
ORDERS: Final = 20
"""Multiples of the rate about which the spectrum folds; what lies above is a thousandth of it."""
SURE: Final = 3.0
"""Standard errors of the noise's mean power."""
HANN: Final = 1.5
"""Lines that count as one: a Hann window leaves so many correlated (Harris 1978)."""
TWICE: Final = 2.0
"""In the lift, and in the angle of attack that it is of."""
NOTABLE: Final = 0.1
"""Share of a derivative from which the error is told of; smaller ones are within those of mass and inertia."""


def folded_share(x: Array, dt: float, band_hz: tuple[float, float], noise: float) -> float:
    """Share of a signal's amplitude in `band_hz` that is folded from above half its rate. `noise`: its sensor's
    standard deviation. The spectrum next to half the rate, less the noise, is continued by FALLS."""
    f, power = periodogram(detrend(x), 1 / dt, window="hann")
    white = 2 * dt * noise**2
    half = 0.5 / dt
    order = 2.0 * np.arange(1, ORDERS + 1)[:, None]
    folded = ((order - f / half) ** FALLS + (order + f / half) ** FALLS).sum(0)
    top = (f > NEXT_TO_HALF * half) & (f < half)
    if not top.any():
        return 0.0
    # Of the noise no more is left than its mean may be off by.
    beyond = power[top].mean() - white * (1.0 + SURE * math.sqrt(HANN / top.sum()))
    level = max(beyond, 0.0) / ((f[top] / half) ** FALLS + folded[top]).mean()
    band = (f >= band_hz[0]) & (f <= band_hz[1])
    there = (power[band] - white).sum()
    return float(np.sqrt(min(level * folded[band].sum() / there, 1.0))) if there > 0.0 else 0.0


@dataclass(frozen=True, slots=True)
class Folded:
    """Of an axis."""

    share: float
    """By which its derivatives may be wrong."""
    along: Mapping[str, float]
    """By how much each of an equation's moves with the one by the angle of flow: they make up for its change."""


def folded(record: FlightRecord, band_hz: tuple[float, float], axes: Axes) -> dict[str, Folded]:
    """By the first derivative of each equation, what folding does to it."""
    found = {}
    for equation in equations(record, axes):
        name = "ay" if equation.parameters[0] in LATERAL else "az"
        x, noise = record.motion[name], record.noise.get(name, DEFAULT_NOISE[name])
        rows = np.isfinite(x) & np.isfinite(equation.regressors).all(axis=1)
        if rows.sum() < len(x) / 2 or np.var(x[rows]) < EXCITED * noise**2:
            continue
        share = TWICE * folded_share(np.interp(record.t_s, record.t_s[rows], x[rows]), record.dt, band_hz, noise)
        inverse = np.linalg.pinv(np.cov(equation.regressors[rows].T))
        if not inverse[0, 0] > 0.0:
            continue
        along = dict(zip(equation.parameters, (inverse[0] / inverse[0, 0]).tolist(), strict=True))
        found[equation.parameters[0]] = Folded(share, along)
    return found


def wrong_by(folds: Mapping[str, Folded], result: MethodResult) -> dict[str, float]:
    """Standard deviation of each of a method's derivatives, by `folded`."""
    value = {p.name: p.value for p in result.parameters if math.isfinite(p.value)}
    return {
        name: fold.share * (abs(value[name]) if name == first else math.hypot(value[name], by * value.get(first, 0.0)))
        for first, fold in folds.items()
        for name, by in fold.along.items()
        if fold.share and name in value
    }


def about_folding(folds: Mapping[str, Folded], dt: float) -> list[str]:
    """The remark where errors are much wider for it."""
    share = max((fold.share for fold in folds.values()), default=0.0)
    if share < NOTABLE:
        return []
    said = f"recorded at {1 / dt:.3g} Hz: what moves faster than {0.5 / dt:.3g} Hz is aliased into the band"
    return [f"{said}; standard errors hold {share:.0%} of each estimate for it"]
