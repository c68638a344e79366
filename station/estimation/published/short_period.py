"""Output error of the short period: alpha and q integrated, everything else as measured (method oe).

    alphadot = q - tan(beta)(p cos alpha + r sin alpha)
               + [-ax' sin alpha + az' cos alpha + g (cos phi cos theta cos alpha + sin theta sin alpha)] / (V cos beta)
    qdot     = [qbar S c Cm + (Izz - Ixx) p r - Ixz (p^2 - r^2)] / Iyy

ax' = (qbar S CX + T)/m with CX measured, az' = qbar S CZ/m with CZ, or CL, and Cm linear in alpha, q c/2V and elevator
about their first samples. Outputs alpha, q and az with a bias. Third-order Adams-Bashforth, started by two midpoint
steps. SI, rad. Assumes a calm record. Source: Klein and Morelli 2006, sections 3.8 and 6.1.3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import G0
from station.estimation.published.output_error import CONVERGED, Convergence, OutputFit, gauss_newton
from station.model.coefficients import Airframe, Coefficients, pitching_moment, signal
from station.numerics.regression import NotIdentifiable, smoothed_start

Array = NDArray[np.float64]

PARAMETERS: Final = (
    *("force_0", "force_alpha", "force_q", "force_de", "Cm_0", "Cm_alpha", "Cm_q", "Cm_de"),
    *("az_bias", "alpha_start", "q_start"),
)
"""`force` is CZ or CL; az_bias in m/s2; the last two: first state less its measured value."""
STARTING_STEPS: Final = 2
"""Midpoint steps that start the third-order Adams-Bashforth integration."""


@dataclass(frozen=True, slots=True)
class ShortPeriod:
    """A record and what is known of it, ready to be simulated."""

    inputs: Array
    """(n, 15): see `_rates`."""
    measured: Array
    """(n, 3): alpha, q, az."""
    start: Array
    """alpha and q at the first sample."""
    reference: tuple[float, float]
    """alpha and elevator that the coefficients are expanded about."""
    dt: float
    wind_axes: bool
    gravity: float
    """m/s2"""
    measured_rate: bool
    """q c/2V in the coefficients from the measured q, as in SIDPAC's demonstration, not from the integrated one."""

    @classmethod
    def of(
        cls,
        motion: Mapping[str, Array],
        alpha: Array,
        c: Coefficients,
        airframe: Airframe,
        dt: float,
        *,
        wind_axes: bool,
        gravity: float = G0,
        measured_rate: bool = False,
    ) -> ShortPeriod:
        """From signals (at the CG) and coefficients of the same record. Raises NotIdentifiable for missing samples."""
        n = len(alpha)
        if not np.all(np.isfinite(airframe.iyy)):
            raise NotIdentifiable("the aircraft profile gives no iyy")
        a = airframe
        v, qbar, p, r = motion["airspeed"], motion["dynamic_pressure"], signal(motion, "p", n), signal(motion, "r", n)
        thrust = signal(motion, "thrust", n)
        without_qdot = pitching_moment((a.iyy, a.ixz, a.gyroscopic), 0.0, p, r) - thrust * a.thrust_pitch_arm
        inputs = np.column_stack(
            [
                motion["elevator"],
                v,
                signal(motion, "beta_vane", n),
                p,
                r,
                signal(motion, "phi", n),
                motion["theta"],
                qbar * a.area / a.mass,
                c.CX,
                thrust * math.cos(a.thrust_angle) / a.mass,
                qbar * a.area * a.chord / a.iyy,
                -without_qdot / a.iyy,
                c.qhat,
                a.chord / (2 * (v if a.rate_speed is None else np.full(n, a.rate_speed))),
                -thrust * math.sin(a.thrust_angle) / a.mass,
            ]
        )
        measured = np.column_stack([alpha, motion["q"], motion["az"]])
        if not (np.isfinite(inputs).all() and np.isfinite(measured).all()):
            raise NotIdentifiable("missing or non-finite samples")
        return cls(
            inputs=np.ascontiguousarray(inputs),
            measured=measured,
            start=smoothed_start(measured[:, :2], 2.0, dt),
            reference=(float(alpha[0]), float(motion["elevator"][0])),
            dt=dt,
            wind_axes=wind_axes,
            gravity=gravity,
            measured_rate=measured_rate,
        )

    def simulate(self, parameters: Array) -> Array:
        """Outputs (n, 3) for all PARAMETERS."""
        return _simulate(
            np.ascontiguousarray(parameters, dtype=np.float64),
            self.inputs,
            self.start,
            np.array(self.reference),
            self.dt,
            self.wind_axes,
            self.gravity,
            self.measured_rate,
        )

    def estimate(
        self,
        start: Mapping[str, float],
        free: tuple[str, ...],
        convergence: Convergence = CONVERGED,
        *,
        symmetric_correlation: bool = False,
    ) -> OutputFit:
        """Output-error estimates of `free`, the others held at `start` (0 where it names none).

        Raises NotIdentifiable.
        """
        base = np.array([start.get(name, 0.0) for name in PARAMETERS])
        index = np.array([PARAMETERS.index(name) for name in free])

        def simulate(values: Array) -> Array:
            p = base.copy()
            p[index] = values
            return self.simulate(p)

        return gauss_newton(
            simulate, self.measured, base[index], convergence, symmetric_correlation=symmetric_correlation
        )


@njit(cache=True)
def _force(alpha: float, q: float, u: Array, p: Array, reference: Array, wind: bool, measured_rate: bool) -> float:
    """CZ."""
    qhat = u[12] if measured_rate else q * u[13]
    force = p[0] + p[1] * (alpha - reference[0]) + p[2] * qhat + p[3] * (u[0] - reference[1])
    if wind:
        return float((u[8] * np.sin(alpha) - force) / np.cos(alpha))
    return float(force)


@njit(cache=True)
def _rates(
    alpha: float, q: float, u: Array, p: Array, reference: Array, wind: bool, gravity: float, measured_rate: bool
) -> tuple[float, float]:
    """alphadot, qdot. u: elevator, V, beta, p, r, phi, theta, qbar S/m, CX, specific thrust along x, qbar S c/Iyy, qdot
    by gyroscopic moments and thrust, measured q c/2V, c/2V, specific thrust along z."""
    qhat = u[12] if measured_rate else q * u[13]
    cz = _force(alpha, q, u, p, reference, wind, measured_rate)
    cm = p[4] + p[5] * (alpha - reference[0]) + p[6] * qhat + p[7] * (u[0] - reference[1])
    sin, cos = np.sin(alpha), np.cos(alpha)
    along, down = u[7] * u[8] + u[9], u[7] * cz + u[14]
    weight = gravity * (np.cos(u[5]) * np.cos(u[6]) * cos + np.sin(u[6]) * sin)
    turn = np.tan(u[2]) * (u[3] * cos + u[4] * sin)
    return q - turn + (weight - along * sin + down * cos) / (u[1] * np.cos(u[2])), u[10] * cm + u[11]


@njit(cache=True)
def _simulate(
    p: Array, u: Array, start: Array, reference: Array, dt: float, wind: bool, gravity: float, measured_rate: bool
) -> Array:
    n = len(u)
    y = np.empty((n, 3))
    alpha, q = start[0] + p[9], start[1] + p[10]
    a1, a2, q1, q2 = 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        y[k, 0], y[k, 1] = alpha, q
        y[k, 2] = u[k, 7] * _force(alpha, q, u[k], p, reference, wind, measured_rate) + u[k, 14] + p[8]
        if k + 1 == n:
            break
        a0, q0 = _rates(alpha, q, u[k], p, reference, wind, gravity, measured_rate)
        if k < STARTING_STEPS:
            middle = 0.5 * (u[k] + u[k + 1])
            ah, qh = alpha + 0.5 * dt * a0, q + 0.5 * dt * q0
            am, qm = _rates(ah, qh, middle, p, reference, wind, gravity, measured_rate)
            alpha += dt * am
            q += dt * qm
        else:
            alpha += dt / 12 * (23 * a0 - 16 * a1 + 5 * a2)
            q += dt / 12 * (23 * q0 - 16 * q1 + 5 * q2)
        a1, a2, q1, q2 = a0, a1, q0, q1
    return y
