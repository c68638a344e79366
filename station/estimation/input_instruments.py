"""Lateral derivatives by what aileron and rudder make of the motion: instrumental variables in the frequency domain.

Air is not the same across the span. Its gradient, p_g, rolls the wing as a rate of roll would: Cl_p p_g b/2V stands in
the rolling moment beside the derivatives, no vane shows it, and the aircraft answers it with a roll against it. So p,
and with it sideslip, is not independent of what the equations leave, and least squares take that answer for the
derivatives: in turbulence of 10 ft/s Cl_p, Cl_beta and Cl_da of a Twin Otter come out a third too small, at residuals
that look small. What the surfaces alone make of the motion has nothing of the gust in it:

    theta = Re(Y^H W X)^-1 Re(Y^H W Z),   Y = [h(f) (aileron, rudder), aileron, rudder]

with h the response of sideslip, roll and yaw rate to the surfaces by the equations themselves, with first estimates.
A wrong h costs accuracy and makes no bias, and so do the weights, 1/(A Phi(f) + N(f)): N of the sensors' noise, Phi the
spectrum of p_g, and its level A from the residuals.

    Phi = 1/(1 + (4 w b/(pi V))^2)                                         (MIL-F-8785C 3.7.1, rolling gusts)

Standard errors are those of equation_error.fit. SI, rad. Sources: Söderström and Stoica 1989, System identification,
chapter 8 (instruments from a model's response to the input, section 8.3); Klein and Morelli 2006, chapter 3 (motion).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from station.conventions import G0
from station.estimation.equation_error import SMALL_RECORD, Fitted, newey_west
from station.numerics.regression import invert_general
from station.numerics.spectra import carry

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PLACES: Final = 5
MOTIONS: Final = 3
EQUATIONS: Final = 3
LEAST_NOISE: Final = 1e-9
"""Share of an equation's energy that noise is taken to be, at least."""
MASS, AREA, SPAN, IXX, IZZ, IXZ = range(6)
"""Places in `body`: kg, m2, m, kg m2."""
SPEED, PRESSURE, HALF, PITCH = range(4)
"""Places in `state`: airspeed, m/s; dynamic pressure, Pa; b/2V, s; pitch attitude, rad; means."""
ENERGY, LINES, LEVEL, OF_LEVEL = range(4)
"""Places in Sums.extent: weighted energy of z; independent lines; what the level A is the quotient of."""


class Sums(NamedTuple):
    """Of (EQUATIONS, ...), over closed segments."""

    cross: Array
    """Re(Y^H W X)"""
    own: Array
    """Re(Y^H W Y)"""
    normal: Array
    """Re(X^H W X)"""
    scores: Array
    """Score products of neighbouring lines; these all (EQUATIONS, PLACES, PLACES)."""
    right: Array
    """Re(Y^H W Z), and"""
    direct: Array
    """Re(X^H W Z)."""
    doubt: Array
    """Re(Y^H W D), D what Z may have to hold beside; these (EQUATIONS, PLACES)."""
    extent: Array
    """(EQUATIONS, 4)"""


def no_sums() -> Sums:
    """Before the first segment is closed."""
    squares, columns = (EQUATIONS, PLACES, PLACES), (EQUATIONS, PLACES)
    return Sums(
        np.zeros(squares), np.zeros(squares), np.zeros(squares), np.zeros(squares),
        np.zeros(columns), np.zeros(columns), np.zeros(columns), np.zeros((EQUATIONS, 4)),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def respond(body: Array, state: Array, theta: Array, frequencies: Array, out: Complex) -> None:
    """Sideslip of the motion, p b/2V and r b/2V per aileron and rudder -> `out` (MOTIONS, 2, frequencies), by the
    derivatives `theta` (EQUATIONS, PLACES), in still air near level flight."""
    half, speed = state[HALF], state[SPEED]
    force = state[PRESSURE] * body[AREA] / (body[MASS] * speed)
    moment = state[PRESSURE] * body[AREA] * body[SPAN]
    by = moment / (body[IXX] * body[IZZ] - body[IXZ] ** 2)
    g, pitch = G0 / speed, state[PITCH]
    # Rates of sideslip, roll and yaw per each regressor, the moments through the inverse of the inertia matrix.
    slope = np.empty((MOTIONS, PLACES))
    for j in range(PLACES):
        unit = half if j in (1, 2) else 1.0
        slope[0, j] = force * theta[0, j] * unit
        slope[1, j] = by * (body[IZZ] * theta[1, j] + body[IXZ] * theta[2, j]) * unit
        slope[2, j] = by * (body[IXZ] * theta[1, j] + body[IXX] * theta[2, j]) * unit
    m = np.empty((3, 3), dtype=np.complex128)
    for f in range(frequencies.shape[0]):
        s = 2j * math.pi * frequencies[f]
        for i in range(3):
            for j in range(3):
                m[i, j] = -slope[i, j]
            m[i, i] += s
        m[0, 1] -= pitch + g / s
        m[0, 2] -= pitch * g / s - 1.0
        _solve(m, slope, half, out, f)


@register_jitable
def _solve(m: Complex, slope: Array, half: float, out: Complex, f: int) -> None:
    """The motions of a line by Cramer's rule, m (3, 3) times them being the surfaces' columns of `slope`."""
    a = m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]
    b = m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2]
    c = m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]
    det = m[0, 0] * a + m[0, 1] * b + m[0, 2] * c
    for k in range(2):
        x, y, z = slope[0, 3 + k], slope[1, 3 + k], slope[2, 3 + k]
        out[0, k, f] = (
            x * a + y * (m[0, 2] * m[2, 1] - m[0, 1] * m[2, 2]) + z * (m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1])
        ) / det
        out[1, k, f] = (
            half
            / det
            * (x * b + y * (m[0, 0] * m[2, 2] - m[0, 2] * m[2, 0]) + z * (m[0, 2] * m[1, 0] - m[0, 0] * m[1, 2]))
        )
        out[2, k, f] = (
            half
            / det
            * (x * c + y * (m[0, 1] * m[2, 0] - m[0, 0] * m[2, 1]) + z * (m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]))
        )


@register_jitable
def _left(x: Complex, z: Complex, theta: Array, f: int) -> complex:
    """What the parameters leave of a line."""
    rest = z[f]
    for i in range(PLACES):
        rest -= theta[i] * x[i, f]
    return complex(rest)


@register_jitable
def _level(x: Complex, z: Complex, theta: Array, noise: Array, spectrum: Array, extent: Array) -> None:
    """What the level of the gust's spectrum is the quotient of -> `extent`."""
    for f in range(z.shape[0]):
        rest = _left(x, z, theta, f)
        square = rest.real**2 + rest.imag**2
        extent[LEVEL] += (square - noise[f]) * spectrum[f]
        extent[OF_LEVEL] += spectrum[f] ** 2


@register_jitable
def _products(x: Complex, y: Complex, z: Complex, doubt: Complex, weight: Array, one: Sums) -> None:
    """Of one equation, added to `one`."""
    for f in range(z.shape[0]):
        w = weight[f]
        one.extent[ENERGY] += w * (z[f].real ** 2 + z[f].imag ** 2)
        for i in range(PLACES):
            a, b, c, d = w * y[i, f].real, w * y[i, f].imag, w * x[i, f].real, w * x[i, f].imag
            one.right[i] += a * z[f].real + b * z[f].imag
            one.direct[i] += c * z[f].real + d * z[f].imag
            one.doubt[i] += a * doubt[f].real + b * doubt[f].imag
            for j in range(PLACES):
                one.cross[i, j] += a * x[j, f].real + b * x[j, f].imag
                one.own[i, j] += a * y[j, f].real + b * y[j, f].imag
                one.normal[i, j] += c * x[j, f].real + d * x[j, f].imag


@register_jitable
def _scores(x: Complex, y: Complex, z: Complex, weight: Array, theta: Array, inverse: Array, score: Array) -> None:
    """As equation_error's, with instruments -> `score` (lines, PLACES)."""
    for f in range(z.shape[0]):
        rest, pull = _left(x, z, theta, f), 0.0
        for i in range(PLACES):
            for j in range(PLACES):
                pull += inverse[i, j] * (x[i, f].real * y[j, f].real + x[i, f].imag * y[j, f].imag) * weight[f]
        free = min(max(1.0 - pull, 0.2), 1.0)
        for i in range(PLACES):
            score[f, i] = weight[f] * (y[i, f].real * rest.real + y[i, f].imag * rest.imag) / free


@register_jitable
def _of(sums: Sums, e: int) -> Sums:
    return Sums(
        sums.cross[e], sums.own[e], sums.normal[e], sums.scores[e], sums.right[e], sums.direct[e], sums.doubt[e],
        sums.extent[e],
    )  # fmt: skip


@register_jitable
def _with_past(now: Sums, past: Sums, close: bool) -> None:
    """Add the closed segments' sums to this one's, which `close` adds to them."""
    for i in range(PLACES):
        for j in range(PLACES):
            now.cross[i, j] += past.cross[i, j]
            now.own[i, j] += past.own[i, j]
            now.normal[i, j] += past.normal[i, j]
            now.scores[i, j] += past.scores[i, j]
        now.right[i] += past.right[i]
        now.direct[i] += past.direct[i]
        now.doubt[i] += past.doubt[i]
    if close:
        _copied(past, now)


@register_jitable
def _copied(past: Sums, now: Sums) -> None:
    """By element: numba takes seconds to compile the check of two arrays' shapes."""
    for i in range(PLACES):
        for j in range(PLACES):
            past.cross[i, j] = now.cross[i, j]
            past.own[i, j] = now.own[i, j]
            past.normal[i, j] = now.normal[i, j]
        past.right[i] = now.right[i]
        past.direct[i] = now.direct[i]
        past.doubt[i] = now.doubt[i]


@register_jitable
def _without(still: Array, one: Sums) -> None:
    """Leave the regressors of surfaces that stand `still` out of an equation: they decouple, with nothing of z."""
    for i in range(PLACES):
        if still[i] > 0.0:
            for j in range(PLACES):
                one.cross[i, j] = one.cross[j, i] = one.own[i, j] = one.own[j, i] = 0.0
                one.normal[i, j] = one.normal[j, i] = 0.0
            one.cross[i, i] = one.own[i, i] = one.normal[i, i] = 1.0
            one.right[i] = one.direct[i] = one.doubt[i] = 0.0


@register_jitable
def _weights(level: float, noise: Array, spectrum: Array, z: Complex, weight: Array) -> None:
    """Of the lines of an equation -> `weight`."""
    lines, energy = z.shape[0], 0.0
    for f in range(lines):
        energy += z[f].real ** 2 + z[f].imag ** 2
    least = LEAST_NOISE * energy / lines + 1e-300
    for f in range(lines):
        weight[f] = 1.0 / (max(level, 0.0) * spectrum[f] + max(noise[f], least))


@njit(cache=True, error_model="numpy")
def fit_by_input(
    spectra: tuple[Complex, Complex, Complex, Complex], about: tuple[Array, Array, Array, Array], share: float,
    close: bool, past: Sums, fitted: Fitted, moved: Array, r2: Array,
) -> None:  # fmt: skip
    """All three equations.

    `spectra`: of the regressors X (PLACES, frequencies), their instruments Y alike, of CY, Cl and Cn, and of what these
    may have to hold beside, which moves the parameters by `moved` (EQUATIONS, PLACES). `about`: N
    (EQUATIONS, frequencies), energy of the noise of all samples; Phi (frequencies,); of each regressor, 1 where its
    surface stands still; first estimates (EQUATIONS, PLACES). `share`: T df, see equation_error.fit. Edits `past`,
    fills `fitted`, `moved` and `r2`, which is NaN without a solution and else the weighted share explained.
    """
    past, fitted = Sums(*past), Fitted(*fitted)
    x, y, zs, doubts = spectra
    noise, spectrum, still, theta = about
    lines = x.shape[1]
    independent = min(max(share, 1e-3), 1.0)
    weight, score, inverse = np.empty(lines), np.empty((lines, PLACES)), np.empty((PLACES, PLACES))
    for e in range(EQUATIONS):
        z, before = zs[e], _of(past, e)
        now = Sums(
            np.zeros((PLACES, PLACES)), np.zeros((PLACES, PLACES)), np.zeros((PLACES, PLACES)),
            np.zeros((PLACES, PLACES)), np.zeros(PLACES), np.zeros(PLACES), np.zeros(PLACES), np.zeros(4),
        )  # fmt: skip
        _level(x, z, theta[e], noise[e], spectrum, now.extent)
        now.extent[LINES] = lines * independent
        level = (now.extent[LEVEL] + before.extent[LEVEL]) / (now.extent[OF_LEVEL] + before.extent[OF_LEVEL])
        _weights(level, noise[e], spectrum, z, weight)
        _products(x, y, z, doubts[e], weight, now)
        _with_past(now, before, close)
        carry(before.extent, now.extent, close)
        _without(still, now)
        r2[e] = math.nan
        if not invert_general(now.own, PLACES, inverse):
            continue
        for i in range(PLACES):
            fitted.inflation[e, i] = inverse[i, i] * now.own[i, i]
            for j in range(PLACES):
                fitted.inverse[e, i, j] = inverse[i, j]
        if not invert_general(now.cross, PLACES, inverse):
            continue
        for i in range(PLACES):
            fitted.value[e, i] = moved[e, i] = 0.0
            for j in range(PLACES):
                fitted.value[e, i] += inverse[i, j] * now.right[j]
                moved[e, i] += inverse[i, j] * now.doubt[j]
        _scores(x, y, z, weight, fitted.value[e], inverse, score)
        newey_west(score, independent, now.scores)
        for i in range(PLACES * close):
            for j in range(PLACES):
                before.scores[i, j] = now.scores[i, j]
        r2[e] = _errors(now, inverse, fitted.value[e], fitted.error[e])


@register_jitable
def _errors(now: Sums, inverse: Array, theta: Array, error: Array) -> float:
    """Standard errors of the parameters -> `error`; returns R2."""
    rest = now.extent[ENERGY]
    for i in range(PLACES):
        rest -= 2.0 * theta[i] * now.direct[i]
        for j in range(PLACES):
            rest += theta[i] * now.normal[i, j] * theta[j]
    variance = 0.5 * max(rest, 0.0) / max(now.extent[LINES] - 0.5 * PLACES, 1.0)
    for i in range(PLACES):
        plain, coloured = 0.0, 0.0
        for a in range(PLACES):
            for b in range(PLACES):
                plain += inverse[i, a] * now.own[a, b] * inverse[i, b]
                coloured += inverse[i, a] * now.scores[a, b] * inverse[i, b]
        error[i] = SMALL_RECORD * math.sqrt(max(variance * plain, coloured, 0.0))
    total = now.extent[ENERGY]
    return 1.0 - rest / total if total > 0.0 and math.isfinite(theta.sum()) else math.nan
