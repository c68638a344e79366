"""Indicial responses 1 - sum a exp(-b t), t in chords travelled: what unsteady lift or upwash makes of an incidence.

In time the exponentials are first-order lags, exact for an input that is linear between samples; in frequency each is
a s/(s + b). Source: R. T. Jones, NACA report 681, 1940 (Wagner's and Kuessner's functions as sums of exponentials).
"""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from station.profile.aircraft import MOST_TERMS, Indicial

Array = NDArray[np.float64]


class Response(NamedTuple):
    """Amplitudes and rates of `n` terms; without terms: no delay."""

    n: int
    a: Annotated[Array, MOST_TERMS]
    b: Annotated[Array, MOST_TERMS]


def response(indicial: Indicial | None) -> Response:
    """As the profile has it; of amplitudes or rates that are columns, (MOST_TERMS, p, 1)."""
    if indicial is None:
        return Response(0, np.zeros(MOST_TERMS), np.zeros(MOST_TERMS))
    shape = np.broadcast_shapes(*(np.shape(x) for x in (*indicial.a, *indicial.b)))
    made = Response(len(indicial.a), np.zeros((MOST_TERMS, *shape)), np.zeros((MOST_TERMS, *shape)))
    for j, (a, b) in enumerate(zip(indicial.a, indicial.b, strict=True)):
        made.a[j], made.b[j] = a, b
    return made


@register_jitable
def frequency_response(of: Response, s: Any) -> Any:
    """What it makes of a harmonic; `s`: j omega per chord travelled, a number in compiled code, elsewhere an array
    too."""
    h = 1.0 + 0.0 * s
    for j in range(of.n):
        h = h - of.a[j] * s / (s + of.b[j])
    return h


@register_jitable
def lagged(state: float, before: float, now: float, steps: float) -> float:
    """A first-order lag's output after `steps` time constants, its input linear from `before` to `now`."""
    decay = math.exp(-steps)
    mean = (1.0 - decay) / steps
    return decay * state + (mean - decay) * before + (1.0 - mean) * now


@njit(cache=True)
def respond(of: Response, lags: Array, before: float, now: float, chords: float) -> float:
    """What it makes of an input that goes straight from `before` to `now` while `chords` are travelled; edits the
    first-order `lags` (MOST_TERMS,)."""
    value = now
    for j in range(of.n):
        lags[j] = lagged(lags[j], before, now, of.b[j] * chords)
        value += of.a[j] * (lags[j] - now)
    return value


@njit(cache=True, error_model="numpy")
def respond_throughout(of: Response, chords: Array, x: Array) -> Array:
    """A series x (n,) through an indicial response, over `chords` (n,) travelled in each step; settled on its first
    value."""
    out = x.copy()
    for k in range(of.n):
        state = x[0]
        for i in range(1, x.shape[0]):
            state = lagged(state, x[i - 1], x[i], of.b[k] * chords[i])
            out[i] += of.a[k] * (state - x[i])
    return out
