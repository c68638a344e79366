"""Derivatives of sampled signals: two rules for records, and the central difference of a tick.

    derivative       five points, fourth order: right to (omega dt)^4/30, 0.002 % at 1 Hz of 50 Hz. The rule wherever
                     noise is dealt with elsewhere: weighted, or smoothed.
    differentiate    five points, least-squares parabola: 0.57 (omega dt)^2 too small, 0.9 % at 1 Hz of 50 Hz, with a
                     quarter of the noise. SIDPAC's rule, for coefficients of a record of 40 Hz or more that method I
                     regresses.
    central          three points, 0.17 (omega dt)^2 too small: live, one tick late; transforms undo the loss by
                     spectra.central_difference_factor.

Source: Klein and Morelli 2006, section 11.4.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

Array = NDArray[np.float64]

_POINTS: Final = 5


def derivative(x: Array, dt: float) -> Array:
    """Central differences of fourth order, (..., n); of second order next to the ends, one-sided at them.

    Raises ValueError below two samples.
    """
    out = np.asarray(np.gradient(x, dt, axis=-1), dtype=np.float64)
    if out.shape[-1] >= _POINTS:
        out[..., 2:-2] = (8 * (x[..., 3:-1] - x[..., 1:-3]) - (x[..., 4:] - x[..., :-4])) / (12 * dt)
    return out


def differentiate(x: Array, dt: float) -> Array:
    """Slope of the least-squares parabola through five samples, (n,); at the ends that of the first or last five.

    Raises ValueError below five samples.
    """
    if len(x) < _POINTS:
        raise ValueError(f"a derivative needs at least {_POINTS} samples")
    inner = np.correlate(x, np.array([-2.0, -1.0, 0.0, 1.0, 2.0]), "valid") / (10 * dt)
    # The same parabola's slope two and one steps from its middle: 2 a t + b with a from the second differences.
    curve = np.array([2.0, -1.0, -2.0, -1.0, 2.0]) / (7 * dt)
    head, tail = x[:5] @ curve, x[-5:] @ curve
    first = [inner[0] - 2 * head, inner[0] - head]
    last = [inner[-1] + tail, inner[-1] + 2 * tail]
    return np.concatenate([first, inner, last])


def differentiate_factor(omega_dt: Array) -> Array:
    """What makes good what `differentiate` loses at each omega dt (rad, above 0)."""
    return np.asarray(10 * omega_dt / (2 * np.sin(omega_dt) + 4 * np.sin(2 * omega_dt)))


def white_variance(x: Array, order: int = 3) -> float:
    """Of the white noise on a smooth signal (n,), from its differences of that order, which have binomial(2 order,
    order) times the noise's variance; 0 below order + 1 samples."""
    if len(x) <= order:
        return 0.0
    return float(np.mean(np.diff(x, order) ** 2)) / math.comb(2 * order, order)


@register_jitable
def central(after: Any, before: Any, dt: float) -> Any:
    """Slope at the sample between two."""
    return (after - before) / (2.0 * dt)


@register_jitable
def backward(now: Any, before: Any, before_that: Any, dt: float) -> Any:
    """Slope now of the parabola through three samples."""
    return (3.0 * now - 4.0 * before + before_that) / (2.0 * dt)
