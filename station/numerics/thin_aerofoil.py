"""Lift of a thin aerofoil in two dimensions by frequency: Theodorsen's function of its own motion, Sears' of a gust.

k = omega c/2V, the reduced frequency. Sources: Theodorsen 1935 (NACA report 496); Sears 1941.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import hankel2, jv

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_LEAST: Final = 1e-9
"""Reduced frequency below which the lift is steady."""


def theodorsen(k: Array) -> Complex:
    """C(k) = H1/(H1 + i H0), Hankel functions of the second kind: circulatory lift over its quasi-steady value."""
    k = np.maximum(np.asarray(k, dtype=np.float64), _LEAST)
    h0, h1 = hankel2(0, k), hankel2(1, k)
    return np.asarray(h1 / (h1 + 1j * h0))


def sears_magnitude(k: Array) -> Array:
    """|S(k)|, S = (J0 - i J1) C + i J1: lift of a sinusoidal gust over its quasi-steady value."""
    k = np.maximum(np.asarray(k, dtype=np.float64), _LEAST)
    return np.asarray(np.abs((jv(0, k) - 1j * jv(1, k)) * theodorsen(k) + 1j * jv(1, k)))
