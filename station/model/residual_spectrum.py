"""Spectra of residuals, log-quadratic in frequency, and the deviance of a residual whose spectrum is such."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.model.physical_columns import DE, QH
from station.model.physical_signals import GC, GT, X
from station.numerics.products import applied
from station.numerics.regression import invert

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PASSES: Final = 4
"""Of re-weighted least squares, each with the residuals' spectra of the pass before."""
EQUATIONS: Final = 2
MOST_COHERENT: Final = 0.9
ORDER: Final = 3.5
"""Residual energy is scaled by n/(n - ORDER): parameters used up by each equation."""
SCORINGS: Final = 5
LARGEST_STEP: Final = 2.0
"""Of the logarithm of a line's energy, in a scoring: a line far above the curve would throw it."""


class Weighting(NamedTuple):
    """What both equations are divided by, so that their residuals are white."""

    spectrum: Array
    """Of the residuals, (2, frequencies)."""
    coherence: NDArray[np.complex128]
    """Of the two, (1,)."""


@njit(cache=True, error_model="numpy")
def _quadratic(omega: Array, z: Array, zz: Array) -> None:
    """Powers 0 to 2 of the logarithm of frequency, `z` (frequencies, 3), and their products, `zz` (3, 3)."""
    for i in range(omega.shape[0]):
        u = math.log(omega[i] / math.pi)
        z[i, 0], z[i, 1], z[i, 2] = 1.0, u, u * u
        for a in range(3):
            for b in range(3):
                zz[a, b] += z[i, a] * z[i, b]


@njit(cache=True, error_model="numpy")
def residual_spectrum(residual: Complex, omega: Array, smooth: Array) -> None:
    """Log-quadratic spectrum of a residual, by gamma regression from a logarithmic start -> `smooth` (frequencies,)."""
    lines = omega.shape[0]
    z = np.empty((lines, 3))
    power = np.empty(lines)
    zz = np.zeros((3, 3))
    _quadratic(omega, z, zz)
    for i in range(lines):
        power[i] = residual[i].real ** 2 + residual[i].imag ** 2 + 1e-300
    inverse = np.empty((3, 3))
    if not invert(zz, 3, inverse):
        smooth[:] = power.mean()
        return
    beta = np.zeros(3)
    for k in range(SCORINGS):
        score = np.zeros(3)
        for i in range(lines):
            level = beta[0] * z[i, 0] + beta[1] * z[i, 1] + beta[2] * z[i, 2]
            # E ln|r|^2 of a complex normal is 0.577 below the logarithm of its mean.
            excess = math.log(power[i]) + 0.5772156649 if k == 0 else power[i] / math.exp(level) - 1.0
            for a in range(3):
                score[a] += z[i, a] * excess
        step = applied(inverse, score)
        most = 0.0
        for i in range(lines):
            most = max(most, abs(step[0] + step[1] * z[i, 1] + step[2] * z[i, 2]))
        shorter = LARGEST_STEP / most if k > 0 and most > LARGEST_STEP else 1.0
        for a in range(3):
            beta[a] += shorter * step[a]
    for i in range(lines):
        smooth[i] = math.exp(beta[0] + beta[1] * z[i, 1] + beta[2] * z[i, 2])


@njit(cache=True, error_model="numpy")
def weigh(residual: Complex, omega: Array, has_moment: bool, weighting: Weighting) -> None:
    """Spectra of both residuals (2, frequencies), and how coherent they are."""
    lines, spectrum = omega.shape[0], weighting.spectrum
    for q in range(EQUATIONS):
        residual_spectrum(residual[q], omega, spectrum[q])
        for i in range(lines):
            spectrum[q, i] *= lines / (lines - ORDER)
    if not has_moment:
        return
    product = 0.0j
    for i in range(lines):
        product += residual[0, i] * np.conj(residual[1, i]) / math.sqrt(spectrum[0, i] * spectrum[1, i])
    coherence = product / lines
    if abs(coherence) > MOST_COHERENT:
        coherence *= MOST_COHERENT / abs(coherence)
    weighting.coherence[0] = coherence


@njit(cache=True, error_model="numpy")
def deviance(residual: Complex, omega: Array, smooth: Array) -> float:
    """-2 log likelihood of a residual whose spectrum is log-quadratic, but for a constant."""
    residual_spectrum(residual, omega, smooth)
    total = 0.0
    for i in range(omega.shape[0]):
        total += 2.0 * (math.log(smooth[i]) + (residual[i].real ** 2 + residual[i].imag ** 2) / smooth[i])
    return total


@njit(cache=True, error_model="numpy")
def quasi_steady_deviance(f: Complex, rho: Array, z: Complex, omega: Array, smooth: Array) -> float:
    """Deviance of z = c_alpha (x + g_cg) + c_q qhat + c_de de + c_d (g_cg - g_tail), generalised least squares: what
    split+gust assumes, and in calm air split. The last term costs a parameter (Schwarz 1978)."""
    lines = omega.shape[0]
    g = np.empty((4, lines), dtype=np.complex128)
    gust = 0.0
    for i in range(lines):
        g[0, i], g[1, i], g[2, i] = f[X, i] + rho[i] * f[GC, i], f[QH, i], f[DE, i]
        g[3, i] = rho[i] * (f[GC, i] - f[GT, i])
        gust += abs(g[3, i])
    n = 4 if gust > 0.0 else 3
    residual = z.copy()
    smooth[:] = 1.0
    inverse = np.empty((n, n))
    for k in range(PASSES):
        m = np.zeros((n, n))
        rhs = np.zeros(n)
        for i in range(lines):
            for a in range(n):
                rhs[a] += (g[a, i].real * z[i].real + g[a, i].imag * z[i].imag) / smooth[i]
                for b in range(n):
                    m[a, b] += (g[a, i].real * g[b, i].real + g[a, i].imag * g[b, i].imag) / smooth[i]
        if not invert(m, n, inverse):
            return math.inf
        theta = applied(inverse, rhs)
        for i in range(lines):
            residual[i] = z[i]
            for a in range(n):
                residual[i] -= theta[a] * g[a, i]
        if k < PASSES - 1:
            residual_spectrum(residual, omega, smooth)
    return deviance(residual, omega, smooth) + (n - 3) * math.log(2.0 * lines)
