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
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.model import regressor_error
from station.model import unsteady_lift as lift_memory
from station.model.coefficients import (
    force_coefficients,
    lift_and_drag,
    pitching_moment,
    specific_force_at_cg,
    thrust_by_drag_polar,
)
from station.numerics.regression import invert
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]

SMALL_RECORD: Final = 1.15
NEXT_ORDER: Final = 0.5
GUST_STANDS_OUT: Final = 2.5
"""Energy of d over the ridge, which the sensors' noise alone makes."""
MAX_PARAMETERS: Final = 4
MEAN_S: Final = 30.0
"""Over which thrust and density are averaged."""

# Sums over closed segments: normal matrix, score products (each places x places), right side, next order of the gust's
# lag (places), energy, lines; then those of lift_memory and regressor_error. Where `next order` begins with four
# places, and theirs:
_NEXT: Final = 36
_MEMORY: Final = 42
_WRONG: Final = _MEMORY + lift_memory.SUMS


def past_size(places: int) -> int:
    """Length of `fit`'s `past` for up to so many parameters."""
    return 2 * places * places + 2 * places + 2


PAST: Final = past_size(MAX_PARAMETERS) + lift_memory.SUMS + regressor_error.SUMS

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
    pdot = (history[2, _P] - history[0, _P]) / (2.0 * dt)
    qdot = (history[2, _Q] - history[0, _Q]) / (2.0 * dt)
    rdot = (history[2, _R] - history[0, _R]) / (2.0 * dt)
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
def fit(
    x: Complex, z: Complex, ridge: Array, independent: float, past: Array, close: bool, out: Array, inverse: Array
) -> bool:
    """Least squares of `z` (frequencies,) on `x` (parameters, frequencies), parameters <= places, and on the `past`.

    `ridge`: added to the diagonal of Re(X^H X), (parameters,). `independent`: T df of `x`, how many independent lines
    there are to a line of the grid. `past` (past_size(places),): sums over the segments closed before; `close` adds
    this one. `out` (3, parameters + 1): parameters; standard errors; variance inflation by collinearity; in the last
    column R2, residual energy and signal energy. `inverse` (places, places): of the normal matrix. False if there is no
    solution.
    """
    n, lines = x.shape
    places = inverse.shape[0]
    cloud_at, rhs_at = places * places, 2 * places * places
    energy_at = rhs_at + 2 * places
    m = np.zeros((n, n))
    rhs = np.zeros(n)
    energy = 0.0
    for f in range(lines):
        for i in range(n):
            a, b = x[i, f].real, x[i, f].imag
            rhs[i] += a * z[f].real + b * z[f].imag
            for j in range(i + 1):
                m[i, j] += a * x[j, f].real + b * x[j, f].imag
        energy += z[f].real ** 2 + z[f].imag ** 2
    share = min(max(independent, 1e-3), 1.0)
    count = past[energy_at + 1] + lines * share
    energy += past[energy_at]
    for i in range(n):
        rhs[i] += past[rhs_at + i]
        for j in range(i + 1):
            m[i, j] += past[places * i + j]
    if close:
        past[energy_at + 1] = count
        past[energy_at] = energy
        for i in range(n):
            past[rhs_at + i] = rhs[i]
            for j in range(i + 1):
                past[places * i + j] = m[i, j]
    for i in range(n):
        m[i, i] += ridge[i]
        for j in range(i):
            m[j, i] = m[i, j]
    if not invert(m, n, inverse):
        return False
    theta = np.zeros(n)
    for i in range(n):
        out[2, i] = inverse[i, i] * m[i, i]
        for j in range(n):
            theta[i] += inverse[i, j] * rhs[j]

    score = np.zeros((lines, n))
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
    lags = min(max(math.ceil(1.5 / share), 2), 12)
    cloud = np.zeros((n, n))
    for lag in range(lags + 1):
        weight = 1.0 if lag == 0 else 2.0 * (1.0 - lag / (lags + 1.0))
        for f in range(lines - lag):
            for i in range(n):
                for j in range(n):
                    cloud[i, j] += weight * score[f, i] * score[f + lag, j]
    left = energy
    for i in range(n):
        left -= 2.0 * theta[i] * rhs[i]
        for j in range(n):
            left += theta[i] * m[i, j] * theta[j]
            cloud[i, j] += past[cloud_at + places * i + j]
            if close:
                past[cloud_at + places * i + j] = cloud[i, j]
        left -= theta[i] * ridge[i] * theta[i]
    left = max(left, 0.0)
    variance = 0.5 * left / max(count - 0.5 * n, 1.0)
    for i in range(n):
        sandwich = 0.0
        for a in range(n):
            for b in range(n):
                sandwich += inverse[i, a] * cloud[a, b] * inverse[b, i]
        out[0, i] = theta[i]
        out[1, i] = SMALL_RECORD * math.sqrt(max(variance * inverse[i, i], sandwich, 0.0))
    out[0, n] = 1.0 - left / energy if energy > 0.0 else 0.0
    out[1, n] = left
    out[2, n] = energy
    return math.isfinite(theta.sum())


@njit(cache=True)
def fit_methods(
    steady: Complex,
    split: Complex,
    derivative: Array,
    scale: Array,
    measured: Complex,
    tail: Array,
    doubt: tuple[Complex, Complex, Array],
    wind: float,
    samples: float,
    ridge: float,
    independent: Array,
    close: Flags,
    past: Array,
    out: Array,
    model: Array,
    solved: Flags,
) -> None:
    """Both equations of II, III, V, split and split+gust, in that order, and of IV where `out` has a sixth place.

    `steady` and `split`: spectra, channels q c/2V, elevator, CL, Cm, then alpha's own. `derivative`: factor of Cm for
    its central difference; `scale`: of V's vane part; `tail`: tan(w l_t/4V); all (frequencies,). `measured`: factors of
    the delayed vane and rate parts in IV, (2, frequencies). `doubt`: what lift_memory.weights and
    regressor_error.weights made; `wind`: see regressor_error.off; `samples`: of split, on which `ridge`, of the gust
    regressor, is too. `independent` and `close`, (2,): of either group, as in `fit`. Edits `past` (kinds, 2, PAST);
    fills `out` (kinds, 2, 3, MAX_PARAMETERS + 1), as `fit` does, `model` (kinds, 2, 3) and `solved` (kinds, 2); kinds
    is 5, or 6 with IV.

    `model` is what the structure leaves, in each parameter. The gust meets wing and tail late, and d carries the first
    order of that; split+gust may be wrong by the next, d (1 - e^{-s T/2})/(1 + e^{-s T/2}) with T = l_t/V and a
    coefficient NEXT_ORDER times d's own (from Monte Carlo of both Twin Otters), by what the lift's memory does to it
    where the gust stands out of the noise, and by what wrong regressors do to it. Any other method may be wrong by as
    much as it lies off split+gust besides.
    """
    lines = steady.shape[1]
    memory, wrong, noise = doubt
    left = np.empty((2, 3))
    z = np.empty(lines, dtype=np.complex128)
    x = np.empty((4, lines), dtype=np.complex128)
    ridges = np.zeros(4)
    ridges[3] = ridge
    inverse = np.zeros((4, 4))
    for turn in range(out.shape[0]):
        # split+gust first, which the others' `model` is taken from.
        kind = 4 - turn if turn < 5 else 5
        side = 1 if kind == 3 or kind == 4 else 0
        group = split if side == 1 else steady
        n = 4 if kind == 4 else 3
        for f in range(lines):
            if kind == 1:
                x[0, f] = group[5, f] + group[6, f]
            elif kind == 2:
                x[0, f] = group[5, f] * scale[f] + group[6, f]
            elif kind == 5:
                x[0, f] = group[5, f] * measured[0, f] + group[6, f] * measured[1, f]
            else:
                x[0, f] = group[4, f]
            if kind == 4:
                x[3, f] = group[5, f]
            x[1, f] = group[0, f]
            x[2, f] = group[1, f]
        for equation in range(2):
            for f in range(lines):
                z[f] = group[2, f] if equation == 0 else group[3, f] * derivative[f]
            sums = past[kind, equation]
            each = out[kind, equation, :, : n + 1]
            done = fit(x[:n], z, ridges[:n], independent[side], sums, close[side], each, inverse)
            solved[kind, equation] = done
            for i in range(3):
                if kind != 4:
                    off = out[kind, equation, 0, i] - out[4, equation, 0, i] if solved[4, equation] else 0.0
                    model[kind, equation, i] = math.hypot(off, model[4, equation, i])
                else:
                    model[kind, equation, i] = 0.0
            if kind == 4 and done:
                for i in range(4):
                    next_order = sums[_NEXT + i]
                    for f in range(lines):
                        next_order += (x[i, f].conjugate() * x[3, f] * 1j * tail[f]).real
                    if close[side]:
                        sums[_NEXT + i] = next_order
                    for j in range(3):
                        model[4, equation, j] += inverse[j, i] * next_order
                for j in range(3):
                    model[4, equation, j] = NEXT_ORDER * abs(model[4, equation, j] * out[4, equation, 0, 3])
        if kind == 4 and solved[4, 0] and solved[4, 1]:
            sums = past[4, 0, _WRONG:]
            regressor_error.off(wrong, noise, samples, wind, x, out[4, :, 0, :4], inverse, sums, close[side], left)
            for equation in range(2):
                for j in range(3):
                    model[4, equation, j] = math.hypot(model[4, equation, j], left[equation, j])
        if kind == 4 and solved[4, 0] and solved[4, 1] and memory[lift_memory.RELATIVE, 0].real > 0.0:
            lift_memory.left_out(memory, x, out[4, :, 0, :3], inverse, past[4, :, _MEMORY:], close[side], left)
            # The normal matrix without the ridge, from its inverse.
            d = out[4, 0, 2, 3] / inverse[3, 3] - ridge
            gust = max(1.0 - GUST_STANDS_OUT * ridge / d, 0.0) if d > 0.0 else 0.0
            for equation in range(2):
                for j in range(3):
                    model[4, equation, j] = math.hypot(model[4, equation, j], gust * left[equation, j])


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
