"""Generalised least squares of both longitudinal equations (physical_columns.py) with uncertain constants.

The constants that the profile gives (tail's share, arm and downwash, boom length, indicial responses ...) are known to
a prior standard deviation, of which the profile speaks (uncertainty.py), and are estimated along: Gauss-Newton on the
sum of squares and prior. In calm air the data move all of them; in turbulence part of some is only considered: it
widens the total standard error. Residual spectra are log-quadratic in frequency, with one coherence between the
equations, and are re-estimated (feasible generalised least squares, seemingly unrelated regressions). What the known
noise of the inertial sensors adds to the normal equations is subtracted again, as far as the residuals show it
(corrected score; Fuller 1987, Measurement error models), for a tail's share is read from small high frequencies, which
noise in the regressors would attenuate.

The statistical error is what the residuals do to the estimate, the larger of the parametric one and a sum of score
products over neighbouring lines (Newey and West 1987): repeatability. The total one holds what the priors leave. SI,
radians.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from station.model.noise_columns import EVERY, all_columns
from station.model.physical_columns import CL, CM, Columns, Segment, design, wiener
from station.model.physical_constants import (
    ARM_LENGTH,
    CL_ALPHA,
    CM_ALPHA,
    FIRST_NUISANCE,
    OF_CM,
    PARAMETERS,
    SOURCES,
    WIND,
    Constants,
    N,
)
from station.model.physical_posterior import Found, Solved, Sums, errors
from station.model.residual_spectrum import (
    EQUATIONS,
    ORDER,
    PASSES,
    Weighting,
    deviance,
    quasi_steady_deviance,
    weigh,
)
from station.numerics.products import applied
from station.numerics.regression import invert

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

GUST, DEVIANCE, QUASI_STEADY, COMPLEXITY = range(4)
"""Places in Found.summary."""
SUBTRACTED: Final = (1.0, 0.5, 0.0)
"""Share of the sensors' noise that is subtracted from the normal equations: the first that leaves them positive, and
every constant known no worse than before (Fuller subtracts less for the same reason)."""
SMALLEST: Final = 1e-18
"""Of a prior's variance: a constant without any is known exactly."""


class Normal(NamedTuple):
    """Normal equations of spectra."""

    slopes: Complex
    """Of both whitened equations by each parameter, (frequencies, 2, PARAMETERS)."""
    white: Complex
    """Their residuals, (frequencies, 2)."""
    matrix: Array
    """(PARAMETERS, PARAMETERS)"""
    gradient: Array
    """(PARAMETERS,)"""
    energy: Array
    """Of the whitened residuals, (2,)."""


@register_jitable
def _no_normal(lines: int) -> Normal:
    n = PARAMETERS
    slopes = np.zeros((lines, EQUATIONS, n), dtype=np.complex128)
    white = np.zeros((lines, EQUATIONS), dtype=np.complex128)
    return Normal(slopes, white, np.zeros((n, n)), np.zeros(n), np.zeros(EQUATIONS))


@njit(cache=True, error_model="numpy")
def _priors(segment: Segment, con: Constants, turbulent: float, prior: Array, considered: Array) -> None:
    """Inverse variances of what is estimated, `prior` (PARAMETERS,), and variances of what is only `considered` (N,).

    The mean wind stretches the time to the tail, as a wrong tail arm does, which is only considered: what the data show
    of the stretch is the wind's in the ratio of the two prior variances, all of it if the arm is known exactly.
    """
    if not con.has_moment:
        prior[OF_CM] = 1.0
    for j in range(N):
        sd, learnt = con.prior[j], con.learnt[j]
        if j == WIND:
            sd, arm = segment.wind_sd, con.prior[ARM_LENGTH]
            learnt = sd / math.sqrt(sd * sd + arm * arm + SMALLEST)
        moved = 1.0 - turbulent * (1.0 - learnt**2)
        prior[FIRST_NUISANCE + j] = 1.0 / max(sd**2 * moved, SMALLEST)
        considered[j] = sd**2 * (1.0 - moved)


@njit(cache=True, error_model="numpy")
def _accumulate(
    of: Columns, derivative: Array, con: Constants, theta: Array, weighting: Weighting, energy: float, into: Normal
) -> None:
    """Add `energy` times the normal matrix (its lower triangle) and gradient of the columns to `into`.

    Both equations are divided by their spectra, and the second is freed of what it shares with the first.
    """
    n = PARAMETERS
    g, residual = into.slopes, into.white
    plain = np.empty((EQUATIONS, n), dtype=np.complex128)
    rest = np.empty(EQUATIONS, dtype=np.complex128)
    coherence = weighting.coherence[0]
    alone = 1.0 / math.sqrt(1.0 - abs(coherence) ** 2)
    shared = np.conj(coherence)
    weight = 2.0 * energy * of.every
    for i in range(of.every // 2, derivative.shape[0], of.every):
        design(of, i, derivative[i], con, theta, plain, rest)
        first, second = 1.0 / math.sqrt(weighting.spectrum[0, i]), 1.0 / math.sqrt(weighting.spectrum[1, i])
        for a in range(n):
            g[i, 0, a] = first * plain[0, a]
            g[i, 1, a] = alone * (second * plain[1, a] - shared * g[i, 0, a])
        residual[i, 0] = first * rest[0]
        residual[i, 1] = alone * (second * rest[1] - shared * residual[i, 0])
        for q in range(EQUATIONS if con.has_moment else 1):
            into.energy[q] += weight * abs(residual[i, q]) ** 2
            _add_line(g[i, q], residual[i, q], weight, into)


@njit(cache=True, error_model="numpy")
def _add_line(g: Complex, r: complex, weight: float, into: Normal) -> None:
    """Add one line of an equation, its slopes `g` (PARAMETERS,) and residual, to the normal equations."""
    for a in range(g.shape[0]):
        re, im = weight * g[a].real, weight * g[a].imag
        if re == 0.0 and im == 0.0:
            continue
        into.gradient[a] += re * r.real + im * r.imag
        for b in range(a + 1):
            into.matrix[a, b] += re * g[b].real + im * g[b].imag


@njit(cache=True, error_model="numpy")
def _fill_upper(m: Array) -> None:
    for a in range(m.shape[0]):
        for b in range(a):
            m[b, a] = m[a, b]


@njit(cache=True, error_model="numpy")
def _shown(own: Normal, noisy: Normal) -> float:
    """Share of the noise stated that the residuals of both equations show. Noise that is not there would be taken from
    the motion, which biases far more than to leave some in."""
    share = 1.0
    for q in range(EQUATIONS):
        if noisy.energy[q] > 0.0:
            share = min(share, own.energy[q] / noisy.energy[q])
    return share


@njit(cache=True, error_model="numpy")
def _solve(own: Normal, noisy: Normal, past: Sums, prior: Array, theta: Array, change: Array, solved: Solved) -> bool:
    """Normal equations in the form m theta = rhs, to which segments before and the prior, about 0, add; `theta`
    (PARAMETERS,): where they were made, and then what they give, a `change` (PARAMETERS,). False if there is no
    solution."""
    n = PARAMETERS
    m = np.empty((n, n))
    found = False
    shown = _shown(own, noisy)
    for share in SUBTRACTED:
        taken = share * shown
        for a in range(n):
            solved.right[a] = own.gradient[a] - taken * noisy.gradient[a]
            for b in range(n):
                solved.matrix[a, b] = own.matrix[a, b] - taken * noisy.matrix[a, b]
                solved.right[a] += solved.matrix[a, b] * theta[b]
                m[a, b] = solved.matrix[a, b] + past.normal[a, b]
            m[a, a] += prior[a]
        found = invert(m, n, solved.inverse)
        for a in range(FIRST_NUISANCE, n):
            found = found and 0.0 < solved.inverse[a, a] * prior[a] < 1.0 + 1e-6
        if found:
            break
    right = np.empty(n)
    for a in range(n):
        right[a] = solved.right[a] + past.right[a]
    right = applied(solved.inverse, right)
    for a in range(n if found else 0):
        change[a] = right[a] - theta[a]
        theta[a] = right[a]
    return found


@njit(cache=True, error_model="numpy")
def _move(own: Normal, weighting: Weighting, change: Array, residual: Complex) -> None:
    """Whitened residuals of `own` and plain ones, `residual` (2, frequencies), after a `change` of the parameters."""
    white, g = own.white, own.slopes
    for q in range(EQUATIONS):
        for i in range(white.shape[0]):
            rest = white[i, q]
            for a in range(PARAMETERS):
                rest -= g[i, q, a] * change[a]
            white[i, q] = rest
    coherence = weighting.coherence[0]
    for i in range(white.shape[0]):
        first = white[i, 0]
        second = math.sqrt(1.0 - abs(coherence) ** 2) * white[i, 1] + np.conj(coherence) * first
        residual[0, i] = first * math.sqrt(weighting.spectrum[0, i])
        residual[1, i] = second * math.sqrt(weighting.spectrum[1, i])


@njit(cache=True, error_model="numpy")
def _score_products(own: Normal, independent: float, equations: int, cloud: Array) -> None:
    """Sum over lines up to the grid's dependence apart (Newey and West) -> `cloud` (PARAMETERS, PARAMETERS)."""
    lines, n = own.white.shape[0], PARAMETERS
    score = np.zeros((lines, n))
    for i in range(lines):
        for q in range(equations):
            re, im = 2.0 * independent * own.white[i, q].real, 2.0 * independent * own.white[i, q].imag
            for a in range(n):
                score[i, a] += own.slopes[i, q, a].real * re + own.slopes[i, q, a].imag * im
    lags = min(max(math.ceil(2.0 / independent), 2), 12)
    for lag in range(lags + 1):
        weight = (0.5 if lag == 0 else 1.0 - lag / (lags + 1.0)) * lines / (lines - ORDER)
        for i in range(lines - lag):
            for a in range(n):
                for b in range(n):
                    cloud[a, b] += weight * (score[i, a] * score[i + lag, b] + score[i + lag, a] * score[i, b])


@njit(cache=True, error_model="numpy")
def _judge(segment: Segment, residual: Complex, weighting: Weighting, equations: int, found: Found) -> None:
    """Energies and deviances -> `found`; overwrites the weighting's spectra."""
    lines = segment.omega.shape[0]
    z = np.empty(lines, dtype=np.complex128)
    found.residual[:] = 0.0
    found.signal[:] = 0.0
    found.summary[DEVIANCE] = found.summary[QUASI_STEADY] = 0.0
    independent = _share(segment)
    for q in range(equations):
        smooth = weighting.spectrum[q]
        for i in range(lines):
            z[i] = segment.spectrum[CL, i] if q == 0 else segment.spectrum[CM, i] * segment.derivative[i]
            found.residual[q] += residual[q, i].real ** 2 + residual[q, i].imag ** 2
            found.signal[q] += z[i].real ** 2 + z[i].imag ** 2
        found.summary[DEVIANCE] += independent * deviance(residual[q], segment.omega, smooth)
        quasi_steady = quasi_steady_deviance(segment.spectrum, found.rho, z, segment.omega, smooth)
        found.summary[QUASI_STEADY] += independent * quasi_steady


@register_jitable
def _share(segment: Segment) -> float:
    return min(max(segment.independent, 1e-3), 1.0)


@njit(cache=True, error_model="numpy")
def _close(solved: Solved, cloud: Array, cross: Array, past: Sums) -> None:
    """Add this segment to the `past`."""
    for a in range(PARAMETERS):
        for b in range(PARAMETERS):
            past.normal[a, b] += solved.matrix[a, b]
            past.scores[a, b] += cloud[a, b]
        past.right[a] += solved.right[a]
        for j in range(N):
            past.cross[a, j] += cross[a, j]


@njit(cache=True, error_model="numpy")
def fit(segment: Segment, con: Constants, past: Sums, close: bool, found: Found) -> bool:
    """Estimate from a segment's spectra and the sums over segments closed before -> `found`; `close` adds this segment
    to the `past`. False if there is no solution."""
    n, lines, omega = PARAMETERS, segment.omega.shape[0], segment.omega
    equations = EQUATIONS if con.has_moment else 1
    theta, independent = found.theta, _share(segment)
    turbulent = wiener(segment.spectrum, omega, segment.vane_noise, found.rho)
    found.summary[GUST] = turbulent
    spectra, wing, spans, tails, freed, base = all_columns(segment, con, found.rho)
    prior, considered = np.zeros(n), np.zeros(N)
    _priors(segment, con, turbulent, prior, considered)
    weighting = Weighting(np.ones((EQUATIONS, lines)), np.zeros(1, dtype=np.complex128))
    weighting.spectrum[1] = 0.1
    own, noisy = _no_normal(lines), _no_normal(lines)
    solved = Solved(np.empty((n, n)), np.empty(n), np.empty((n, n)))
    residual = np.empty((EQUATIONS, lines), dtype=np.complex128)
    change = np.empty(n)
    theta[:] = 0.0
    theta[CL_ALPHA], theta[CM_ALPHA] = con.cl_alpha, con.cm_alpha
    for k in range(PASSES):
        if k > 0:
            weigh(residual, omega, con.has_moment, weighting)
        for normal in (own, noisy):
            normal.matrix[:] = 0.0
            normal.gradient[:] = 0.0
            normal.energy[:] = 0.0
        for part in range(1 + len(SOURCES)):
            every, into = (EVERY, noisy) if part > 0 else (1, own)
            energy = independent * segment.vane_noise * con.noise[part - 1] if part > 0 else independent
            of = Columns(spectra[part], wing[part], spans[part], tails[part], freed[part], base[part], every)
            _accumulate(of, segment.derivative, con, theta, weighting, energy, into)
        _fill_upper(own.matrix)
        _fill_upper(noisy.matrix)
        if not _solve(own, noisy, past, prior, theta, change, solved):
            return False
        _move(own, weighting, change, residual)

    cloud = np.zeros((n, n))
    _score_products(own, independent, equations, cloud)
    cross = own.matrix[:, FIRST_NUISANCE:]
    errors(solved, past, cloud, cross, prior, considered, found)
    _judge(segment, residual, weighting, equations, found)
    # A model that fits only with constants far from the profile's, and just there, is the less likely one (Laplace).
    found.summary[COMPLEXITY] = 0.0
    for a in range(FIRST_NUISANCE, n):
        found.summary[COMPLEXITY] += prior[a] * theta[a] ** 2 - math.log(solved.inverse[a, a] * prior[a])
    if close:
        _close(solved, cloud, cross, past)
    return math.isfinite(theta.sum())
