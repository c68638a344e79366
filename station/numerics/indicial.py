"""Indicial responses: what an unsteady lift or upwash makes of an input sampled at every tick, or of a spectrum."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.profile import Indicial

Array = NDArray[np.float64]


class Response(NamedTuple):
    """1 - sum a exp(-b t), t in chords travelled; without terms: no delay."""

    a: Array
    b: Array


def response(indicial: Indicial | None) -> Response:
    """As the profile has it."""
    return Response(np.array(indicial.a), np.array(indicial.b)) if indicial else Response(np.zeros(0), np.zeros(0))


@njit(cache=True, error_model="numpy")
def frequency_response(of: Response, s: complex) -> complex:
    """What it makes of a harmonic; `s`: i omega per chord travelled."""
    h = 1.0 + 0.0j
    for j in range(of.a.shape[0]):
        h -= of.a[j] * s / (s + of.b[j])
    return h


@njit(cache=True)
def respond(
    s: Array, at: int, amplitudes: Array, rates: Array, n: int, before: float, now: float, chords: float
) -> float:
    """Indicial response 1 - sum a exp(-b t): exact first-order lags of an input linear between ticks."""
    value = now
    for j in range(n):
        x = rates[j] * chords
        decay = math.exp(-x)
        mean = (1.0 - decay) / x
        s[at + j] = decay * s[at + j] + (mean - decay) * before + (1.0 - mean) * now
        value += amplitudes[j] * (s[at + j] - now)
    return value
