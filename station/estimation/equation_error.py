"""Equation error in the frequency domain: complex least squares with real parameters, and honest standard errors.

    Z(f) = sum_j theta_j X_j(f) + e(f),   theta = M^-1 Re(X^H Z),   M = Re(X^H X) + ridge

A long flight is cut into segments of T = 1/df, whose normal equations are added: on one grid over one ever longer
transform repeated inputs cancel at most lines and accuracy stands still.

Source: Klein and Morelli 2006, sections 11.2-11.3. Standard errors are the larger of two: residuals independent from
line to line, with the lines of a grid finer than 1/T counted once; and a sum of score products over neighbouring
lines, for residuals coloured in frequency (Newey and West 1987, with the leverage of MacKinnon and White 1985). Both
come from the residuals of one short record, hence the factor 1.15 (coverage 0.96 instead of 0.92 in Monte Carlo). SI,
radians.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from station.model.coefficients import (
    force_coefficients,
    lift_and_drag,
    pitching_moment,
    specific_force_at_cg,
    thrust_by_drag_polar,
)
from station.numerics.differentiation import central
from station.numerics.regression import invert
from station.numerics.spectra import carry
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

SMALL_RECORD: Final = 1.15
MEAN_S: Final = 30.0
"""Over which thrust and density are averaged."""
ENERGY, LINES = range(2)
"""Places in Sums.extent."""


class Sums(NamedTuple):
    """Over the closed segments of one equation; of more, on further axes in front."""

    normal: Array
    """Re(X^H X), its lower triangle, (places, places)."""
    scores: Array
    """Score products of neighbouring lines, (places, places)."""
    right: Array
    """Re(X^H z), (places,)."""
    extent: Array
    """Energy of z, and independent lines, (2,)."""


class Fitted(NamedTuple):
    """What `fit` makes of one equation; of more, on further axes in front."""

    value: Array
    """(places,), as the next two: parameters."""
    error: Array
    """Their standard errors."""
    inflation: Array
    """Of their variances, by collinearity with the other regressors (VIF)."""
    inverse: Array
    """Of the normal matrix, (places, places)."""


@register_jitable
def no_sums(equations: tuple[int, ...], places: int) -> Sums:
    """Before the first segment is closed, of so many equations, (..., equations), of up to `places` parameters."""
    return Sums(
        np.zeros((*equations, places, places)),
        np.zeros((*equations, places, places)),
        np.zeros((*equations, places)),
        np.zeros((*equations, 2)),
    )


@register_jitable
def nothing_fitted(equations: tuple[int, ...], places: int) -> Fitted:
    """Zeros, to be filled."""
    return Fitted(
        np.zeros((*equations, places)),
        np.zeros((*equations, places)),
        np.zeros((*equations, places)),
        np.zeros((*equations, places, places)),
    )


# One row of the history that a tick's coefficients are made from.
_P, _Q, _R, _AX, _AY, _AZ, _V, _QBAR, _MASS, _THRUST, _DE, _ALPHA, _EXTRA = range(13)
EXTRAS: Final = 5
ROW: Final = _EXTRA + EXTRAS
# constants
_S, _C, _IYY, _IXZ, _IXX_IZZ, _CD0, _CDI, _POLAR, _BODY, _V0, _XA, _YA, _ZA, _ANGLE, _PITCH_ARM = range(15)


@njit(cache=True)
def _average(means: Array, at: int, dt: float, value: float) -> None:
    """One sample more into a running mean, `means[at]`, whose count is the next."""
    means[at + 1] += 1.0
    means[at] += max(dt / MEAN_S, 1.0 / means[at + 1]) * (value - means[at])


@njit(cache=True)
def sides(constant: Array, history: Array, means: Array, dt: float, row: Array, out: Array) -> bool:
    """Left and right sides of both equations, one tick ago: the middle of three rows of history.

    `row` (ROW,): p q r, ax ay az at the IMU, V, dynamic pressure, mass, thrust (NaN: unknown), elevator, angle of
    attack at the CG, then signals that are passed on. `out`: q c/2V, elevator, CL (or CZ), Cm, then those signals.
    Angular accelerations are central differences. `means` (4,) over MEAN_S: of what the drag polar leaves over, N, and
    its count; of the air's density, 2 qbar/V^2, kg/m3, and its count. Returns False while there are fewer than three
    rows; `history` (3, ROW) starts as NaN.
    """
    # By element: numba takes seconds to compile the check of two arrays' shapes.
    for i in range(ROW):
        history[0, i] = history[1, i]
        history[1, i] = history[2, i]
        history[2, i] = row[i]
    h = history[1]
    if not (math.isfinite(history[0, _Q]) and math.isfinite(h[_Q])):
        return False
    pdot = central(history[2, _P], history[0, _P], dt)
    qdot = central(history[2, _Q], history[0, _Q], dt)
    rdot = central(history[2, _R], history[0, _R], dt)
    p, q, r = h[_P], h[_Q], h[_R]
    ax, _, az = specific_force_at_cg(
        (h[_AX], 0.0, h[_AZ]), (p, q, r), (pdot, qdot, rdot), (constant[_XA], constant[_YA], constant[_ZA])
    )
    inertial = h[_MASS] * ax, h[_MASS] * az
    density = 2.0 * h[_QBAR] / (h[_V] * h[_V])
    if math.isfinite(density):
        _average(means, 2, dt, density)
    force = h[_QBAR] * constant[_S]
    sin, cos = math.sin(h[_ALPHA]), math.cos(h[_ALPHA])
    push = h[_THRUST]
    if not math.isfinite(push):
        push = 0.0
        if constant[_POLAR] > 0.0:
            # Unknown thrust: what ax shows beyond the drag polar, averaged; left in, it adds T/(qbar S) to CL_alpha.
            polar = constant[_CD0], constant[_CDI]
            _average(means, 0, dt, thrust_by_drag_polar(inertial, force, polar, constant[_ANGLE], sin, cos))
            push = means[0]
    cx, cz = force_coefficients(inertial, (push, constant[_ANGLE]), force)
    out[0] = q * constant[_C] / (2.0 * (constant[_V0] if constant[_V0] > 0.0 else h[_V]))
    out[1] = h[_DE]
    out[2] = cz if constant[_BODY] > 0.0 else lift_and_drag(cx, cz, sin, cos)[0]
    moment = pitching_moment((constant[_IYY], constant[_IXZ], constant[_IXX_IZZ]), qdot, p, r)
    out[3] = (moment - push * constant[_PITCH_ARM]) / (force * constant[_C])
    for i in range(EXTRAS):
        out[4 + i] = h[_EXTRA + i]
    return True


@njit(cache=True)
def _normal_equations(x: Complex, z: Complex, m: Array, rhs: Array) -> float:
    """Lower triangle of Re(X^H X) -> `m`, Re(X^H z) -> `rhs`; returns the energy of `z`."""
    n, lines = x.shape
    energy = 0.0
    for f in range(lines):
        for i in range(n):
            a, b = x[i, f].real, x[i, f].imag
            rhs[i] += a * z[f].real + b * z[f].imag
            for j in range(i + 1):
                m[i, j] += a * x[j, f].real + b * x[j, f].imag
        energy += z[f].real ** 2 + z[f].imag ** 2
    return energy


@njit(cache=True)
def _scores(x: Complex, z: Complex, theta: Array, inverse: Array, score: Array) -> None:
    """Each line's share in the normal equations' right side that the parameters leave, -> `score` (lines, n)."""
    n, lines = x.shape
    for f in range(lines):
        re, im = z[f].real, z[f].imag
        pull = 0.0
        for i in range(n):
            re -= theta[i] * x[i, f].real
            im -= theta[i] * x[i, f].imag
            for j in range(n):
                pull += inverse[i, j] * (x[i, f].real * x[j, f].real + x[i, f].imag * x[j, f].imag)
        # A line that draws the fit to itself shows too small a residual: divide by what it leaves free.
        free = max(1.0 - pull, 0.2)
        for i in range(n):
            score[f, i] = (x[i, f].real * re + x[i, f].imag * im) / free


@njit(cache=True)
def newey_west(score: Array, share: float, cloud: Array) -> None:
    """Products of `score` (lines, n) over lines up to the grid's dependence apart (Newey and West), added to `cloud`
    (n, n). `share`: of independent lines."""
    lines, n = score.shape
    lags = min(max(math.ceil(1.5 / share), 2), 12)
    for lag in range(lags + 1):
        weight = 1.0 if lag == 0 else 2.0 * (1.0 - lag / (lags + 1.0))
        for f in range(lines - lag):
            for i in range(n):
                for j in range(n):
                    cloud[i, j] += weight * score[f, i] * score[f + lag, j]


@njit(cache=True)
def _residual_energy(m: Array, rhs: Array, ridge: Array, theta: Array, energy: float) -> float:
    """Of the `energy` of z what the parameters do not explain, from the normal equations."""
    residual = energy
    for i in range(theta.shape[0]):
        residual -= 2.0 * theta[i] * rhs[i]
        for j in range(theta.shape[0]):
            residual += theta[i] * m[i, j] * theta[j]
        residual -= theta[i] * ridge[i] * theta[i]
    return max(residual, 0.0)


@njit(cache=True)
def _sandwich(inverse: Array, cloud: Array, i: int) -> float:
    """Variance of a parameter by the inverse normal matrix and the score products `cloud` (n, n)."""
    total = 0.0
    for a in range(cloud.shape[0]):
        for b in range(cloud.shape[0]):
            total += inverse[i, a] * cloud[a, b] * inverse[b, i]
    return total


@njit(cache=True)
def fit(x: Complex, z: Complex, ridge: Array, independent: float, sums: Sums, close: bool, fitted: Fitted) -> float:
    """Least squares of `z` (frequencies,) on `x` (parameters, frequencies), parameters <= places, and on the `sums` of
    the segments closed before, which `close` adds this one to.

    `ridge`: added to the diagonal of Re(X^H X), (parameters,). `independent`: T df of `x`, how many independent lines
    there are to a line of the grid. Fills `fitted`; returns R2, NaN if there is no solution.
    """
    n, lines = x.shape
    inverse = fitted.inverse
    m, rhs, extent = np.zeros((n, n)), np.zeros(n), np.zeros(2)
    share = min(max(independent, 1e-3), 1.0)
    extent[ENERGY] = _normal_equations(x, z, m, rhs)
    extent[LINES] = lines * share
    carry(sums.extent, extent, close)
    carry(sums.right, rhs, close)
    for i in range(n):
        carry(sums.normal[i], m[i, : i + 1], close)
        m[i, i] += ridge[i]
        for j in range(i):
            m[j, i] = m[i, j]
    if not invert(m, n, inverse):
        return math.nan
    theta = np.zeros(n)
    for i in range(n):
        fitted.inflation[i] = inverse[i, i] * m[i, i]
        for j in range(n):
            theta[i] += inverse[i, j] * rhs[j]

    score, cloud = np.zeros((lines, n)), np.zeros((n, n))
    _scores(x, z, theta, inverse, score)
    newey_west(score, share, cloud)
    for i in range(n):
        carry(sums.scores[i], cloud[i], close)
    residual = _residual_energy(m, rhs, ridge, theta, extent[ENERGY])
    variance = 0.5 * residual / max(extent[LINES] - 0.5 * n, 1.0)
    for i in range(n):
        fitted.value[i] = theta[i]
        square = max(variance * inverse[i, i], _sandwich(inverse, cloud, i), 0.0)
        fitted.error[i] = SMALL_RECORD * math.sqrt(square)
    if not math.isfinite(theta.sum()):
        return math.nan
    return 1.0 - residual / extent[ENERGY] if extent[ENERGY] > 0.0 else 0.0


class Sides:
    """The state of `sides`; `out`: q c/2V, elevator, CL (or CZ), Cm, and the signals passed through, one tick late."""

    def __init__(self, aircraft: Aircraft, arm: tuple[float, float, float], dt: float, body: bool) -> None:
        g, i = aircraft.geometry, aircraft.inertia
        coupled = i.ixx is not None and i.izz is not None
        self.constant = np.array(
            [
                g.wing_area,
                g.chord,
                i.iyy or 0.0,
                i.ixz,
                (i.ixx or 0.0) - (i.izz or 0.0) if coupled else 0.0,
                aircraft.drag.zero_lift if aircraft.drag else 0.0,
                aircraft.drag.induced if aircraft.drag else 0.0,
                float(aircraft.drag is not None),
                float(body),
                (aircraft.reference_speed or 0.0) if aircraft.rate_reference == "fixed" else 0.0,
                *arm,
                aircraft.thrust_angle,
                aircraft.thrust_pitch_arm,
            ]
        )
        self._dt = dt
        self._history = np.full((3, ROW), math.nan)
        self._means = np.zeros(4)
        self.out = np.full(4 + EXTRAS, math.nan)
        self.arrays = (self.constant, self._history, self._means, self.out)
        """As tick.advance takes them."""

    @property
    def density(self) -> float:
        """Of the air flown in, kg/m3, averaged; 0 before the first sample."""
        return float(self._means[2])

    def restart(self) -> None:
        """Forget the last two ticks: there is a gap."""
        self._history[:] = math.nan

    def step(self, row: Array) -> bool:
        """One tick, `row` (ROW,); whether `out` holds a new sample."""
        return bool(sides(self.constant, self._history, self._means, self._dt, row, self.out))
