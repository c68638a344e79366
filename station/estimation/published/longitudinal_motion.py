"""The estimators' nonlinear longitudinal model: states V, alpha, theta, q; any coefficient free.

    Vdot     = -(S/m) qbar CD + (F/m) cos(alpha + sigma) + g sin(alpha - theta)
    alphadot = -(S/m)(qbar/V) CL - F/(m V) sin(alpha + sigma) + q + (g/V) cos(alpha - theta)
    thetadot = q
    qdot     = (S c/Iy) qbar Cm + (l_T/Iy) F
    ax       = (S/m) qbar (CL sin alpha - CD cos alpha) + (F/m) cos sigma
    az       = -(S/m) qbar (CL cos alpha + CD sin alpha) - (F/m) sin sigma
    qbar     = rho V^2/2

with CD = CD_0 + CD_V V/V0 + CD_alpha alpha + CD_alpha2 alpha^2, CL and Cm = c_0 + c_V V/V0 + c_alpha alpha + c_q qhat
+ c_de de, qhat = q l/V, where V is the instantaneous or, for HFB-320, the reference speed. Wings level, no sideslip,
air at rest. SI, rad. Source: Jategaonkar 2015, Flight Vehicle System Identification, section 5.11 (HFB-320).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import G0
from station.profile import Aircraft

Array = NDArray[np.float64]

STATES: Final = ("airspeed", "alpha", "theta", "q")
OUTPUTS: Final = ("airspeed", "alpha", "theta", "q", "qdot", "ax", "az")
INPUTS: Final = ("elevator", "thrust", "density")
PARAMETERS: Final = (
    *("CD_0", "CD_V", "CD_alpha", "CD_alpha2"),
    *("CL_0", "CL_V", "CL_alpha", "CL_q", "CL_de"),
    *("Cm_0", "Cm_V", "Cm_alpha", "Cm_q", "Cm_de"),
)
NX: Final = len(STATES)
NY: Final = len(OUTPUTS)


@dataclass(frozen=True, slots=True)
class Body:
    """The known constants of the model, SI."""

    area_by_mass: float
    """S/m, m2/kg"""
    area_chord_by_inertia: float
    """S c/Iyy, 1/kg m"""
    mass: float
    reference_speed: float
    """V0 in c_V V/V0, m/s"""
    rate_length: float
    """l in q l/V, m: half the chord"""
    thrust_arm_by_inertia: float = 0.0
    """l_T/Iyy, 1/kg m; positive pitches up"""
    thrust_angle: float = 0.0
    fixed_rate_speed: bool = False
    """Rates normalised with V0 instead of V."""
    gravity: float = G0

    @classmethod
    def of(cls, aircraft: Aircraft, speed: float, mass: float | None = None) -> Body:
        """From a profile; `speed` (m/s) is the reference where the profile has none. Raises ValueError without Iyy."""
        inertia, geometry = aircraft.inertia, aircraft.geometry
        if inertia.iyy is None:
            raise ValueError("the aircraft profile gives no iyy")
        m = inertia.mass if mass is None else mass
        return cls(
            area_by_mass=geometry.wing_area / m,
            area_chord_by_inertia=geometry.wing_area * geometry.chord / inertia.iyy,
            mass=m,
            reference_speed=speed if aircraft.reference_speed is None else aircraft.reference_speed,
            rate_length=geometry.chord / 2,
            thrust_arm_by_inertia=aircraft.thrust_pitch_arm / inertia.iyy,
            thrust_angle=aircraft.thrust_angle,
            fixed_rate_speed=aircraft.rate_reference == "fixed",
        )

    def constants(self) -> Array:
        """The argument `c` of the compiled functions."""
        return np.array(
            [
                self.gravity,
                self.area_by_mass,
                self.area_chord_by_inertia,
                self.mass,
                self.reference_speed,
                self.rate_length,
                self.thrust_arm_by_inertia,
                self.thrust_angle,
                float(self.fixed_rate_speed),
            ]
        )


@njit(cache=True)
def coefficients(v: float, alpha: float, q: float, de: float, p: Array, c: Array) -> tuple[float, float, float]:
    """CD, CL, Cm."""
    speed = v / c[4]
    qhat = q * c[5] / c[4] if c[8] != 0.0 else q * c[5] / v
    cd = p[0] + p[1] * speed + (p[2] + p[3] * alpha) * alpha
    cl = p[4] + p[5] * speed + p[6] * alpha + p[7] * qhat + p[8] * de
    cm = p[9] + p[10] * speed + p[11] * alpha + p[12] * qhat + p[13] * de
    return cd, cl, cm


@njit(cache=True)
def rates(x: Array, u: Array, p: Array, c: Array, out: Array) -> None:
    """xdot into out (4,)."""
    v, alpha, theta, q = x[0], x[1], x[2], x[3]
    thrust = u[1]
    cd, cl, cm = coefficients(v, alpha, q, u[0], p, c)
    qbar = 0.5 * u[2] * v * v
    specific = thrust / c[3]
    out[0] = -c[1] * qbar * cd + specific * np.cos(alpha + c[7]) + c[0] * np.sin(alpha - theta)
    out[1] = -c[1] * qbar / v * cl - specific / v * np.sin(alpha + c[7]) + q + c[0] / v * np.cos(alpha - theta)
    out[2] = q
    out[3] = c[2] * qbar * cm + c[6] * thrust


@njit(cache=True)
def outputs(x: Array, u: Array, p: Array, c: Array, out: Array) -> None:
    """y into out (7,)."""
    v, alpha = x[0], x[1]
    cd, cl, cm = coefficients(v, alpha, x[3], u[0], p, c)
    qbar = 0.5 * u[2] * v * v
    specific = u[1] / c[3]
    sin, cos = np.sin(alpha), np.cos(alpha)
    out[0], out[1], out[2], out[3] = v, alpha, x[2], x[3]
    out[4] = c[2] * qbar * cm + c[6] * u[1]
    out[5] = c[1] * qbar * (cl * sin - cd * cos) + specific * np.cos(c[7])
    out[6] = -c[1] * qbar * (cl * cos + cd * sin) - specific * np.sin(c[7])


@njit(cache=True)
def advance(x: Array, before: Array, after: Array, dt: float, p: Array, c: Array, work: Array) -> None:
    """One fourth-order Runge-Kutta step of x in place; the input goes straight from `before` to `after`.

    `work` (6, 4) is scratch; the mid-step input is their mean.
    """
    middle = 0.5 * (before + after)
    k1, k2, k3, k4, y = work[0], work[1], work[2], work[3], work[4]
    rates(x, before, p, c, k1)
    for i in range(NX):
        y[i] = x[i] + 0.5 * dt * k1[i]
    rates(y, middle, p, c, k2)
    for i in range(NX):
        y[i] = x[i] + 0.5 * dt * k2[i]
    rates(y, middle, p, c, k3)
    for i in range(NX):
        y[i] = x[i] + dt * k3[i]
    rates(y, after, p, c, k4)
    for i in range(NX):
        x[i] = x[i] + dt / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i])
