"""Method VI: extended Kalman filter on the longitudinal motion with any derivatives as further states.

State: V, alpha, theta, q and the free parameters, which are constant but for process noise. Prediction by fourth-order
Runge-Kutta; transition matrix by Taylor series of the linearised rates; update in Joseph's form. Measured V, alpha,
theta, q, qdot, ax, az; what is NaN is left out of the update. SI, rad.
Assumes white process and measurement noise of the given size, and angles of attack at the centre of gravity.
Source: Jategaonkar 2015, Flight Vehicle System Identification, section 7.5.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.estimation.published.longitudinal_motion import NX, NY, PARAMETERS, Body, advance, outputs, rates

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_STEP = 1e-4
"""Of the central differences, in each state's own unit."""
_TAYLOR = 10


@dataclass(frozen=True, slots=True)
class Track:
    """The filter's course: state and sd (n, 4 + m), innovation (n, 7; NaN where nothing was measured)."""

    free: tuple[str, ...]
    state: Array
    sd: Array
    innovation: Array

    def parameters(self, last: int = 1) -> tuple[Array, Array]:
        """Mean of the last samples of the estimates and of their standard deviations, (m,) each."""
        return self.state[-last:, NX:].mean(axis=0), self.sd[-last:, NX:].mean(axis=0)


@dataclass(frozen=True, slots=True)
class Tuning:
    """Variances. `initial` (4 + m,) of the state at the start; `process` (4 + m,) added each step; `measured` (7,)."""

    initial: Array
    process: Array
    measured: Array


def extended_kalman(
    body: Body,
    start: Array,
    parameters: Mapping[str, float],
    free: Sequence[str],
    tuning: Tuning,
    inputs: Array,
    measured: Array,
    dt: float,
) -> Track:
    """Filter a record.

    `start` (4,) is the state before the first measurement, `parameters` all values of longitudinal.PARAMETERS that are
    not 0, `free` those to be estimated (starting from them), `inputs` (n, 3), `measured` (n, 7). The state stays at its
    last finite value if the filter diverges; the caller sees it by NaN standard deviations. Raises KeyError for an
    unknown parameter.
    """
    p = parameter_vector(parameters)
    index = np.array([PARAMETERS.index(name) for name in free], dtype=np.int64)
    state = np.concatenate([start, p[index]])
    covariance = np.diag(tuning.initial)
    states, sds, innovations = _filter(
        _Model(body.constants(), p, index, dt),
        state,
        covariance,
        _Noise(*(np.ascontiguousarray(x, dtype=np.float64) for x in (tuning.process, tuning.measured))),
        np.ascontiguousarray(inputs, dtype=np.float64),
        np.ascontiguousarray(measured, dtype=np.float64),
    )
    return Track(tuple(free), states, sds, innovations)


def parameter_vector(values: Mapping[str, float]) -> Array:
    """Values in the order of longitudinal.PARAMETERS, 0 where none is given. Raises KeyError for an unknown name."""
    p = np.zeros(len(PARAMETERS))
    for name, value in values.items():
        if name not in PARAMETERS:
            raise KeyError(name)
        p[PARAMETERS.index(name)] = value
    return p


class _Model(NamedTuple):
    """The motion whose parameters are states too."""

    constants: Array
    """Body.constants"""
    parameters: Array
    """longitudinal_motion.PARAMETERS; those that are free follow the state."""
    free: Integers
    """Places of the parameters that are states."""
    dt: float


class _Noise(NamedTuple):
    """Variances: see Tuning."""

    process: Array
    measured: Array


@njit(cache=True)
def _filter(m: _Model, x: Array, cov: Array, noise: _Noise, u: Array, z: Array) -> tuple[Array, Array, Array]:
    samples, n = len(z), len(x)
    states, sds, innovations = np.empty((samples, n)), np.empty((samples, n)), np.full((samples, NY), np.nan)
    work = np.empty((6, NX))
    jacobian = np.empty((NY, n))
    for k in range(samples):
        if k > 0:
            phi = _transition(m, x, u[k - 1], work)
            advance(x, u[k - 1], u[k], m.dt, m.parameters, m.constants, work)
            cov = _propagate(phi, cov, noise.process)
        _update(m, x, cov, u[k], z[k], noise.measured, jacobian, innovations[k])
        states[k] = x
        for i in range(n):
            sds[k, i] = np.sqrt(cov[i, i]) if cov[i, i] >= 0 else np.nan
    return states, sds, innovations


@njit(cache=True)
def _set(m: _Model, x: Array) -> None:
    for j in range(len(m.free)):
        m.parameters[m.free[j]] = x[NX + j]


@njit(cache=True)
def _transition(m: _Model, x: Array, u: Array, work: Array) -> Array:
    """The first four rows of exp(A dt), (4, n); the rest of it is the identity."""
    n = len(x)
    slope = np.empty((NX, n))
    for j in range(n):
        kept = x[j]
        x[j] = kept + _STEP
        _set(m, x)
        rates(x, u, m.parameters, m.constants, work[0])
        x[j] = kept - _STEP
        _set(m, x)
        rates(x, u, m.parameters, m.constants, work[1])
        x[j] = kept
        for i in range(NX):
            slope[i, j] = (work[0, i] - work[1, i]) / (2 * _STEP)
    _set(m, x)
    phi = np.zeros((NX, n))
    for i in range(NX):
        phi[i, i] = 1.0
    term = slope * m.dt
    for order in range(2, _TAYLOR + 2):
        phi += term
        # A has only its first four rows, so A^k = (its left 4 x 4)^(k-1) A.
        following = np.zeros((NX, n))
        for i in range(NX):
            for k in range(NX):
                f = slope[i, k] * m.dt / order
                for j in range(n):
                    following[i, j] += f * term[k, j]
        term = following
    return phi


@njit(cache=True)
def _propagate(phi: Array, cov: Array, process: Array) -> Array:
    """Phi P Phi' + Q with the identity part of Phi left out of the arithmetic."""
    n = len(cov)
    half = cov.copy()
    for i in range(NX):
        for j in range(n):
            total = 0.0
            for m in range(n):
                total += phi[i, m] * cov[m, j]
            half[i, j] = total
    full = half.copy()
    for i in range(n):
        for j in range(NX):
            total = 0.0
            for m in range(n):
                total += half[i, m] * phi[j, m]
            full[i, j] = total
    for i in range(n):
        full[i, i] += process[i]
    return full


@njit(cache=True)
def _update(
    m: _Model, x: Array, cov: Array, u: Array, z: Array, noise: Array, jacobian: Array, innovation: Array
) -> None:
    """Correct x and cov in place by what is finite in z."""
    n = len(x)
    high, low = np.empty(NY), np.empty(NY)
    for j in range(n):
        kept = x[j]
        x[j] = kept + _STEP
        _set(m, x)
        outputs(x, u, m.parameters, m.constants, high)
        x[j] = kept - _STEP
        _set(m, x)
        outputs(x, u, m.parameters, m.constants, low)
        x[j] = kept
        for i in range(NY):
            jacobian[i, j] = (high[i] - low[i]) / (2 * _STEP)
    _set(m, x)
    outputs(x, u, m.parameters, m.constants, high)
    used = np.flatnonzero(np.isfinite(z) & np.isfinite(noise))
    rows = len(used)
    if rows == 0:
        return
    h = np.empty((rows, n))
    for i in range(rows):
        h[i] = jacobian[used[i]]
        innovation[used[i]] = z[used[i]] - high[used[i]]
    pht = cov @ h.T
    s = h @ pht
    for i in range(rows):
        s[i, i] += noise[used[i]]
    gain = np.linalg.solve(s, pht.T).T
    for i in range(n):
        for j in range(rows):
            x[i] += gain[i, j] * innovation[used[j]]
    _set(m, x)
    keep = -(gain @ h)
    for i in range(n):
        keep[i, i] += 1.0
    scaled = gain.copy()
    for j in range(rows):
        scaled[:, j] *= noise[used[j]]
    cov[:, :] = keep @ cov @ keep.T + scaled @ gain.T


def warm_up() -> None:
    """Compile the filter."""
    body = Body(0.004, 8e-4, 7000.0, 100.0, 1.2)
    tuning = Tuning(np.ones(NX + 1), np.zeros(NX + 1), np.ones(NY))
    start = np.array([100.0, 0.1, 0.1, 0.0])
    inputs = np.tile([0.0, 1e4, 0.8], (2, 1))
    extended_kalman(
        body,
        start,
        {"CL_alpha": 5.0},
        ("CL_alpha",),
        tuning,
        inputs,
        np.tile(np.append(start, [0, 0, -9.8]), (2, 1)),
        0.1,
    )
