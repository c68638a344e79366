"""Indicial responses: what an unsteady lift or upwash makes of an input sampled at every tick, or of a spectrum."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.profile.aircraft import MOST_TERMS, Indicial

Array = NDArray[np.float64]


class Response(NamedTuple):
    """1 - sum a exp(-b t), t in chords travelled, of `n` terms; without terms: no delay."""

    n: int
    a: Annotated[Array, MOST_TERMS]
    b: Annotated[Array, MOST_TERMS]


def response(indicial: Indicial | None) -> Response:
    """As the profile has it."""
    made = Response(len(indicial.a) if indicial else 0, np.zeros(MOST_TERMS), np.zeros(MOST_TERMS))
    if indicial is not None:
        made.a[: made.n], made.b[: made.n] = indicial.a, indicial.b
    return made


@njit(cache=True, error_model="numpy")
def frequency_response(of: Response, s: complex) -> complex:
    """What it makes of a harmonic; `s`: i omega per chord travelled."""
    h = 1.0 + 0.0j
    for j in range(of.n):
        h -= of.a[j] * s / (s + of.b[j])
    return h


@njit(cache=True)
def respond(of: Response, lags: Array, before: float, now: float, chords: float) -> float:
    """What it makes of an input that goes straight from `before` to `now` while `chords` are travelled; edits the
    first-order `lags` (MOST_TERMS,), exactly."""
    value = now
    for j in range(of.n):
        x = of.b[j] * chords
        decay = math.exp(-x)
        mean = (1.0 - decay) / x
        lags[j] = decay * lags[j] + (mean - decay) * before + (1.0 - mean) * now
        value += of.a[j] * (lags[j] - now)
    return value
