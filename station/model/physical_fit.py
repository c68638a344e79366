"""Generalised least squares of both longitudinal equations (physical_columns.py) with uncertain constants.

The constants that the profile gives (tail's share, arm and downwash, boom length, memories ...) are known to a prior
standard deviation, of which the profile speaks (uncertainty.py), and are estimated along: Gauss-Newton on the sum of
squares and prior. In calm air the data move all of them; in turbulence part of some is only considered: it widens the
total standard error. Residual spectra are log-quadratic in frequency, with one coherence between the equations, and
are re-estimated (feasible generalised least squares, seemingly unrelated regressions). What the known noise of the
inertial sensors adds to the normal equations is taken off again (corrected score; Fuller 1987, Measurement error
models), for a tail's share is read from small high frequencies, which noise in the regressors would attenuate.

The statistical error is what the residuals do to the estimate, the larger of the parametric one and a sum of score
products over neighbouring lines (Newey and West 1987): repeatability. The total one holds what the priors leave. SI,
radians.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.model.physical_columns import (
    CHANNELS,
    CL,
    CL_ALPHA,
    CM,
    CM_ALPHA,
    DE,
    HAS_MOMENT,
    KNOWN_AT,
    LEARNT_AT,
    NOISE_AT,
    PARAMETERS,
    QH,
    SOURCES,
    WING,
    N,
    columns,
    design,
    noise_spectrum,
    wiener,
)
from station.model.physical_signals import GC, GT, X
from station.numerics.regression import invert

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PASSES: Final = 4
QUALITY: Final = 7
MOST_COHERENT: Final = 0.9
ORDER: Final = 3.5
"""Residual energy is scaled by n/(n - ORDER): parameters used up by each equation."""
SMALL_RECORD: Final = 1.2
"""On standard errors: weights come from the residuals of the record itself, of some 40 independent lines. From Monte
Carlo with known constants, so that 95 % intervals cover 95 %."""
EVERY: Final = 4
"""Lines from one to the next at which the noise of the sensors is evaluated: it is smooth."""
TAKEN_OFF: Final = (1.0, 0.5, 0.0)
"""Share of the sensors' noise that is taken off the normal equations: the first that leaves them positive, and every
constant known no worse than before (Fuller takes off less for the same reason)."""
_SOURCES: Final = len(SOURCES)


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
    if not invert(zz, 3, inverse):
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
    """Deviance of z = c_alpha (x + g_cg) + c_q qhat + c_de de + c_d (g_cg - g_tail), generalised least squares: what
    split+gust assumes, and in calm air split. The last term costs what the record tells of it (Schwarz 1978)."""
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
        theta = inverse @ rhs
        for i in range(lines):
            residual[i] = z[i]
            for a in range(n):
                residual[i] -= theta[a] * g[a, i]
        if k < PASSES - 1:
            _residual_spectrum(residual, omega, smooth)
    return _deviance(residual, omega, smooth) + (n - 3) * math.log(2.0 * lines)


@njit(cache=True, error_model="numpy")
def _accumulate(
    f: Complex,
    derivative: Array,
    wing: Complex,
    base: Complex,
    con: Array,
    theta: Array,
    spectrum: Array,
    coherence: complex,
    energy: float,
    every: int,
    equations: int,
    g: Complex,
    residual: Complex,
    m: Array,
    rhs: Array,
) -> None:
    """Add `energy` times the normal matrix and gradient of the spectra `f` to `m` and `rhs`.

    Both equations are divided by their spectra, and the second is freed of what it shares with the first: `g` (lines,
    2, PARAMETERS), `residual` (lines, 2).
    """
    n = PARAMETERS
    plain = np.empty((2, n), dtype=np.complex128)
    left = np.empty(2, dtype=np.complex128)
    alone = 1.0 / math.sqrt(1.0 - abs(coherence) ** 2)
    shared = np.conj(coherence)
    weight = 2.0 * energy * every
    for i in range(every // 2, f.shape[1], every):
        design(f, i, derivative[i], wing, base, con, theta, plain, left)
        first, second = 1.0 / math.sqrt(spectrum[0, i]), 1.0 / math.sqrt(spectrum[1, i])
        for a in range(n):
            g[i, 0, a] = first * plain[0, a]
            g[i, 1, a] = alone * (second * plain[1, a] - shared * g[i, 0, a])
        residual[i, 0] = first * left[0]
        residual[i, 1] = alone * (second * left[1] - shared * residual[i, 0])
        for q in range(equations):
            r = residual[i, q]
            for a in range(n):
                re, im = weight * g[i, q, a].real, weight * g[i, q, a].imag
                if re == 0.0 and im == 0.0:
                    continue
                rhs[a] += re * r.real + im * r.imag
                for b in range(a + 1):
                    m[a, b] += re * g[i, q, b].real + im * g[i, q, b].imag


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
    gust_power = np.empty(lines)
    turbulent = wiener(f, omega, noise, gust_power, rho)
    spectra = np.empty((1 + _SOURCES, CHANNELS, lines), dtype=np.complex128)
    wing = np.empty((1 + _SOURCES, WING, lines), dtype=np.complex128)
    base = np.empty((1 + _SOURCES, N, 3, lines), dtype=np.complex128)
    spectra[0] = f
    for k in range(1 + _SOURCES):
        every = EVERY if k > 0 else 1
        if k > 0:
            noise_spectrum(k - 1, omega, speed, con, derivative, every, spectra[k])
        columns(spectra[k], omega, speed, con, rho, every, wing[k], base[k])
    prior = np.zeros(n)
    considered = np.zeros(N)
    equations = 2 if con[HAS_MOMENT] > 0.0 else 1
    if equations == 1:
        prior[3:6] = 1.0
    for j in range(N):
        learnt = 1.0 - turbulent * (1.0 - con[LEARNT_AT + j] ** 2)
        prior[6 + j] = 1.0 / max(con[KNOWN_AT + j] ** 2 * learnt, 1e-18)
        considered[j] = con[KNOWN_AT + j] ** 2 * (1.0 - learnt)
    independent = min(max(share, 1e-3), 1.0)
    spectrum = np.ones((2, lines))
    spectrum[1] = 0.1
    coherence = 0.0j
    g = np.zeros((lines, 2, n), dtype=np.complex128)
    white = np.zeros((lines, 2), dtype=np.complex128)
    scratch = np.empty((lines, 2, n), dtype=np.complex128)
    spare = np.empty((lines, 2), dtype=np.complex128)
    residual = np.empty((2, lines), dtype=np.complex128)
    alone = np.zeros((n, n))
    noisy = np.empty((n, n))
    noisy_rhs = np.empty(n)
    own = np.empty((n, n))
    own_rhs = np.empty(n)
    m = np.empty((n, n))
    rhs = np.empty(n)
    inverse = np.empty((n, n))
    theta[:] = 0.0
    theta[0], theta[3] = con[CL_ALPHA], con[CM_ALPHA]
    before = np.empty(n)
    for k in range(PASSES):
        alone[:] = 0.0
        rhs[:] = 0.0
        w, b0 = wing[0], base[0]
        _accumulate(
            f, derivative, w, b0, con, theta, spectrum, coherence, independent, 1, equations, g, white, alone, rhs
        )
        noisy[:] = 0.0
        noisy_rhs[:] = 0.0
        for source in range(_SOURCES):
            energy = independent * noise * con[NOISE_AT + source]
            _accumulate(
                spectra[1 + source],
                derivative,
                wing[1 + source],
                base[1 + source],
                con,
                theta,
                spectrum,
                coherence,
                energy,
                EVERY,
                equations,
                scratch,
                spare,
                noisy,
                noisy_rhs,
            )
        for a in range(n):
            for b in range(a):
                noisy[b, a] = noisy[a, b]
                alone[b, a] = alone[a, b]
        before[:] = theta
        solved = False
        for taken in TAKEN_OFF:
            # In the form m theta = rhs, to which segments before and the prior, about zero, add.
            own[:] = alone - taken * noisy
            for a in range(n):
                own_rhs[a] = rhs[a] - taken * noisy_rhs[a]
                for b in range(n):
                    own_rhs[a] += own[a, b] * before[b]
            m[:] = own + past[:, :n]
            for a in range(n):
                m[a, a] += prior[a]
            solved = invert(m, n, inverse)
            for a in range(6, n):
                solved = solved and 0.0 < inverse[a, a] * prior[a] < 1.0 + 1e-6
            if solved:
                break
        if not solved:
            return False
        theta[:] = inverse @ (own_rhs + past[:, 2 * n])
        for q in range(2):
            for i in range(lines):
                left = white[i, q]
                for a in range(n):
                    left -= g[i, q, a] * (theta[a] - before[a])
                white[i, q] = left
        for i in range(lines):
            first = white[i, 0]
            second = math.sqrt(1.0 - abs(coherence) ** 2) * white[i, 1] + np.conj(coherence) * first
            residual[0, i] = first * math.sqrt(spectrum[0, i])
            residual[1, i] = second * math.sqrt(spectrum[1, i])
        if k < PASSES - 1:
            product = 0.0j
            for q in range(2):
                _residual_spectrum(residual[q], omega, spectrum[q])
                for i in range(lines):
                    spectrum[q, i] *= lines / (lines - ORDER)
            if equations == 2:
                for i in range(lines):
                    product += residual[0, i] * np.conj(residual[1, i]) / math.sqrt(spectrum[0, i] * spectrum[1, i])
                coherence = product / lines
                if abs(coherence) > MOST_COHERENT:
                    coherence *= MOST_COHERENT / abs(coherence)

    score = np.zeros((lines, n))
    for i in range(lines):
        for q in range(equations):
            re, im = 2.0 * independent * white[i, q].real, 2.0 * independent * white[i, q].imag
            for a in range(n):
                score[i, a] += g[i, q, a].real * re + g[i, q, a].imag * im
    lags = min(max(math.ceil(2.0 / independent), 2), 12)
    cloud = np.zeros((n, n))
    for lag in range(lags + 1):
        weight = (0.5 if lag == 0 else 1.0 - lag / (lags + 1.0)) * lines / (lines - ORDER)
        for i in range(lines - lag):
            for a in range(n):
                for b in range(n):
                    cloud[a, b] += weight * (score[i, a] * score[i + lag, b] + score[i + lag, a] * score[i, b])
    cross = alone[:, 6:] + past[:, 2 * n + 1 :]
    spread = inverse @ (cloud + past[:, n : 2 * n]) @ inverse
    effect = inverse @ cross
    for a in range(n):
        smallest = 0.0
        for b in range(n):
            for c in range(n):
                smallest += inverse[a, b] * (own[b, c] + past[b, c]) * inverse[c, a]
        square = SMALL_RECORD**2 * max(smallest, spread[a, a])
        stat[a] = math.sqrt(square)
        for b in range(n):
            square += inverse[a, b] ** 2 * prior[b] * SMALL_RECORD**2
        for j in range(N):
            square += effect[a, j] ** 2 * considered[j]
        total[a] = math.sqrt(square)

    quality[:] = 0.0
    quality[4] = turbulent
    z = np.empty(lines, dtype=np.complex128)
    for q in range(equations):
        for i in range(lines):
            z[i] = f[CL, i] if q == 0 else f[CM, i] * derivative[i]
            quality[q] += residual[q, i].real ** 2 + residual[q, i].imag ** 2
            quality[2 + q] += z[i].real ** 2 + z[i].imag ** 2
        quality[5] += independent * _deviance(residual[q], omega, spectrum[q])
        quality[6] += independent * _quasi_steady(f, rho, z, omega, spectrum[q])
    # A model that fits only with constants far from the profile's, and just there, is the less likely one (Laplace).
    for a in range(6, n):
        quality[5] += prior[a] * theta[a] ** 2 - math.log(inverse[a, a] * prior[a])
    if close:
        for a in range(n):
            for b in range(n):
                past[a, b] += own[a, b]
                past[a, n + b] += cloud[a, b]
            past[a, 2 * n] += own_rhs[a]
            for j in range(N):
                past[a, 2 * n + 1 + j] += alone[a, 6 + j]
    return math.isfinite(theta.sum())
