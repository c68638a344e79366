"""The lateral motion by filter and output error: roll and yaw rate integrated, with process noise or without, all else
as measured.

    Ixx pdot - Ixz rdot = qbar S b Cl + ...,   Izz rdot - Ixz pdot = qbar S b Cn + ...,   m ay = qbar S CY
    C = C_0 + C_beta beta + C_p p b/2V + C_r r b/2V + C_da da + C_dr dr

with the gyroscopic terms of coefficients.roll_and_yaw_moment. Outputs pdot, rdot, ay, p, r. Sideslip is an input, so
that neither bank nor the side gust that the vane shows need a model; process noise is what else moves the aircraft,
which output error takes for noise of its sensors. SI, rad. Source: Jategaonkar 2015, Flight Vehicle System
Identification, sections 4.2 (output error) and 5.11.1 (test case 2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.estimation.flight_record import FlightRecord
from station.estimation.published.filter_error import filter_error, steady_gain
from station.estimation.published.output_error import Convergence, OutputFit, gauss_newton
from station.estimation.results import (
    LATERAL_FORCES,
    LATERAL_SURFACES,
    completed,
    equations,
    excited,
    inflation_of,
    judge,
)
from station.numerics.differentiation import derivative
from station.numerics.regression import NotIdentifiable, smoothed_start
from station.rows import ParamEstimate, Status

Array = NDArray[np.float64]

OUTPUTS: Final = ("pdot", "rdot", "ay", "p", "r")
"""Of filter error; output error has no use for slopes made of the rates, and fits"""
MEASURED: Final = ("ay", "p", "r")
STATES: Final = 2
TERMS: Final = 6
"""Of each coefficient: constant, sideslip, both rates, both surfaces."""
# constants: inverse of the inertia matrix, and what multiplies p q and q r in the moments
_PP, _PR, _RR, _IXZ, _IYY_IXX, _IZZ_IYY = range(6)
# inputs
_BETA, _DA, _DR, _Q, _MOMENT, _SIDE, _HALF = range(7)
"""The last three: qbar S b, qbar S/m and b/2V."""


@njit(cache=True)
def _rates(c: Array, theta: Array, x: Array, u: Array, out: Array) -> None:
    """pdot, rdot and ay -> `out` (3,)."""
    p, r = x[0], x[1]
    for i in range(3):
        out[i] = (
            theta[i, 0]
            + theta[i, 1] * u[_BETA]
            + (theta[i, 2] * p + theta[i, 3] * r) * u[_HALF]
            + theta[i, 4] * u[_DA]
            + theta[i, 5] * u[_DR]
        )
    side = out[0] * u[_SIDE]
    roll = out[1] * u[_MOMENT] + c[_IXZ] * p * u[_Q] - c[_IZZ_IYY] * u[_Q] * r
    yaw = out[2] * u[_MOMENT] - c[_IXZ] * u[_Q] * r - c[_IYY_IXX] * p * u[_Q]
    out[0] = c[_PP] * roll + c[_PR] * yaw
    out[1] = c[_PR] * roll + c[_RR] * yaw
    out[2] = side


@njit(cache=True)
def _predict(c: Array, theta: Array, gain: Array, start: Array, u: Array, z: Array, dt: float) -> Array:
    """One-step predictions (n, 5) of the filter with that `gain` (2, 5); Heun's rule, inputs straight between."""
    n = len(u)
    y = np.empty((n, 5))
    x, slope, later, ahead = start.copy(), np.empty(3), np.empty(3), np.empty(STATES)
    for k in range(n):
        if k > 0:
            for i in range(STATES):
                for j in range(5):
                    x[i] += gain[i, j] * (z[k - 1, j] - y[k - 1, j])
            _rates(c, theta, x, u[k - 1], slope)
            for i in range(STATES):
                ahead[i] = x[i] + dt * slope[i]
            _rates(c, theta, ahead, u[k], later)
            for i in range(STATES):
                x[i] += 0.5 * dt * (slope[i] + later[i])
        _rates(c, theta, x, u[k], y[k, :3])
        y[k, 3], y[k, 4] = x[0], x[1]
    return y


def _linear(c: Array, theta: Array, u: Array) -> tuple[Array, Array]:
    """A (2, 2) and C (5, 2) at zero rates and the input `u`."""
    at, still = np.empty(3), np.empty(3)
    _rates(c, theta, np.zeros(STATES), u, still)
    h = np.zeros((len(OUTPUTS), STATES))
    for j in range(STATES):
        x = np.zeros(STATES)
        x[j] = 1.0
        _rates(c, theta, x, u, at)
        h[:3, j] = at - still
    h[3:] = np.eye(STATES)
    return h[:STATES], h


SETTLED: Final = Convergence(step=0.01, noise=1e-3, searches=30)


@dataclass(frozen=True, slots=True)
class _Setup:
    """The lateral motion of a record, ready to be integrated."""

    constant: Array
    inputs: Array
    """(n, 7)"""
    measured: Array
    """(n, 5)"""
    start: Array
    """Roll and yaw rate, (2,)."""
    used: NDArray[np.bool_]
    """(3, TERMS): all but those of surfaces that stand still."""
    theta: Array
    """(3, TERMS), by equation error,"""
    left: Array
    """which leaves so much of roll and yaw acceleration, (2,)."""

    def filled(self, values: Array) -> Array:
        """(3, TERMS) of the parameters that are used."""
        made = np.zeros((3, TERMS))
        made[self.used] = values
        return made


def _setup(record: FlightRecord) -> _Setup:
    """Raises NotIdentifiable."""
    m, frame = record.motion, record.airframe
    inertia = [float(np.mean(i)) for i in (frame.ixx, frame.iyy, frame.izz, frame.ixz)]
    if not np.isfinite(inertia).all():
        raise NotIdentifiable("the aircraft profile gives no ixx, iyy and izz")
    ixx, iyy, izz, ixz = inertia
    free_of = ixx * izz - ixz * ixz
    c = np.array([izz / free_of, ixz / free_of, ixx / free_of, ixz, iyy - ixx, izz - iyy])
    force = m["dynamic_pressure"] * frame.area
    half = 0.5 * frame.span / (m["airspeed"] if frame.rate_speed is None else np.full(len(force), frame.rate_speed))
    inputs = np.column_stack(
        [record.beta, m["aileron"], m["rudder"], m["q"], force * frame.span, force / frame.mass, half]
    )
    slopes = [m[f"{n}dot"] if record.has(f"{n}dot") else derivative(m[n], record.dt) for n in "pr"]
    z = np.column_stack([*slopes, m["ay"], m["p"], m["r"]])
    if not (np.isfinite(z).all() and np.isfinite(inputs).all()):
        raise NotIdentifiable("the lateral motion is integrated: every sample of every lateral signal is needed")
    still = [n for n in LATERAL_SURFACES if not excited(record, (n,))]
    used = np.ones((3, TERMS), dtype=bool)
    used[:, [4 + LATERAL_SURFACES.index(n) for n in still]] = False
    theta, left = _start(record, used)
    return _Setup(c, inputs, z, smoothed_start(z[:, 3:], 2.0, record.dt), used, theta, left)


Found = tuple[tuple[ParamEstimate, ...], OutputFit, dict[str, Any]]
"""The fifteen derivatives, the fit, and settings."""


def lateral_output_error(record: FlightRecord) -> Found:
    """Without process noise, of the outputs MEASURED; the initial rates are estimated along. Raises NotIdentifiable."""
    about = _setup(record)
    count = int(about.used.sum())
    none = np.zeros((STATES, len(OUTPUTS)))
    at = [OUTPUTS.index(n) for n in MEASURED]

    def simulate(values: Array) -> Array:
        theta, start = about.filled(values[:count]), values[count:]
        return _predict(about.constant, theta, none, start, about.inputs, about.measured, record.dt)[:, at]

    fit = gauss_newton(simulate, about.measured[:, at], np.concatenate([about.theta[about.used], about.start]))
    return _judged(record, fit, about.used), fit, {}


def lateral_filter_error(record: FlightRecord) -> Found:
    """With process noise, in all OUTPUTS. Raises NotIdentifiable."""
    about = _setup(record)
    c, inputs, z = about.constant, about.inputs, about.measured
    count = int(about.used.sum())
    middle = inputs.mean(axis=0)
    influence = np.abs(_linear(c, about.theta, middle)[1])

    def gain(values: Array, noise: Array) -> tuple[Array, Array]:
        a, h = _linear(c, about.filled(values[:count]), middle)
        return steady_gain(a, h, values[count:], noise, record.dt), h

    def predict(values: Array, noise: Array) -> Array:
        return _predict(c, about.filled(values[:count]), gain(values, noise)[0], about.start, inputs, z, record.dt)

    def share(values: Array, noise: Array) -> Array:
        k, h = gain(values, noise)
        return np.diag(k @ h)

    noise = z - _predict(c, about.theta, np.zeros((STATES, len(OUTPUTS))), about.start, inputs, z, record.dt)
    if not np.isfinite(noise).all():
        raise NotIdentifiable("the start values do not give a finite simulation")
    # As if what equation error leaves of the angular accelerations were white.
    amplitudes = about.left * math.sqrt(record.dt)
    first = np.concatenate([about.theta[about.used], amplitudes])
    fit = filter_error(predict, share, influence, z, np.mean(noise**2, axis=0), first, count, SETTLED)
    return _judged(record, fit, about.used), fit, {"process_noise_lateral": fit.estimate[count:].tolist()}


def _start(record: FlightRecord, used: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Equation error's parameters (3, TERMS), and what it leaves of roll and yaw acceleration, (2,)."""
    theta, left = np.zeros((3, TERMS)), np.zeros(3)
    for i, equation in enumerate(e for e in equations(record, "wind") if e.name in LATERAL_FORCES):
        x = equation.regressors
        good = np.isfinite(x).all(axis=1) & np.isfinite(equation.measured)
        full = np.column_stack([np.ones(good.sum()), x[good]])
        found, *_ = np.linalg.lstsq(full, equation.measured[good])
        theta[i, used[i]] = found
        left[i] = float(np.std(equation.measured[good] - full @ found))
    frame = record.airframe
    moment = float(np.nanmean(record.motion["dynamic_pressure"])) * frame.area * frame.span
    inertia = np.array([float(np.mean(frame.ixx)), float(np.mean(frame.izz))])
    return theta, left[1:] * moment / inertia


def _judged(record: FlightRecord, fit: OutputFit, used: NDArray[np.bool_]) -> tuple[ParamEstimate, ...]:
    status, why = (Status.ESTIMATED, "") if fit.converged else (
        Status.INVALID, f"not converged in {fit.iterations} iterations")  # fmt: skip
    errors = np.maximum(fit.se_white, fit.se_coloured)
    at = np.cumsum(used).reshape(used.shape) - 1
    made: list[ParamEstimate] = []
    for i, equation in enumerate(e for e in equations(record, "wind") if e.name in LATERAL_FORCES):
        inflation, own = inflation_of(equation.regressors), at[i, 1:][used[i, 1:]]
        found = judge(record, equation.parameters, fit.estimate[own], errors[own], inflation, status, why)
        made += completed(found, equation)
    return tuple(made)
