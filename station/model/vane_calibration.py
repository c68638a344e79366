"""Bias, scale and delay of a vane against the inertial flow angle at its place.

    vane(t) = bias + scale (a(t - delay) - (q x/V)(t - delay)) + e(t)                        (x: vane ahead of the CG)

a is the inertial angle of attack, from attitude and velocity through the mean air (inertial_path.py), so e holds gusts,
sensor noise and whatever is not linear. Where the motion explains most of the reading (calm air), least squares with
the errors of coloured residuals. Elsewhere a is in part the aircraft's answer to the gusts in e, which would take the
scale down: then generalised least squares with e as an autoregressive process. A gust reaches the vane before the
aircraft responds, so the innovation, after the prediction from the past, is independent of a(t). The delay is found by
scan and Gauss-Newton. The mean vertical wind is taken as 0: a steady updraught w adds scale w/V to the bias. SI, rad.

Sources: Klein and Morelli 2006, section 5.2 (coloured residuals) and chapter 10 (calibration against reconstructed flow
angles); Cochrane and Orcutt 1949; Ljung 1999, section 13.4 (prediction errors in closed loop).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from station.numerics.regression import NotIdentifiable, least_squares

Array = NDArray[np.float64]

MIN_S: Final = 10.0
DELAYS_S: Final = (-0.3, 0.6)
SCAN_S: Final = 0.01
ROUNDS: Final = 8
ORDERS: Final = (1, 2, 3, 4, 6, 8, 12, 16, 20, 30)
CALM_R2: Final = 0.8
"""Above it the motion explains the reading."""
EXCITED: Final = 4.0
"""Variance of the inertial angle over that of its noise."""


@dataclass(frozen=True, slots=True)
class Value:
    """An estimate and its standard deviation."""

    value: float
    sd: float


@dataclass(frozen=True, slots=True)
class VaneCalibration:
    """What turns the reading into the inertial angle: (reading - bias)/scale, `delay` earlier, with q x/V added."""

    bias: Value
    scale: Value
    delay: Value
    rms_before: float
    """Reading against the flow angle that the motion makes at the vane, rad."""
    rms_after: float
    """The same after bias, scale and delay."""
    r2: float
    """Share of the flow angle's variance that the calibrated reading explains."""
    is_calm: bool
    """False: found in spite of gusts, by generalised least squares."""
    expected: Array
    """(n,) rad: what the motion alone would make a perfect vane show."""
    corrected: Array
    """(n,) rad: the reading, calibrated and in time with it; NaN at an end that the delay reaches beyond."""


def calibrate_vane(reading: Array, inertial: Array, rate_term: Array, dt: float, noise: float = 0.0) -> VaneCalibration:
    """Calibrate `reading` by `inertial` (n,), rad, on a uniform grid, all finite.

    `rate_term`: q x/V (n,), rad; 0 where x is not known, which the delay then absorbs (in slow motion q x/V is a delay
    of x/V). `noise`: of the inertial angle, rad. Raises NotIdentifiable for a record too short, without motion, or in
    which the delay does not settle.
    """
    n = len(reading)
    if n * dt < MIN_S:
        raise NotIdentifiable(f"{n * dt:.0f} s of record: a vane calibration needs {MIN_S:g} s")
    if not (np.isfinite(reading).all() and np.isfinite(inertial).all() and np.isfinite(rate_term).all()):
        raise NotIdentifiable("missing samples")
    if np.var(inertial) <= EXCITED * noise**2 + 1e-10:
        raise NotIdentifiable("the inertial angle of attack hardly moves: fly a pitch input or a change of speed")
    flow = inertial - rate_term
    search = _Search(reading, flow, dt)
    is_calm = True
    bias, scale, delay = search.calm()
    corrected = _corrected(reading, bias.value, scale.value, delay.value, dt)
    r2, after = _explained(corrected, flow)
    if r2 < CALM_R2:
        is_calm = False
        bias, scale, delay = search.gusty()
        corrected = _corrected(reading, bias.value, scale.value, delay.value, dt)
        r2, after = _explained(corrected, flow)
    return VaneCalibration(
        bias=bias,
        scale=scale,
        delay=delay,
        rms_before=float(np.sqrt(np.mean((reading - flow) ** 2))),
        rms_after=after,
        r2=r2,
        is_calm=is_calm,
        expected=flow,
        corrected=corrected,
    )


def _corrected(reading: Array, bias: float, scale: float, delay: float, dt: float) -> Array:
    t = np.arange(len(reading)) * dt
    return np.asarray(np.interp(t + delay, t, (reading - bias) / scale, np.nan, np.nan))


def _explained(corrected: Array, flow: Array) -> tuple[float, float]:
    """Share of variance and rms difference, rows where there are both."""
    good = np.isfinite(corrected)
    rms = float(np.sqrt(np.mean((corrected - flow)[good] ** 2)))
    return 1 - rms**2 / float(np.var(flow[good])), rms


class _Search:
    """Regressions of the reading on the flow angle at any delay, through a whitening filter."""

    def __init__(self, reading: Array, flow: Array, dt: float) -> None:
        t = np.arange(len(reading)) * dt
        # Rows that every delay of the scan can reach.
        rows = slice(math.ceil(DELAYS_S[1] / dt), len(reading) - math.ceil(-DELAYS_S[0] / dt))
        self._z = reading[rows]
        self._t = t[rows]
        self._angle = CubicSpline(t, flow)
        self._scan = np.arange(DELAYS_S[0] + SCAN_S, DELAYS_S[1] - SCAN_S / 2, SCAN_S)

    def _level(self, delay: float) -> Array:
        return np.column_stack([np.ones(len(self._z)), self._angle(self._t - delay)])

    def _residual(self, delay: float, whitener: Array) -> tuple[Array, Array]:
        """Bias and scale at a delay, and their residual, not whitened."""
        x = self._level(delay)
        found = np.linalg.lstsq(whitened(x, whitener), whitened(self._z, whitener))[0]
        return np.asarray(found, dtype=np.float64), np.asarray(self._z - x @ found, dtype=np.float64)

    def calm(self) -> tuple[Value, Value, Value]:
        """By ordinary least squares."""
        return self._refined(self._best(np.array([1.0])), np.array([1.0]))

    def gusty(self) -> tuple[Value, Value, Value]:
        """By generalised least squares, the whitener found along with the rest."""
        delay = 0.0
        whitener = autoregression(self._residual(delay, np.array([1.0, -1.0]))[1])
        for _ in range(ROUNDS):
            before, delay = delay, self._best(whitener)
            whitener = autoregression(self._residual(delay, whitener)[1])
            if delay == before:
                break
        bias, scale, place = self._refined(delay, whitener)
        # The likelihood has several maxima; the distance between those of similar height counts to the delay's error.
        costs = self._costs(whitener)
        likelihood = (costs / costs.min()) ** (-0.5 * len(self._z))
        spread = float(np.sqrt(np.sum(likelihood * (self._scan - place.value) ** 2) / np.sum(likelihood)))
        return bias, scale, Value(place.value, math.hypot(place.sd, spread))

    def _best(self, whitener: Array) -> float:
        best = int(np.argmin(self._costs(whitener)))
        if not 0 < best < len(self._scan) - 1:
            raise NotIdentifiable(f"no delay of the vane between {DELAYS_S[0]:g} and {DELAYS_S[1]:g} s fits")
        return float(self._scan[best])

    def _costs(self, whitener: Array) -> Array:
        """Residual sum of squares of the whitened reading at each delay of the scan."""
        z = whitened(self._z, whitener)
        costs = []
        for delay in self._scan:
            x = whitened(self._level(float(delay)), whitener)
            found = np.linalg.lstsq(x, z)[0]
            residual = z - x @ found
            costs.append(float(residual @ residual) if found[1] > 0 else math.inf)
        return np.array(costs)

    def _refined(self, delay: float, whitener: Array) -> tuple[Value, Value, Value]:
        z, at = whitened(self._z, whitener), self._t
        scale = self._residual(delay, whitener)[0][1]
        for _ in range(ROUNDS):
            slope = -scale * self._angle(at - delay, 1)
            x = whitened(np.column_stack([self._level(delay), slope]), whitener)
            found = np.linalg.lstsq(x, z)[0]
            scale = found[1]
            delay += float(np.clip(found[2], -SCAN_S, SCAN_S))
        fit = least_squares(x, z)
        sd = fit.se_coloured.tolist()
        bias, slope_, _ = fit.estimate.tolist()
        return Value(bias, sd[0]), Value(slope_, sd[1]), Value(delay, sd[2])


def whitened(x: Array, coefficients: Array) -> Array:
    """A(L) x without the first rows, whose past is missing; x (n,) or (n, m)."""
    return np.asarray(lfilter(coefficients, [1.0], x, axis=0)[len(coefficients) - 1 :])


def autoregression(residual: Array) -> Array:
    """(1, a1 ... ap): the filter that whitens a series, Yule-Walker, order by Akaike's criterion."""
    e = residual - residual.mean()
    r = np.array([e[: len(e) - k] @ e[k:] for k in range(ORDERS[-1] + 1)]) / len(e)
    best, made = math.inf, np.array([1.0])
    for order in ORDERS:
        a = solve_toeplitz(r[:order], r[1 : order + 1])
        variance = float(r[0] - a @ r[1 : order + 1])
        score = len(e) * math.log(max(variance, 1e-30)) + 2 * order
        if score < best:
            best, made = score, np.concatenate([[1.0], -a])
    return made
