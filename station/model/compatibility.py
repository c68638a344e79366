"""Data compatibility: motion reconstructed from rates and accelerations alone, and the instruments' errors it shows.

    u' = r v - q w - g sin(theta) + ax,   v' = p w - r u + g cos(theta) sin(phi) + ay,
    w' = q u - p v + g cos(theta) cos(phi) + az,   with phi', theta', psi' from p, q, r

driven by the measured rates and specific forces less their biases, and compared with what was measured:

    airspeed = (1 + l) sqrt(u^2 + v^2 + w^2),  beta = b + (1 + l) asin(v/V),  alpha = b + (1 + l) atan2(w, u),
    phi, theta, psi,  and velocity over ground = R(phi, theta, psi) (u, v, w) + wind

Output error: biases, scales, wind and the initial state by Levenberg-Marquardt, residual variances estimated along.
Standard errors are corrected for coloured residuals and hold the noise of rates and accelerations, which the equations
carry on. Weak priors, of the size that an instrument's error may have, bound what a record does not identify; such a
parameter is reported as unestimated. Attitude is the reference: its bias is not distinguishable from the
accelerometers'. Gusts remain in the residuals. Flow angles are compared as the vane shows them. SI, rad; body axes.

Source: Klein and Morelli 2006, sections 10.1-10.3 (equations, output error), 6.3 (coloured residuals).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import matmul_toeplitz

from station.conventions import G0, ned_from_body
from station.model.inertial_path import air_velocity
from station.numerics.differentiation import white_variance
from station.numerics.regression import NotIdentifiable, autocorrelation
from station.numerics.second_order import shown
from station.rows import ParamEstimate, Status

Array = NDArray[np.float64]

INPUTS: Final = ("p", "q", "r", "ax", "ay", "az")
OUTPUTS: Final = ("airspeed", "beta", "alpha", "phi", "theta", "psi", "v_north", "v_east", "v_down")
STATES: Final = 6
VELOCITIES: Final = 3
"""States before the attitude."""
PRIORS: Final = {
    **dict.fromkeys(("p_bias", "q_bias", "r_bias"), 0.02),
    **dict.fromkeys(("ax_bias", "ay_bias", "az_bias"), 0.5),
    "airspeed_scale": 0.1,
    "beta_bias": 0.1,
    "beta_scale": 0.3,
    "alpha_bias": 0.1,
    "alpha_scale": 0.3,
    **dict.fromkeys(("wind_north", "wind_east", "wind_down"), 20.0),
}
"""Prior standard deviations, SI: of biases and wind about 0, of scales about 1."""
NEEDS: Final = {
    "airspeed_scale": "airspeed",
    "beta_bias": "beta",
    "beta_scale": "beta",
    "alpha_bias": "alpha",
    "alpha_scale": "alpha",
    "wind_north": "v_north",
    "wind_east": "v_east",
    "wind_down": "v_down",
}
IDENTIFIED: Final = 0.5
"""A parameter whose standard deviation exceeds this share of its prior's is not identified by the record."""
EXPLAINED: Final = 0.8
NOISY: Final = 3.0
"""Ratio of the residual to the signal's white noise, up to which the residual counts as noise."""
MIN_S: Final = 3.0
MAX_S: Final = 120.0
"""Open-loop integration of real gyros drifts too far beyond."""
ITERATIONS: Final = 200
SETTLED: Final = 0.1
"""Decrease of -2 log likelihood below which the iteration has converged."""
FLOOR: Final = {"airspeed": 0.02, "beta": 1e-4, "alpha": 1e-4, "phi": 1e-4, "theta": 1e-4, "psi": 1e-4}
"""Lower bounds of the residual standard deviations; 0.02 m/s for velocities."""


@dataclass(frozen=True, slots=True)
class Compatibility:
    """Instrument errors, and the motion reconstructed (n,) beside what was measured less those errors."""

    parameters: tuple[ParamEstimate, ...]
    reconstructed: Mapping[str, Array]
    corrected: Mapping[str, Array]
    residual_rms: Mapping[str, float]
    iterations: int
    seconds: float


@njit(cache=True)
def _rates(x: Array, u: Array, bias: Array, dx: Array) -> None:
    p, q, r = u[0] - bias[0], u[1] - bias[1], u[2] - bias[2]
    sph, cph = math.sin(x[3]), math.cos(x[3])
    sth, cth = math.sin(x[4]), math.cos(x[4])
    dx[0] = r * x[1] - q * x[2] - G0 * sth + u[3] - bias[3]
    dx[1] = p * x[2] - r * x[0] + G0 * cth * sph + u[4] - bias[4]
    dx[2] = q * x[0] - p * x[1] + G0 * cth * cph + u[5] - bias[5]
    turn = q * sph + r * cph
    secant = 1.0 / max(cth, 0.05)
    dx[3] = p + sth * secant * turn
    dx[4] = q * cph - r * sph
    dx[5] = turn * secant


@njit(cache=True)
def _integrate(inputs: Array, bias: Array, start: Array, dt: float) -> Array:
    """States (n, 6) by classical Runge-Kutta, inputs (n, 6) linear between samples."""
    n = inputs.shape[0]
    out = np.empty((n, 6))
    x = start.copy()
    k1, k2, k3, k4 = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    out[0] = x
    for i in range(n - 1):
        middle = 0.5 * (inputs[i] + inputs[i + 1])
        _rates(x, inputs[i], bias, k1)
        _rates(x + 0.5 * dt * k1, middle, bias, k2)
        _rates(x + 0.5 * dt * k2, middle, bias, k3)
        _rates(x + dt * k3, inputs[i + 1], bias, k4)
        x = x + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        out[i + 1] = x
    return out


@njit(cache=True)
def _adjoint(x: Array, inputs: Array, direct: Array, dt: float) -> Array:
    """What noise of each input at each instant does to the score, (n, 6, parameters): by the states after it."""
    n, m = direct.shape[0], direct.shape[2]
    out = np.zeros((n, 6, m))
    later = np.zeros((6, m))
    a, b = np.empty((6, 6)), np.empty((6, 6))
    zero = np.zeros(6)
    up, down, moved = np.empty(6), np.empty(6), np.empty(6)
    for i in range(n - 1, 0, -1):
        later = later + direct[i]
        for j in range(6):
            size = 1e-2 if j < VELOCITIES else 1e-4
            moved[:] = x[i - 1]
            moved[j] += size
            _rates(moved, inputs[i - 1], zero, up)
            moved[j] -= 2.0 * size
            _rates(moved, inputs[i - 1], zero, down)
            a[:, j] = dt * (up - down) / (2.0 * size)
            moved[:] = inputs[i - 1]
            moved[j] += 1e-3
            _rates(x[i - 1], moved, zero, up)
            moved[j] -= 2e-3
            _rates(x[i - 1], moved, zero, down)
            b[:, j] = dt * (up - down) / 2e-3
            a[j, j] += 1.0
        out[i - 1] = b.T @ later
        later = a.T @ later
    return out


def through_vane(x: Array, vane: tuple[float, float] | None, dt: float) -> Array:
    """What a vane of natural frequency (Hz) and damping shows of the angle `x` (n,), settled on its first value."""
    return x if vane is None else shown(x, *vane, dt)


def compatibility(
    motion: Mapping[str, Array], alpha: Array, beta: Array | None, dt: float, vane: tuple[float, float] | None = None
) -> Compatibility:
    """Reconstruct the motion and estimate the instruments' errors.

    `motion`: signals (n,) at the CG on a uniform grid: q, ax, az, airspeed and theta without gaps; p, r, ay, phi, psi
    and the velocity over ground where there are any. `alpha`, `beta` (n,): measured, corrected to the CG (beta None
    without a vane), both as the vanes' own dynamics show them: `vane` is their frequency (Hz) and damping. Raises
    NotIdentifiable for a record that is too short, too long or has gaps.
    """
    return _Reconstruction(motion, alpha, beta, dt, vane).solve()


class _Reconstruction:
    def __init__(
        self, motion: Mapping[str, Array], alpha: Array, beta: Array | None, dt: float, vane: tuple[float, float] | None
    ) -> None:
        n = len(alpha)
        if not MIN_S <= n * dt <= MAX_S:
            raise NotIdentifiable(f"{n * dt:.1f} s of record: a reconstruction needs {MIN_S:g} to {MAX_S:g} s")

        def column(name: str) -> Array | None:
            found = {"alpha": alpha, "beta": beta}.get(name, motion.get(name))
            return found if found is not None and np.isfinite(found).all() else None

        lacking = [name for name in ("q", "ax", "az", "airspeed", "alpha", "theta") if column(name) is None]
        if lacking:
            raise NotIdentifiable(f"no {', '.join(lacking)} throughout")
        zero = np.zeros(n)
        driven = [column(name) for name in INPUTS]
        self._inputs = np.column_stack([zero if c is None else c for c in driven])
        measured = {name: column(name) for name in OUTPUTS}
        self._measured = {name: c for name, c in measured.items() if c is not None}
        for name in ("phi", "psi"):
            if name in self._measured:
                self._measured[name] = np.unwrap(self._measured[name])
        self._dt = dt
        self._vane = vane
        self._n = n
        has = [f"{name}_bias" for name, c in zip(INPUTS, driven, strict=True) if c is not None and np.any(c)]
        has += [name for name, of in NEEDS.items() if of in self._measured and np.any(self._measured[of])]
        if not {"v_north", "v_east"} <= set(self._measured):
            # Without ground speed a scale of the airspeed is one of the accelerometers too.
            has = [name for name in has if name != "airspeed_scale"]
        self.names = tuple(has)
        self._prior = np.array([PRIORS[name] for name in has])

    def _start(self) -> Array:
        """Biases 0, scales 1, wind from the mean difference of ground and air velocity, first state as measured."""
        m = self._measured
        first = round(0.2 / self._dt)

        def early(name: str) -> float:
            return float(np.mean(m[name][: first + 1])) if name in m else 0.0

        speed, a, b = early("airspeed"), early("alpha"), early("beta")
        state = [speed * math.cos(a) * math.cos(b), speed * math.sin(b), speed * math.sin(a) * math.cos(b)]
        state += [early("phi"), early("theta"), early("psi")]
        values = np.array([1.0 if name.endswith("scale") else 0.0 for name in self.names])
        zero = np.zeros(self._n)
        body = air_velocity(m["airspeed"], m["alpha"], m.get("beta", zero))
        attitude = np.column_stack([m.get("phi", zero), m["theta"], m.get("psi", zero)])
        earth = np.einsum("nij,nj->ni", ned_from_body(*attitude.T), body)
        for i, name in enumerate(("v_north", "v_east", "v_down")):
            wind = name.replace("v_", "wind_")
            if wind in self.names:
                values[self.names.index(wind)] = float(np.mean(m[name] - earth[:, i]))
        return np.concatenate([values, state])

    def _model(self, p: Array) -> dict[str, Array]:
        """What every output would have been measured as."""
        value = dict(zip(self.names, p.tolist(), strict=False))
        bias = np.array([value.get(f"{name}_bias", 0.0) for name in INPUTS])
        x = _integrate(self._inputs, bias, p[-STATES:], self._dt)
        return self._observed(x, value)

    def _observed(self, x: Array, value: Mapping[str, float]) -> dict[str, Array]:
        """What states (n, 6) would have been measured as."""
        motion = _outputs(x)
        vane = (self._vane, self._dt)
        ground = np.einsum("nij,nj->ni", ned_from_body(*x[:, 3:].T), x[:, :3])
        made = {
            "airspeed": value.get("airspeed_scale", 1.0) * motion["airspeed"],
            "beta": value.get("beta_bias", 0.0) + value.get("beta_scale", 1.0) * through_vane(motion["beta"], *vane),
            "alpha": value.get("alpha_bias", 0.0)
            + value.get("alpha_scale", 1.0) * through_vane(motion["alpha"], *vane),
            "phi": x[:, 3],
            "theta": x[:, 4],
            "psi": x[:, 5],
        }
        for i, axis in enumerate(("north", "east", "down")):
            made[f"v_{axis}"] = ground[:, i] + value.get(f"wind_{axis}", 0.0)
        return made

    def _residuals(self, p: Array) -> Array:
        """Measured less modelled, (outputs, n)."""
        made = self._model(p)
        return np.array([measured - made[name] for name, measured in self._measured.items()])

    def _jacobian(self, p: Array) -> Array:
        """Of the modelled outputs, (outputs, n, parameters), by central differences."""
        sizes = np.concatenate([1e-3 * self._prior, [1e-2] * 3, [1e-4] * 3])
        columns = []
        for i, size in enumerate(sizes):
            up, down = p.copy(), p.copy()
            up[i] += size
            down[i] -= size
            columns.append((self._residuals(down) - self._residuals(up)) / (2 * size))
        return np.moveaxis(np.array(columns), 0, 2)

    def _variances(self, residual: Array) -> Array:
        floor = np.array([FLOOR.get(name, 0.02) for name in self._measured])
        return np.asarray(np.maximum(np.mean(residual**2, axis=1), floor**2))

    def solve(self) -> Compatibility:
        """Levenberg-Marquardt steps, the residual variances renewed at each. Raises NotIdentifiable."""
        p = self._start()
        centre = np.array([1.0 if name.endswith("scale") else 0.0 for name in self.names])
        # A state that no output shows, the heading for one, keeps its initial value.
        tightness = np.concatenate([1 / self._prior**2, [1e-4] * 3, [0.1] * 3])
        centre = np.concatenate([centre, p[-STATES:]])
        residual = self._residuals(p)
        damping = 1e-3
        for iteration in range(1, ITERATIONS + 1):
            if not np.isfinite(residual).all():
                raise NotIdentifiable("the reconstruction diverges: rates or accelerations contradict the attitude")
            weight = 1 / self._variances(residual)
            jacobian = self._jacobian(p)
            information = np.einsum("kni,knj,k->ij", jacobian, jacobian, weight) + np.diag(tightness)
            score = np.einsum("kni,kn,k->i", jacobian, residual, weight) - tightness * (p - centre)
            cost = self._cost(p, residual, weight, tightness, centre)
            gain = 0.0
            for _ in range(10):
                trial = p + np.linalg.solve(information + damping * np.diag(np.diag(information)), score)
                remaining = self._residuals(trial)
                if np.isfinite(remaining).all():
                    gain = cost - self._cost(trial, remaining, weight, tightness, centre)
                if gain > 0:
                    p, residual = trial, remaining
                    damping /= 5
                    break
                damping *= 5
            if gain < SETTLED:
                return self._result(p, residual, tightness, iteration)
        raise NotIdentifiable("the reconstruction does not converge: the record is not one consistent motion")

    def _unexplained(self, residual: Array) -> dict[str, str]:
        """Parameters that gusts or noise bias, and why: those of air data that the motion explains poorly.

        Where it is noise alone the bias is still estimated; a flow angle's scale is not, for it would be fitted to
        motion that the noise of rates and accelerations made, which reduces it.
        """
        found = {}
        for (name, measured), remaining in zip(self._measured.items(), residual, strict=True):
            share = max(1 - float(np.mean(remaining**2)) / max(float(np.var(measured)), 1e-30), 0.0)
            if name not in ("airspeed", "beta", "alpha") or share >= EXPLAINED:
                continue
            if np.mean(remaining**2) <= NOISY**2 * white_variance(measured):
                if name != "airspeed":
                    found[f"{name}_scale"] = f"{name} hardly moves beyond its noise: the motion explains {share:.0%}"
                continue
            of = [parameter for parameter, needed in NEEDS.items() if needed == name]
            of += ["wind_down"] if name == "alpha" else []
            found |= dict.fromkeys(of, f"gusts: the motion explains {share:.0%} of {name}")
        return found

    def _input_noise(self, p: Array, weighted: Array) -> Array:
        """Covariance of the score due to the noise of rates and accelerations, which integration carries into all later
        outputs: one sweep backwards with the equations' derivatives (adjoint)."""
        value = dict(zip(self.names, p.tolist(), strict=False))
        bias = np.array([value.get(f"{name}_bias", 0.0) for name in INPUTS])
        x = _integrate(self._inputs, bias, p[-STATES:], self._dt)
        slopes = []
        for i, size in enumerate((1e-2, 1e-2, 1e-2, 1e-4, 1e-4, 1e-4)):
            offset = np.zeros(STATES)
            offset[i] = size
            up, down = self._observed(x + offset, value), self._observed(x - offset, value)
            slopes.append(np.array([(up[name] - down[name]) / (2 * size) for name in self._measured]))
        # (n, states, parameters): what a change of the state at one instant does to the score at that instant.
        direct = np.einsum("skn,knj->nsj", np.array(slopes), weighted)
        by_input = _adjoint(x, self._inputs - bias, direct, self._dt)
        variances = np.array([white_variance(self._inputs[:, j]) for j in range(len(INPUTS))])
        return np.asarray(np.einsum("nai,naj,a->ij", by_input, by_input, variances))

    def _cost(self, p: Array, residual: Array, weight: Array, tightness: Array, centre: Array) -> float:
        return float(np.sum(residual**2 * weight[:, None]) + np.sum(tightness * (p - centre) ** 2))

    def _result(self, p: Array, residual: Array, tightness: Array, iterations: int) -> Compatibility:
        weight = 1 / self._variances(residual)
        jacobian = self._jacobian(p)
        information = np.einsum("kni,knj,k->ij", jacobian, jacobian, weight) + np.diag(tightness)
        spread = np.diag(tightness)
        weighted = jacobian * weight[:, None, None]
        for k in range(len(weight)):
            spread = spread + weighted[k].T @ matmul_toeplitz(
                autocorrelation(residual[k]), weighted[k], check_finite=False
            )
        spread = spread + self._input_noise(p, weighted)
        inverse = np.linalg.inv(information)
        sd = np.sqrt(np.maximum(np.diag(inverse @ spread @ inverse), 0.0))
        unexplained = self._unexplained(residual)
        for name in ("alpha", "beta"):
            why, mean = unexplained.get(f"{name}_scale"), float(np.mean(self._measured.get(name, 0.0)))
            # A bias is confounded with a scale that is not identified: on a steady angle one passes for the other.
            if why and abs(mean) * PRIORS[f"{name}_scale"] > sd[self.names.index(f"{name}_bias")]:
                unexplained[f"{name}_bias"] = why
        found = []
        for name, value, error, prior in zip(self.names, p.tolist(), sd.tolist(), self._prior.tolist(), strict=False):
            status, why = Status.ESTIMATED, ""
            if error > IDENTIFIED * prior:
                status, why = (
                    Status.UNESTIMATED,
                    "not identifiable in this record: vary attitude, load factor and speed",
                )
            elif name in unexplained:
                status, why = Status.UNESTIMATED, unexplained[name]
            found.append(ParamEstimate(name, value, error, status, why))
        value_of = {e.name: e.value for e in found}
        made = self._model(p)
        true = {n: made[n] for n in self._measured}
        for name in ("airspeed", "beta", "alpha"):
            if name in true:
                true[name] = _undone(true[name], name, value_of)
        corrected = {n: _undone(c, n, value_of) for n, c in self._measured.items()}
        rms = {n: float(np.sqrt(np.mean(r**2))) for n, r in zip(self._measured, residual, strict=True)}
        return Compatibility(tuple(found), true, corrected, rms, iterations, self._n * self._dt)


def _outputs(x: Array) -> dict[str, Array]:
    u, v, w = x[:, 0], x[:, 1], x[:, 2]
    speed = np.maximum(np.sqrt(u * u + v * v + w * w), 1e-6)
    return {"airspeed": speed, "beta": np.arcsin(np.clip(v / speed, -1, 1)), "alpha": np.arctan2(w, u)}


def _undone(measured: Array, name: str, values: Mapping[str, float]) -> Array:
    """A measured quantity without its instrument's bias and scale."""
    return np.asarray((measured - values.get(f"{name}_bias", 0.0)) / values.get(f"{name}_scale", 1.0))
