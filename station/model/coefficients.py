"""Nondimensional coefficients and rates from measured motion: the left and right sides of equation error.

The formulas take numbers in compiled code and arrays elsewhere: live estimation, identification and diagnosis share
them. The thrust T acts in the plane of symmetry, raised from the body's x axis by the thrust angle sigma, and pitches
the nose up by its arm l_T:

    m ax = qbar S CX + T cos sigma       m az = qbar S CZ - T sin sigma       pitching moment = qbar S c Cm + T l_T

SI and radians; body axes x forward, y right, z down; moments about the centre of gravity.
Sources: Klein and Morelli 2006, Aircraft System Identification, chapter 3 (equations 3.37 and 5.99-5.101) and equation
10.6 (lever arm); Jategaonkar 2015, section 5.11 (thrust angle and arm).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from station.numerics.differentiation import derivative, differentiate
from station.profile import Aircraft

Array = NDArray[np.float64]
SMOOTHED_S: Final = 0.025
"""Step of a record up to which a rate is differentiated by SIDPAC's rule, which then loses up to 1.4 % at 1 Hz; of
20 Hz it would lose 5 %, of 10 Hz 20 %."""
Quantity = Any
"""A number, or an array of the record's length."""
Vector = tuple[Quantity, ...]
"""Components along the body's x, y and z axes."""


@register_jitable
def specific_force_at_cg(felt: Vector, rate: Vector, acceleration: Vector, arm: Vector) -> Vector:
    """What an accelerometer at `arm` (m from the CG) feels, moved to the CG: a - wdot x r - w x (w x r), m/s2.

    `rate`: p, q, r (rad/s); `acceleration`: their derivatives (rad/s2). Klein and Morelli 2006, equation 10.6.
    """
    ax, ay, az = felt
    p, q, r = rate
    pdot, qdot, rdot = acceleration
    x, y, z = arm
    wr = p * x + q * y + r * z
    ww = p * p + q * q + r * r
    return (
        ax - (qdot * z - rdot * y) - (p * wr - ww * x),
        ay - (rdot * x - pdot * z) - (q * wr - ww * y),
        az - (pdot * y - qdot * x) - (r * wr - ww * z),
    )


@register_jitable
def force_coefficients(
    inertial: tuple[Quantity, Quantity], thrust: tuple[Quantity, Quantity], force: Quantity
) -> tuple[Quantity, Quantity]:
    """CX and CZ of the air alone. `inertial`: m ax and m az at the CG (N); `thrust`: T and its angle (N, rad); `force`:
    qbar S (N)."""
    push, angle = thrust
    return (inertial[0] - push * math.cos(angle)) / force, (inertial[1] + push * math.sin(angle)) / force


@register_jitable
def lift_and_drag(cx: Quantity, cz: Quantity, sin: Quantity, cos: Quantity) -> tuple[Quantity, Quantity]:
    """CL and CD from CX and CZ; sine and cosine of the angle of attack."""
    return cx * sin - cz * cos, -cx * cos - cz * sin


@register_jitable
def pitching_moment(inertia: tuple[Quantity, Quantity, Quantity], qdot: Quantity, p: Quantity, r: Quantity) -> Quantity:
    """Of air and thrust together, nose up, N m. `inertia`: Iyy, Ixz and Ixx - Izz (kg m2), the last 0 if unknown."""
    return inertia[0] * qdot + inertia[1] * (p * p - r * r) + inertia[2] * p * r


@register_jitable
def roll_and_yaw_moment(
    inertia: tuple[Quantity, Quantity, Quantity, Quantity], rate: Vector, pdot: Quantity, rdot: Quantity
) -> tuple[Quantity, Quantity]:
    """Right wing down and nose right, N m. `inertia`: Ixx, Iyy, Izz, Ixz (kg m2); `rate`: p, q, r."""
    ixx, iyy, izz, ixz = inertia
    p, q, r = rate
    roll = ixx * pdot - ixz * (p * q + rdot) + (izz - iyy) * q * r
    yaw = izz * rdot - ixz * (pdot - q * r) + (iyy - ixx) * p * q
    return roll, yaw


@register_jitable
def thrust_by_drag_polar(
    inertial: tuple[Quantity, Quantity],
    force: Quantity,
    polar: tuple[Quantity, Quantity],
    angle: Quantity,
    sin: Quantity,
    cos: Quantity,
) -> Quantity:
    """The thrust that is not recorded, N: what `inertial`, m ax and m az, shows beyond the drag polar.

    `force`: qbar S; `polar`: CD at zero lift and dCD/dCL2; `angle`: of the thrust; sine and cosine of the angle of
    attack. In the polar -CZ stands for CL.
    """
    cz = inertial[1] / force
    drag = polar[0] + polar[1] * cz * cz
    surplus = inertial[0] + force * (drag * cos + cz * sin)
    # m az holds the thrust too: CZ of the air alone is (m az + T sin(angle)) / force.
    return surplus / (math.cos(angle) - math.sin(angle) * sin)


@dataclass(frozen=True, slots=True)
class Airframe:
    """Reference lengths, mass properties and thrust line, SI. Inertias may vary with time: arrays of the record's
    length.

    An inertia that is not known is NaN; the moment coefficients that need it are then NaN too.
    """

    area: float
    span: float
    chord: float
    mass: float | Array
    ixx: float | Array
    iyy: float | Array
    izz: float | Array
    ixz: float | Array = 0.0
    thrust_angle: float = 0.0
    thrust_pitch_arm: float = 0.0
    """Nose-up moment per newton of thrust, m."""
    rate_speed: float | None = None
    """Rates are normalised with this speed, m/s; None: with the airspeed of the instant."""

    @classmethod
    def of(cls, aircraft: Aircraft, mass: Array | None = None) -> Airframe:
        """The profile's airframe; `mass` (kg, one a sample) replaces the profile's where given and finite."""
        g, i = aircraft.geometry, aircraft.inertia
        nan = float("nan")
        return cls(
            area=g.wing_area,
            span=g.span,
            chord=g.chord,
            mass=i.mass if mass is None else np.where(np.isfinite(mass), mass, i.mass),
            ixx=nan if i.ixx is None else i.ixx,
            iyy=nan if i.iyy is None else i.iyy,
            izz=nan if i.izz is None else i.izz,
            ixz=i.ixz,
            thrust_angle=aircraft.thrust_angle,
            thrust_pitch_arm=aircraft.thrust_pitch_arm,
            rate_speed=aircraft.reference_speed if aircraft.rate_reference == "fixed" else None,
        )

    @property
    def gyroscopic(self) -> float | Array:
        """Ixx - Izz; 0 if either is unknown: with wings level the term is far below the noise."""
        difference = self.ixx - self.izz
        return difference if np.all(np.isfinite(difference)) else 0.0


@dataclass(frozen=True, slots=True)
class Coefficients:
    """Body axes CX CY CZ, wind axes CL CD, moments Cl Cm Cn and rates p b/2V, q c/2V, r b/2V; each (n,)."""

    CX: Array
    CY: Array
    CZ: Array
    CL: Array
    CD: Array
    Cl: Array
    Cm: Array
    Cn: Array
    phat: Array
    qhat: Array
    rhat: Array

    def named(self, name: str) -> Array:
        """The coefficient of that name. Raises AttributeError for another."""
        found: Array = getattr(self, name)
        return found


def coefficients(motion: Mapping[str, Array], airframe: Airframe, alpha: Array, dt: float) -> Coefficients:
    """Coefficients of a record on a uniform grid.

    `motion` holds signals of conventions.SIGNALS, (n,) each, accelerations at the centre of gravity: airspeed,
    dynamic_pressure, q, ax, az; p, r and ay are 0 where missing, thrust too (CX, CL and Cm then hold it). pdot, qdot
    and rdot are differentiated from the rates where missing. `alpha` is the angle of attack at the centre of gravity.
    Raises KeyError for a missing signal that cannot be done without.
    """
    n = len(alpha)
    v, qbar = motion["airspeed"], motion["dynamic_pressure"]
    p, q, r = signal(motion, "p", n), motion["q"], signal(motion, "r", n)
    pdot, qdot, rdot = (acceleration(motion, name, w, dt) for name, w in (("pdot", p), ("qdot", q), ("rdot", r)))
    a = airframe
    thrust = signal(motion, "thrust", n)
    with np.errstate(divide="ignore", invalid="ignore"):
        force = qbar * a.area
        cx, cz = force_coefficients((a.mass * motion["ax"], a.mass * motion["az"]), (thrust, a.thrust_angle), force)
        cy = a.mass * signal(motion, "ay", n) / force
        lift, drag = lift_and_drag(cx, cz, np.sin(alpha), np.cos(alpha))
        roll, yaw = roll_and_yaw_moment((a.ixx, a.iyy, a.izz, a.ixz), (p, q, r), pdot, rdot)
        pitch = pitching_moment((a.iyy, a.ixz, a.gyroscopic), qdot, p, r) - thrust * a.thrust_pitch_arm
        half = 0.5 / (v if a.rate_speed is None else np.full(n, a.rate_speed))
        phat, qhat, rhat = p * a.span * half, q * a.chord * half, r * a.span * half
    return Coefficients(
        CX=cx,
        CY=cy,
        CZ=cz,
        CL=lift,
        CD=drag,
        Cl=roll / (force * a.span),
        Cm=pitch / (force * a.chord),
        Cn=yaw / (force * a.span),
        phat=phat,
        qhat=qhat,
        rhat=rhat,
    )


def signal(motion: Mapping[str, Array], name: str, n: int) -> Array:
    """A signal's column, (n,); zeros where the record has nothing of it."""
    column = motion.get(name)
    return np.zeros(n) if column is None or not np.isfinite(column).any() else column


def acceleration(motion: Mapping[str, Array], name: str, rate: Array, dt: float) -> Array:
    """pdot, qdot or rdot as measured; differentiated from its rate where the record has nothing of it."""
    column = motion.get(name)
    if column is not None and np.isfinite(column).any():
        return column
    return differentiate(rate, dt) if dt <= SMOOTHED_S else derivative(rate, dt)


def at_centre_of_gravity(
    motion: Mapping[str, Array], position: tuple[float, float, float], dt: float
) -> dict[str, Array]:
    """The motion with ax, ay, az moved from an accelerometer at `position` (m, body axes from the CG) to the CG; rates
    that are missing count as 0."""
    moved = dict(motion)
    if position == (0.0, 0.0, 0.0):
        return moved
    n = len(motion["ax"])
    rate = tuple(signal(motion, name, n) for name in "pqr")
    turning = tuple(acceleration(motion, f"{name}dot", w, dt) for name, w in zip("pqr", rate, strict=True))
    felt = tuple(signal(motion, name, n) for name in ("ax", "ay", "az"))
    at_cg = specific_force_at_cg(felt, rate, turning, position)
    moved |= {name: x for name, x in zip(("ax", "ay", "az"), at_cg, strict=True) if name in motion}
    return moved
