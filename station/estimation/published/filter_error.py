"""Filter error (method fe), and the longitudinal motion fitted by it or by output error.

Filter error: the model's output is the one-step prediction of a steady-state Kalman filter, so it stands turbulence;
its process-noise amplitudes are estimated with the derivatives, the residual variances in turn with them. SI, rad.
Source: Jategaonkar 2015, Flight Vehicle System Identification, chapters 4 and 5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.estimation.published.kalman import parameter_vector
from station.estimation.published.longitudinal_motion import NX, NY, PARAMETERS, Body, advance, outputs, rates
from station.estimation.published.output_error import (
    Convergence,
    OutputFit,
    Simulate,
    coloured_errors,
    gauss_newton,
    information_of,
    invert,
    sensitivities,
    variances,
)
from station.numerics.regression import NotIdentifiable

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Longitudinal:
    """Output or filter error of the longitudinal motion (longitudinal_motion.py).

    `start` (4,) fixed initial state; `fixed` values of the other parameters; `free` those estimated; `inputs` (n, 3).
    """

    body: Body
    start: Array
    fixed: Mapping[str, float]
    free: tuple[str, ...]
    inputs: Array
    dt: float

    def _vectors(self) -> tuple[Array, Integers, Array]:
        index = np.array([PARAMETERS.index(name) for name in self.free], dtype=np.int64)
        return parameter_vector(self.fixed), index, np.ascontiguousarray(self.inputs, dtype=np.float64)

    def output_error(self, measured: Array, initial: Sequence[float], convergence: Convergence) -> OutputFit:
        """Fit `measured` (n, 7) with the parameters `free` starting at `initial`. Raises NotIdentifiable."""
        base, index, inputs = self._vectors()
        c = self.body.constants()

        def simulate(values: Array) -> Array:
            p = base.copy()
            p[index] = values
            return _simulate(c, p, self.start, inputs, self.dt)

        return gauss_newton(simulate, measured, np.asarray(initial, dtype=np.float64), convergence)

    def predictions(self, measured: Array, values: Array, amplitudes: Array, noise: Array) -> Array:
        """One-step predictions (n, 7) of the filter at `values` of the parameters `free` and process-noise `amplitudes`
        (4,), with the gain for the measurement `noise` variances (7,)."""
        base, index, inputs = self._vectors()
        c = self.body.constants()
        base[index] = values
        gain = steady_gain(*_linearise(c, base, self.start, inputs[0]), amplitudes, noise, self.dt)
        return _predict(c, base, gain, self.start, inputs, np.ascontiguousarray(measured, dtype=np.float64), self.dt)

    def filter_error(
        self, measured: Array, initial: Sequence[float], amplitudes: Sequence[float], convergence: Convergence
    ) -> OutputFit:
        """As `output_error`, with the process-noise amplitudes of V, alpha, theta, q estimated after the parameters.

        The gain is that of the motion linearised at `start`; A P + P A' - P C' R^-1 C P / dt + F F' = 0, K = P C' R^-1.
        The diagonal of K C is kept at or below 1, so that no state is corrected by more than its measured error.
        Missing measurements are an error: the gain is a steady one. Raises NotIdentifiable.
        """
        if not np.isfinite(measured).all():
            raise NotIdentifiable("filter error needs every sample of every output")
        base, index, inputs = self._vectors()
        c = self.body.constants()
        m = len(self.free)
        p = np.concatenate([np.asarray(initial, dtype=np.float64), np.asarray(amplitudes, dtype=np.float64)])
        z = np.ascontiguousarray(measured, dtype=np.float64)

        def gain(values: Array, noise: Array) -> tuple[Array, Array]:
            q = base.copy()
            q[index] = values[:m]
            return q, steady_gain(*_linearise(c, q, self.start, inputs[0]), values[m:], noise, self.dt)

        def predict(values: Array, noise: Array) -> Array:
            q, k = gain(values, noise)
            return _predict(c, q, k, self.start, inputs, z, self.dt)

        def share(values: Array, noise: Array) -> Array:
            q, k = gain(values, noise)
            return np.diag(k @ _linearise(c, q, self.start, inputs[0])[1])

        start = base.copy()
        start[index] = initial
        _, h = _linearise(c, start, self.start, inputs[0])
        # Without a filter first: its residuals are too large, so the first gain is a gentle one.
        noise = z - _simulate(c, start, self.start, inputs, self.dt)
        if not np.isfinite(noise).all():
            raise NotIdentifiable("the start values do not give a finite simulation")
        return filter_error(predict, share, np.abs(h), z, np.mean(noise**2, axis=0), p, m, convergence)


Filtered = Callable[[Array, Array], Array]
"""Parameters with the states' amplitudes after them, residual variances (k,) -> outputs (n, k) or diagonal of K C."""


def filter_error(
    predict: Filtered,
    share: Filtered,
    influence: Array,
    z: Array,
    noise: Array,
    p: Array,
    m: int,
    convergence: Convergence,
) -> OutputFit:
    """Gauss-Newton, each step with the gain for the residual variances of the step before.

    p[m:] are searched as variances: they enter the gain squared, so that the slope on an amplitude that comes to
    nothing vanishes, and its steps overshoot without end. One that is nothing, and would be less, is left out of a
    step. A step counts as better by the sum of the logarithms of the residual variances and, weighted with the
    constraint's own Lagrange multiplier, how far the diagonal of K C exceeds 1.

    When the residual variances change, the amplitudes are scaled so that the gain stays about what it was (Jategaonkar
    2015, section 5.4); `influence` (k, states) says how much each output sees of each state.
    """
    used = np.ones(z.shape, dtype=bool)
    iterations, converged = 0, False
    p[m:] = p[m:] ** 2
    least = NOTHING**2 * p[m:]

    def amplitudes(values: Array) -> Array:
        return np.concatenate([values[:m], np.sqrt(np.maximum(values[m:], least))])

    _tame(predict, share, amplitudes, p, noise, m)
    while iterations < convergence.searches and not converged:
        iterations += 1

        def simulate(values: Array, held: Array = noise) -> Array:
            return predict(amplitudes(values), held)

        def shared(values: Array, held: Array = noise) -> Array:
            return share(amplitudes(values), held)

        e = z - simulate(p)
        sensitivity = sensitivities(simulate, p, 1e-3, used)
        latest = variances(e, used.sum(axis=0))
        score = np.einsum("aij,ij,j->a", sensitivity, e, 1 / latest)
        free = np.concatenate([np.ones(m, dtype=bool), (p[m:] > 1.01 * least) | (score[m:] > 0)])
        covariance = np.zeros((len(p), len(p)))
        covariance[np.ix_(free, free)] = invert(information_of(sensitivity[free], latest))
        step, price = _within(shared, p, covariance @ score, covariance)
        price *= 2 / len(z)

        def merit(values: Array, residual: Array, price: float = price, shared: Simulate = shared) -> float:
            return _log_variances(residual) + (2 * price * _excess(shared(values)) if price > 0 else 0.0)

        small = bool(np.max((np.abs(step) / np.sqrt(np.maximum(np.diag(covariance), 1e-300)))[:m]) < convergence.step)
        p, e = _halved(lambda values: z - simulate(values), merit, p, e, step, least)
        latest = variances(e, used.sum(axis=0))
        p[m:] = np.maximum(p[m:] * _scale(influence, noise, latest) ** 2, least)
        converged = small and float(np.max(np.abs(latest / noise - 1))) < convergence.noise
        noise = latest
        _tame(predict, share, amplitudes, p, noise, m)
    found = amplitudes(p)
    model = predict(found, noise)
    # From variances back to amplitudes: d(a^2) = 2 a da.
    change = np.concatenate([np.ones(m), 0.5 / found[m:]])
    covariance = covariance * np.outer(change, change)
    return OutputFit(
        estimate=found,
        se_white=np.sqrt(np.diag(covariance)),
        se_coloured=coloured_errors(sensitivity / change[:, None, None], z - model, noise, covariance, False),
        covariance=covariance,
        noise=noise,
        model=model,
        residual=z - model,
        iterations=iterations,
        converged=converged,
    )


NOTHING: Final = 0.01
"""An amplitude this share of what it started as is nothing."""


def _halved(
    residual: Simulate, merit: Callable[[Array, Array], float], p: Array, e: Array, step: Array, least: Array
) -> tuple[Array, Array]:
    """Parameters and residuals after the step, halved until it does no harm, from `p` and `e`; variances, the last of
    `p`, stay at their `least` or above."""
    now, m = merit(p, e), len(p) - len(least)
    for _halving in range(12):
        trial = np.concatenate([(p + step)[:m], np.maximum((p + step)[m:], least)])
        rest = residual(trial)
        if np.isfinite(rest).all() and merit(trial, rest) <= now + 1e-7:
            return trial, rest
        step = step / 2
    return p, e


def _scale(influence: Array, noise: Array, latest: Array) -> Array:
    """Of the amplitudes, so that the gain stays about what it was when residual variances go from `noise` to
    `latest` (k,)."""
    weight = influence**2 / noise[:, None]
    scale: Array = (weight * np.sqrt(latest / noise)[:, None]).sum(axis=0) / weight.sum(axis=0)
    return scale


def _tame(predict: Filtered, share: Filtered, amplitudes: Simulate, p: Array, noise: Array, m: int) -> None:
    """Reduce the variances p[m:] in place while the filter overcorrects so much that it may diverge."""
    for _ in range(60):
        values = amplitudes(p)
        if np.max(share(values, noise)) < STABLE_SHARE and np.isfinite(predict(values, noise)).all():
            return
        p[m:] *= 0.5
    raise NotIdentifiable("no process noise keeps the filter stable")


def _excess(share: Array) -> float:
    """By how much the diagonal of K C exceeds 1, summed."""
    return float(np.maximum(share - 1, 0).sum())


STABLE_SHARE: Final = 1.5
"""Of K C; a state corrected by twice its error stays as wrong as it was."""


def _within(share: Simulate, p: Array, step: Array, covariance: Array) -> tuple[Array, float]:
    """The best step that leaves the diagonal of K C at most 1, to first order, and the constraint's largest Lagrange
    multiplier, 0 if the step is as it was."""
    beyond = np.flatnonzero(share(p + step) > 1)
    if len(beyond) == 0:
        return step, 0.0
    slope = np.empty((len(beyond), len(p)))
    for j, value in enumerate(p):
        d = np.zeros(len(p))
        d[j] = 1e-4 * abs(value) if value != 0 else 1e-6
        slope[:, j] = (share(p + d) - share(p - d))[beyond] / (2 * d[j])
    excess = slope @ step - (1 - share(p)[beyond])
    across = covariance @ slope.T
    multiplier = np.linalg.solve(slope @ across, excess)
    changed: Array = step - across @ multiplier
    return changed, float(np.max(np.abs(multiplier)))


def _log_variances(e: Array) -> float:
    """Sum of the logarithms of the residual variances; infinite for a simulation that diverged."""
    if not np.isfinite(e).all():
        return float("inf")
    return float(np.log(np.mean(e * e, axis=0)).sum())


def steady_gain(a: Array, h: Array, amplitudes: Array, noise: Array, dt: float) -> Array:
    """K (states, outputs) from the stable invariant subspace of the Riccati equation's Hamiltonian matrix, for A and C
    (`a`, `h`)."""
    n = len(a)
    hamiltonian = np.block([[a.T, -(h.T / noise) @ h / dt], [-np.diag(amplitudes**2), -a]])
    if not np.isfinite(hamiltonian).all():
        raise NotIdentifiable("no steady filter gain")
    values, vectors = np.linalg.eig(hamiltonian)
    stable = vectors[:, np.argsort(values.real)[:n]]
    try:
        steady = np.linalg.solve(stable[:n].T, stable[n:].T).T.real
    except np.linalg.LinAlgError as error:
        raise NotIdentifiable("no steady filter gain") from error
    return np.ascontiguousarray(steady @ h.T / noise)


@njit(cache=True)
def _linearise(c: Array, p: Array, x: Array, u: Array) -> tuple[Array, Array]:
    """A (4, 4) and C (7, 4) by central differences."""
    a, h = np.empty((NX, NX)), np.empty((NY, NX))
    rate, output, moved = np.empty((2, NX)), np.empty((2, NY)), x.copy()
    for j in range(NX):
        for side in range(2):
            moved[j] = x[j] + (1e-5 if side == 0 else -1e-5)
            rates(moved, u, p, c, rate[side])
            outputs(moved, u, p, c, output[side])
        moved[j] = x[j]
        a[:, j] = (rate[0] - rate[1]) / 2e-5
        h[:, j] = (output[0] - output[1]) / 2e-5
    return a, h


@njit(cache=True)
def _simulate(c: Array, p: Array, start: Array, u: Array, dt: float) -> Array:
    n = len(u)
    y, x, work = np.empty((n, NY)), start.copy(), np.empty((6, NX))
    for k in range(n):
        if k > 0:
            advance(x, u[k - 1], u[k], dt, p, c, work)
        outputs(x, u[k], p, c, y[k])
    return y


@njit(cache=True)
def _predict(c: Array, p: Array, gain: Array, start: Array, u: Array, z: Array, dt: float) -> Array:
    n = len(u)
    y, x, work = np.empty((n, NY)), start.copy(), np.empty((6, NX))
    for k in range(n):
        if k > 0:
            for i in range(NX):
                for j in range(NY):
                    x[i] += gain[i, j] * (z[k - 1, j] - y[k - 1, j])
            advance(x, u[k - 1], u[k], dt, p, c, work)
        outputs(x, u[k], p, c, y[k])
    return y
