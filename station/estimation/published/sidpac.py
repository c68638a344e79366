"""Recursive Fourier equation error as in two published programs, only for comparison with their results.

`recursive_fourier`: as SIDPAC 2.0's rtpid. Every second sample, the first sample subtracted, no filter, no window, no
constant column, a weak prior at zero, an estimate each second from 2 s on.
`appendix1`: as Martos 2013, Appendix 1. Every sample, the first one subtracted, a fourth-order 0.02 Hz high-pass begun
at rest, Cm from j omega times the transform of the angular momentum.

Equation, per frequency: Z(f) = X(f) p, complex least squares with real p (Morelli, AIAA 2000; Klein and Morelli 2006,
section 7.2). The errors are not corrected for coloured residuals and shrink with a finer grid; those of the
station's own methods are corrected for both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, lfilter

from station.numerics.regression import NotIdentifiable

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

GRID_36: Final = (0.10, 0.04, 36)
"""First frequency and step, Hz, and number of lines: SIDPAC's example."""
GRID_191: Final = (0.10, 0.01, 191)
"""The dissertation's grid."""
_PRIOR: Final = 1e-6
"""Inverse of the prior's variance."""
SINGULAR: Final = 1e12
_HIGH_PASS_HZ: Final = 0.02


@dataclass(frozen=True, slots=True)
class History:
    """Estimates as they came: t_s (k,), estimate and se (k, m), s2 (k,) residual variance per line."""

    t_s: Array
    estimate: Array
    se: Array
    s2: Array


def grid(first_step_count: tuple[float, float, int]) -> Array:
    """Frequencies, Hz."""
    first, step, count = first_step_count
    return first + step * np.arange(count, dtype=np.float64)


def recursive_fourier(regressors: Array, measured: Array, dt: float, frequencies_hz: Array) -> History:
    """Estimates of `measured` (n,) on `regressors` (n, m) at t = 2, 3, .. s less one sample.

    Raises NotIdentifiable for a record shorter than 2 s, missing samples and regressors without excitation.
    """
    x = _from_first(np.column_stack([regressors, measured]))
    return _history(x[1::2], 2 * dt, dt, len(x), frequencies_hz, 2)


def appendix1(regressors: Array, measured: Array, dt: float, frequencies_hz: Array) -> History:
    """As `recursive_fourier`, by the dissertation's Appendix 1, for a force coefficient."""
    x = _high_passed(np.column_stack([regressors, measured]), dt)
    return _history(x, dt, dt, len(x), frequencies_hz, 1)


def appendix1_moment(regressors: Array, momentum: Array, rest: Array, dt: float, frequencies_hz: Array) -> History:
    """As `appendix1` for a moment coefficient: d(momentum)/dt + rest, differentiated in the frequency domain.

    For Cm: momentum q Iyy/(qbar S c), rest [Ixz (p^2 - r^2) + (Ixx - Izz) p r]/(qbar S c).
    """
    x = _high_passed(np.column_stack([regressors, rest, momentum]), dt)
    return _history(x, dt, dt, len(x), frequencies_hz, 1, momentum=True)


def _from_first(x: Array) -> Array:
    if not np.isfinite(x).all():
        raise NotIdentifiable("missing or non-finite samples")
    centred: Array = x - x[0]
    return centred


def _high_passed(x: Array, dt: float) -> Array:
    b, a = butter(4, 2 * dt * _HIGH_PASS_HZ, "high")
    filtered: Array = lfilter(b, a, _from_first(x), axis=0)
    return filtered


def _history(
    x: Array, step: float, dt: float, n: int, frequencies_hz: Array, stride: int, *, momentum: bool = False
) -> History:
    omega = 2 * np.pi * frequencies_hz
    second, start = round(1 / dt), round(2 / dt)
    # Sample numbers count from 1; with an odd number a second only every other second falls on a used sample.
    instants = [k for k in range(stride, n + 1, stride) if k >= start and k % second == 0]
    if not instants:
        raise NotIdentifiable("a record of at least 2 s is needed")
    total: Complex = np.zeros((len(omega), x.shape[1]), dtype=np.complex128)
    used = 0
    rows = []
    for k in instants:
        until = k // stride
        phase = np.exp(-1j * np.outer(omega, np.arange(used, until) * step))
        total = total + phase @ x[used:until]
        used = until
        z = total[:, -1]
        regressors = total[:, :-1]
        if momentum:
            z = 1j * omega * z + total[:, -2]
            regressors = total[:, :-2]
        rows.append(_solve(regressors, z))
    estimate, se, s2 = (np.array(column) for column in zip(*rows, strict=True))
    return History(t_s=(np.array(instants) - 1) * dt, estimate=estimate, se=se, s2=s2)


def _solve(x: Complex, z: Complex) -> tuple[Array, Array, float]:
    lines, m = x.shape
    if lines <= m:
        raise NotIdentifiable(f"{lines} frequencies for {m} parameters")
    information = (x.conj().T @ x).real
    right = (x.conj().T @ z).real
    scale = np.sqrt(np.diag(information))
    if (scale == 0).any() or np.linalg.cond(information / np.outer(scale, scale)) > SINGULAR:
        raise NotIdentifiable("a regressor without excitation, or collinear regressors")
    plain = np.linalg.solve(information, right)
    residual = z - x @ plain
    s2 = float((residual.conj() @ residual).real) / (lines - m)
    if s2 == 0:
        return np.asarray(plain, dtype=np.float64), np.zeros(m), s2
    covariance = np.linalg.inv(information / s2 + _PRIOR * np.eye(m))
    estimate: Array = covariance @ right / s2
    return estimate, np.sqrt(np.diag(covariance)), s2


def r_squared(regressors: Array, measured: Array, estimate: Array) -> float:
    """Share of the record's variance that the estimate explains in the time domain, with a free constant."""
    residual = measured - regressors @ estimate
    return 1.0 - float(np.var(residual) / np.var(measured))
