"""Backlash and nonlinearity of a sensor: the lost motion behind it, and the true value of a cubic reading."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.estimation import instrument_errors as instruments

Array = NDArray[np.float64]


@njit(cache=True)
def _lost_motion(x: Array, width: float, out: Array) -> None:
    for i in range(x.shape[0]):
        at = x[i, 0]
        for k in range(x.shape[1]):
            at = instruments.dragged(at, x[i, k], width)
            out[i, k] = at - x[i, k]


@njit(cache=True)
def _linearise(x: Array, cubic: float, out: Array) -> None:
    for k in range(x.shape[0]):
        out[k] = instruments.straightened(x[k], cubic)


def lost_motion(x: Array, width: float) -> Array:
    """The lost motion: position of a part with backlash `width` less that of x (..., n) which drives it; x starts in
    the middle of the backlash."""
    flat = np.ascontiguousarray(x).reshape(-1, x.shape[-1])
    out = np.empty_like(flat)
    _lost_motion(flat, width, out)
    return out.reshape(x.shape)


def smoothed(x: Array, width: float) -> Array:
    """Lost motion (..., n) that delays nothing: the mean of that of x (..., n) and of x played backwards. Added to x,
    it takes out what moves within `width`, in the unit of x, while x rests."""
    forwards, backwards = lost_motion(x, width), lost_motion(x[..., ::-1], width)[..., ::-1]
    return np.asarray(0.5 * (forwards + backwards))


def linearised(shown: Array, cubic: float) -> Array:
    """The true x of a sensor that reads x + cubic x3; beyond the turning point of that, the turning point."""
    flat = np.ascontiguousarray(shown).ravel()
    out = np.empty_like(flat)
    _linearise(flat, cubic, out)
    return out.reshape(np.shape(shown))
