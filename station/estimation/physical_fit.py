"""Generalised least squares of both longitudinal equations (physical_columns.py) with uncertain constants.

The constants that the profile gives (tail's share, arm and downwash, boom length, memories ...) are known to a prior
standard deviation. Some are estimated along, as far as the gust moves them; the rest of each, and the others, are
considered: they widen the total standard error. Residual spectra are log-quadratic in frequency and re-estimated
(feasible GLS). The statistical error is the larger of the parametric one and a sum of score products over neighbouring
lines (Newey and West 1987). SI, radians.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.estimation.physical_columns import (
    A_H,
    ARM,
    CL,
    CL_ALPHA,
    CM,
    CM_ALPHA,
    DE,
    HAS_MOMENT,
    KNOWN_AT,
    LEARNT_AT,
    N_LEARNT,
    PARAMETERS,
    QH,
    N,
    columns,
    design,
    wiener,
)
from station.estimation.physical_signals import GC, X

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PASSES: Final = 4
QUALITY: Final = 7
ORDER: Final = 3.5
"""Residual energy is scaled by n/(n - ORDER): parameters used up by each equation."""
SMALL_RECORD: Final = 1.2
"""On statistical standard errors: weights and errors come from the residuals of one short record. From Monte Carlo, so
that 95 % intervals cover 95 %."""
SECOND_ORDER: Final = 1.7
"""On them within the total ones: several constants wrong at once do more than the sum of each. From Monte Carlo."""


@njit(cache=True, error_model="numpy")
def _invert(m: Array, inverse: Array) -> bool:
    """inverse <- m^-1 by Gauss-Jordan on the scaled matrix, m symmetric positive; False if singular."""
    n = m.shape[0]
    work = np.zeros((n, 2 * n))
    scale = np.empty(n)
    for i in range(n):
        if not (m[i, i] > 0.0 and math.isfinite(m[i, i])):
            return False
        scale[i] = 1.0 / math.sqrt(m[i, i])
    for i in range(n):
        for j in range(n):
            work[i, j] = m[i, j] * scale[i] * scale[j]
        work[i, n + i] = 1.0
    for k in range(n):
        pivot = work[k, k]
        if not pivot > 1e-10:
            return False
        for j in range(2 * n):
            work[k, j] /= pivot
        for i in range(n):
            if i != k:
                f = work[i, k]
                for j in range(2 * n):
                    work[i, j] -= f * work[k, j]
    for i in range(n):
        for j in range(n):
            inverse[i, j] = work[i, n + j] * scale[i] * scale[j]
    return True


@njit(cache=True, error_model="numpy")
def _residual_spectrum(residual: Complex, omega: Array, smooth: Array) -> None:
    """Log-quadratic spectrum of a residual, by gamma regression from a logarithmic start -> `smooth` (frequencies,)."""
    lines = omega.shape[0]
    z = np.empty((lines, 3))
    power = np.empty(lines)
    zz = np.zeros((3, 3))
    for i in range(lines):
        u = math.log(omega[i] / math.pi)
        z[i, 0], z[i, 1], z[i, 2] = 1.0, u, u * u
        power[i] = residual[i].real ** 2 + residual[i].imag ** 2 + 1e-300
        for a in range(3):
            for b in range(3):
                zz[a, b] += z[i, a] * z[i, b]
    inverse = np.empty((3, 3))
    if not _invert(zz, inverse):
        smooth[:] = power.mean()
        return
    beta = np.zeros(3)
    for k in range(5):
        pull = np.zeros(3)
        for i in range(lines):
            level = beta[0] * z[i, 0] + beta[1] * z[i, 1] + beta[2] * z[i, 2]
            # E ln|r|^2 of a complex normal is 0.577 below the logarithm of its mean.
            off = math.log(power[i]) + 0.5772156649 if k == 0 else power[i] / math.exp(level) - 1.0
            for a in range(3):
                pull[a] += z[i, a] * off
        step = inverse @ pull
        most = 0.0
        for i in range(lines):
            most = max(most, abs(step[0] + step[1] * z[i, 1] + step[2] * z[i, 2]))
        # A line far above the curve would throw it: a step changes no line by more than e^2.
        if k > 0 and most > 2.0:
            step *= 2.0 / most
        beta += step
    for i in range(lines):
        smooth[i] = math.exp(beta[0] + beta[1] * z[i, 1] + beta[2] * z[i, 2])


@njit(cache=True, error_model="numpy")
def _deviance(residual: Complex, omega: Array, smooth: Array) -> float:
    """-2 log likelihood of a residual whose spectrum is log-quadratic, but for a constant."""
    _residual_spectrum(residual, omega, smooth)
    total = 0.0
    for i in range(omega.shape[0]):
        total += 2.0 * (math.log(smooth[i]) + (residual[i].real ** 2 + residual[i].imag ** 2) / smooth[i])
    return total


@njit(cache=True, error_model="numpy")
def _quasi_steady(f: Complex, rho: Array, z: Complex, omega: Array, smooth: Array) -> float:
    """Deviance of z = c_alpha (x + g_cg) + c_q qhat + c_de de, generalised least squares; what split assumes."""
    lines = omega.shape[0]
    g = np.empty((3, lines), dtype=np.complex128)
    for i in range(lines):
        g[0, i], g[1, i], g[2, i] = f[X, i] + rho[i] * f[GC, i], f[QH, i], f[DE, i]
    residual = z.copy()
    smooth[:] = 1.0
    inverse = np.empty((3, 3))
    for k in range(PASSES):
        m = np.zeros((3, 3))
        rhs = np.zeros(3)
        for i in range(lines):
            for a in range(3):
                rhs[a] += (g[a, i].real * z[i].real + g[a, i].imag * z[i].imag) / smooth[i]
                for b in range(3):
                    m[a, b] += (g[a, i].real * g[b, i].real + g[a, i].imag * g[b, i].imag) / smooth[i]
        if not _invert(m, inverse):
            return math.inf
        theta = inverse @ rhs
        for i in range(lines):
            residual[i] = z[i] - (theta[0] * g[0, i] + theta[1] * g[1, i] + theta[2] * g[2, i])
        if k < PASSES - 1:
            _residual_spectrum(residual, omega, smooth)
    return _deviance(residual, omega, smooth)


@njit(cache=True, error_model="numpy")
def fit(
    f: Complex,
    omega: Array,
    derivative: Array,
    speed: float,
    con: Array,
    noise: float,
    share: float,
    past: Array,
    close: bool,
    theta: Array,
    stat: Array,
    total: Array,
    quality: Array,
    rho: Array,
) -> bool:
    """Estimate from the spectra `f` (CHANNELS, frequencies) and the sums over segments closed before.

    `derivative`: factor of Cm for its central difference; `noise`: energy of the vane's noise on a line; `share`: T df,
    of independent lines. Edits `past` (PARAMETERS, 2 PARAMETERS + 1 + N): normal matrix, score cloud, right side,
    cross terms; `close` adds this segment. Fills `theta` (PARAMETERS,), `stat` and `total` standard errors
    (PARAMETERS,), `quality` (QUALITY,): residual and signal energy of CL and Cm, gust share, and the deviance of both
    equations for this model and for the quasi-steady one on the same angle of attack.
    """
    lines = omega.shape[0]
    n = PARAMETERS
    wing = np.empty((2, lines), dtype=np.complex128)
    base = np.empty((N, 4, lines), dtype=np.complex128)
    g = np.empty((2, 6 + N, lines), dtype=np.complex128)
    gust_power = np.empty(lines)
    turbulent = wiener(f, omega, noise, gust_power, rho)
    columns(f, omega, speed, con, rho, wing, base)
    y = np.empty((2, lines), dtype=np.complex128)
    residual = np.empty((2, lines), dtype=np.complex128)
    spectrum = np.ones((2, lines))
    for i in range(lines):
        tail = con[A_H] * wing[1, i]
        y[0, i] = f[CL, i] - tail
        y[1, i] = f[CM, i] * derivative[i] + con[ARM] * tail
        spectrum[1, i] = 0.1
    prior = np.zeros(n)
    equations = 2 if con[HAS_MOMENT] > 0.0 else 1
    if equations == 1:
        prior[3:6] = 1.0
    for j in range(N_LEARNT):
        prior[6 + j] = 1.0 / max(turbulent * con[LEARNT_AT + j], 1e-4 * con[KNOWN_AT + j], 1e-9) ** 2
    independent = min(max(share, 1e-3), 1.0)
    m = np.empty((n, n))
    rhs = np.empty(n)
    inverse = np.empty((n, n))
    theta[:] = 0.0
    theta[0], theta[3] = con[CL_ALPHA], con[CM_ALPHA]
    for k in range(PASSES):
        design(f, wing, base, con, theta[0], theta[3], g)
        for a in range(n):
            rhs[a] = past[a, 2 * n]
            for b in range(a + 1):
                m[a, b] = past[a, b]
        for q in range(equations):
            for i in range(lines):
                weight = 2.0 * independent / spectrum[q, i]
                for a in range(n):
                    ga = g[q, a, i]
                    re, im = weight * ga.real, weight * ga.imag
                    rhs[a] += re * y[q, i].real + im * y[q, i].imag
                    for b in range(a + 1):
                        m[a, b] += re * g[q, b, i].real + im * g[q, b, i].imag
        for a in range(n):
            for b in range(a):
                m[b, a] = m[a, b]
            m[a, a] += prior[a]
        if not _invert(m, inverse):
            return False
        for a in range(n):
            theta[a] = 0.0
            for b in range(n):
                theta[a] += inverse[a, b] * rhs[b]
        for q in range(equations):
            for i in range(lines):
                left = y[q, i]
                for a in range(n):
                    left -= g[q, a, i] * theta[a]
                residual[q, i] = left
            if k < PASSES - 1:
                _residual_spectrum(residual[q], omega, spectrum[q])
                for i in range(lines):
                    spectrum[q, i] *= lines / (lines - ORDER)

    score = np.zeros((lines, n))
    cross = np.empty((n, N))
    for a in range(n):
        for j in range(N):
            cross[a, j] = past[a, 2 * n + 1 + j]
    for q in range(equations):
        for i in range(lines):
            weight = 2.0 * independent / spectrum[q, i]
            # A line that draws the fit to itself shows too small a residual: divide by what it leaves free.
            pull = 0.0
            for a in range(n):
                for b in range(n):
                    pull += inverse[a, b] * (g[q, a, i].real * g[q, b, i].real + g[q, a, i].imag * g[q, b, i].imag)
            free = weight / max(1.0 - 0.5 * weight * pull, 0.2)
            re, im = free * residual[q, i].real, free * residual[q, i].imag
            for a in range(n):
                ga = g[q, a, i]
                score[i, a] += ga.real * re + ga.imag * im
                for j in range(N):
                    gj = g[q, 6 + j, i]
                    cross[a, j] += weight * (ga.real * gj.real + ga.imag * gj.imag)
    lags = min(max(math.ceil(2.0 / independent), 2), 12)
    cloud = np.zeros((n, n))
    for lag in range(lags + 1):
        weight = (1.0 if lag == 0 else 2.0 * (1.0 - lag / (lags + 1.0))) * lines / (lines - ORDER)
        for i in range(lines - lag):
            for a in range(n):
                for b in range(n):
                    cloud[a, b] += weight * score[i, a] * score[i + lag, b]
    for a in range(n):
        sandwich = inverse[a, a]
        total_square = 0.0
        for b in range(n):
            for c in range(n):
                spread = cloud[b, c] + past[b, n + c]
                if b == c:
                    spread += prior[b]
                total_square += inverse[a, b] * spread * inverse[c, a]
        spread = math.sqrt(max(sandwich, total_square))
        stat[a] = SMALL_RECORD * spread
        total_square = (SECOND_ORDER * spread) ** 2
        for j in range(N):
            effect = 0.0
            for b in range(n):
                effect -= inverse[a, b] * cross[b, j]
            learnt = turbulent * con[LEARNT_AT + j] if j < N_LEARNT else 0.0
            left = effect * effect * max(con[KNOWN_AT + j] ** 2 - learnt**2, 0.0)
            total_square += left
            if j == N - 1:
                # The mean wind is no constant: it is as wrong as this record's gusts make it.
                stat[a] = math.sqrt(stat[a] ** 2 + left)
        total[a] = math.sqrt(total_square)

    quality[:] = 0.0
    quality[4] = turbulent
    for q in range(equations):
        for i in range(lines):
            z = f[CL, i] if q == 0 else f[CM, i] * derivative[i]
            quality[q] += residual[q, i].real ** 2 + residual[q, i].imag ** 2
            quality[2 + q] += z.real**2 + z.imag**2
            y[q, i] = z
        quality[5] += independent * _deviance(residual[q], omega, spectrum[q])
        quality[6] += independent * _quasi_steady(f, rho, y[q], omega, spectrum[q])
    if close:
        for a in range(n):
            for b in range(n):
                past[a, b] = m[a, b] - (prior[a] if a == b else 0.0)
                past[a, n + b] += cloud[a, b]
            past[a, 2 * n] = rhs[a]
            for j in range(N):
                past[a, 2 * n + 1 + j] = cross[a, j]
    return math.isfinite(theta.sum())
