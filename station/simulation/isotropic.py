"""Cross-spectra, along the way flown, of isotropic turbulence at points abreast of each other.

Velocities a vector r apart correlate as sigma^2 (g delta_ij + (f - g) r_i r_j / r^2), g = f + r f'/2 (Batchelor 1953).
With
    f(r) = 2^(1-n) / Gamma(n) (a r)^n K_n(a r)
it is Dryden's field for n = 1/2 and a = 1/L, f = exp(-r/L), and von Karman's for n = 1/3 and a = 1/(1.339 L). The
transform over the separation along the way, that abreast (eta) held, of (a r)^m K_m(a r) is (Gradshteyn, Ryzhik 6.726)
    F_m = sqrt(2 pi) a^2m (eta/q)^(m+1/2) K_(m+1/2)(eta q),   q^2 = a^2 + kappa^2
and the cross-spectra are sums of F_(n-1), F_n and F_(n+1). At eta = 0 they are the spectra of MIL-F-8785C.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_CLOSE: Final = 1e-9
"""eta q below which points are at one place: the spectra there no longer change, and K_n overflows nothing yet."""
_VON_KARMAN: Final = 1.339
"""L over the length in von Karman's f, so that L is the integral scale along the way; MIL-F-8785C 3.7.1.1."""


class Kind(NamedTuple):
    """Which f: its exponent n, and a L."""

    exponent: float
    rate: float


DRYDEN: Final = Kind(0.5, 1.0)
VON_KARMAN: Final = Kind(1.0 / 3.0, 1.0 / _VON_KARMAN)
KINDS: Final = {"dryden": DRYDEN, "von_karman": VON_KARMAN}


class CrossSpectra(NamedTuple):
    """Of unit variance, two-sided over kappa (rad/m): the integral over all kappa is 2 pi at one place, m."""

    along: Array
    """u with u,"""
    sideways: Array
    """v with v,"""
    up: Array
    """w with w; w goes with neither of the others in one plane."""
    along_sideways: Array
    """The imaginary part, all there is, of u at a point with v `abreast` to its right, E u(0) v(eta) exp(-i kappa xi);
    v at the one with u at the other is the same."""


def cross_spectra(kind: Kind, length: float, kappa: Array, abreast: Array) -> CrossSpectra:
    """kappa (k,), rad/m; abreast (m,), of either sign, m; each (k, m). `length`: L, m."""
    from scipy.special import gamma, kv

    n, a = kind.exponent, kind.rate / length
    q = np.sqrt(a * a + kappa[:, None] ** 2)
    eta = np.maximum(np.abs(abreast)[None, :], _CLOSE / q)

    z = eta * q
    low, high = kv(n - 0.5, z), kv(n + 0.5, z)
    scale = 2.0 ** (1.0 - n) / gamma(n) * math.sqrt(2.0 * math.pi)

    def transformed(m: float, bessel: Array) -> Array:
        out: Array = scale * a ** (2.0 * m) * (eta / q) ** (m + 0.5) * bessel
        return out

    before, at = transformed(n - 1.0, low), transformed(n, high)
    after = transformed(n + 1.0, low + (2.0 * n + 1.0) / z * high)
    oblique = 0.5 * a * a * eta * eta * before
    up = (1.0 + n) * at - 0.5 * after
    crossed = -0.5 * abreast[None, :] * kappa[:, None] * at
    return CrossSpectra(at - oblique, up + oblique, up, crossed)
