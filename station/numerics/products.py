"""Products of small matrices, and what is solved with them, summed in one order on every processor.

OpenBLAS and LAPACK have kernels for each kind of processor, whose sums differ in the last bits; what is estimated in
flight, and the constants that it rests on, are to be the same wherever a recording is replayed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

_TERMS: Final = 20
"""Of the exponential's series where the matrix is below _SMALL: the next is 0.25^21/21!, 1e-32."""
_SMALL: Final = 0.25


@njit(cache=True, error_model="numpy")
def product(a: Array, b: Array) -> Array:
    """(n, k) by (k, m)."""
    out = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            for j in range(b.shape[1]):
                out[i, j] += a[i, k] * b[k, j]
    return out


@njit(cache=True, error_model="numpy")
def weighted_squares(x: Array, weights: Array) -> Array:
    """x diag(weights) x' of x (n, k)."""
    n = x.shape[0]
    out = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            for k in range(x.shape[1]):
                out[i, j] += x[i, k] * weights[k] * x[j, k]
    return out


@njit(cache=True, error_model="numpy")
def applied(a: Array, x: Array) -> Array:
    """(n, k) to a vector (k,)."""
    out = np.zeros(a.shape[0])
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            out[i] += a[i, k] * x[k]
    return out


def exponential(matrix: Array) -> Array:
    """Of a small square matrix: its series, squared again as often as it had to be halved."""
    halvings = max(0, math.ceil(math.log2(max(float(np.abs(matrix).max()) * len(matrix) / _SMALL, 1.0))))
    scaled = matrix * 0.5**halvings
    term = out = np.eye(len(matrix))
    for n in range(1, _TERMS + 1):
        term = _multiplied(term, scaled) / n
        out = out + term
    for _ in range(halvings):
        out = _multiplied(out, out)
    return out


def _multiplied(a: Array, b: Array) -> Array:
    """As `product`, of a few numbers, without compiling."""
    rows, columns = a.tolist(), b.T.tolist()
    return np.array([[math.fsum(x * y for x, y in zip(r, c, strict=True)) for c in columns] for r in rows])


def fitted(matrix: Array, wanted: Array) -> Array:
    """The least-squares solution (n, r) of matrix (m, n), of full rank, times it = wanted (m, r), by Householder's
    reflections."""
    n = matrix.shape[1]
    a = np.concatenate((matrix, wanted), axis=1)
    for k in range(n):
        v = a[k:, k].copy()
        v[0] += math.copysign(math.sqrt(_square(v)), v[0])
        along = np.zeros(a.shape[1] - k)
        for x, row in zip(v, a[k:, k:], strict=True):
            along += x * row
        a[k:, k:] -= (2.0 / _square(v)) * (v[:, None] * along)
    out = np.zeros((n, wanted.shape[1]))
    for k in reversed(range(n)):
        left = a[k, n:].copy()
        for j in range(k + 1, n):
            left -= a[k, j] * out[j]
        out[k] = left / a[k, k]
    return out


def _square(v: Array) -> float:
    return math.fsum(x * x for x in v.tolist())


def settled(sections: Sequence[Sequence[float]]) -> Array:
    """(sections, 2): states of second-order sections (b0, b1, b2, 1, a1, a2), in a row, that a unit input has long been
    in; transposed direct form II."""
    out, gain = [], 1.0
    for b0, b1, b2, _, a1, a2 in sections:
        y = (b0 + b1 + b2) / (1.0 + a1 + a2)
        out.append((gain * (y - b0), gain * (b2 - a2 * y)))
        gain *= y
    return np.array(out)
