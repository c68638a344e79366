"""Nondimensional coefficients and rates from measured motion: the left and right sides of equation error.

SI and radians; body axes x forward, y right, z down; moments about the centre of gravity.
Source: Klein and Morelli 2006, Aircraft System Identification, chapter 3 (equations 3.37 and 5.99-5.101).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.profile import Aircraft

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Airframe:
    """Reference lengths and mass properties, SI. Inertias may vary with time: arrays of the record's length.

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
        )


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
    dynamic_pressure, q, ax, az; p, r and ay are 0 where missing, thrust too (then CX and CL hold it). pdot, qdot and
    rdot are differentiated from the rates where missing. `alpha` is the angle of attack at the centre of gravity.
    Raises KeyError for a missing signal that cannot be done without.
    """
    n = len(alpha)
    v, qbar = motion["airspeed"], motion["dynamic_pressure"]
    p, q, r = signal(motion, "p", n), motion["q"], signal(motion, "r", n)
    pdot, qdot, rdot = (acceleration(motion, name, w, dt) for name, w in (("pdot", p), ("qdot", q), ("rdot", r)))
    a = airframe
    with np.errstate(divide="ignore", invalid="ignore"):
        force = 1.0 / (qbar * a.area)
        cx = (a.mass * motion["ax"] - signal(motion, "thrust", n)) * force
        cy = a.mass * signal(motion, "ay", n) * force
        cz = a.mass * motion["az"] * force
        cl = (a.ixx * pdot - a.ixz * (p * q + rdot) + (a.izz - a.iyy) * q * r) * force / a.span
        cm = (a.iyy * qdot + a.ixz * (p * p - r * r) + gyroscopic(a) * p * r) * force / a.chord
        cn = (a.izz * rdot - a.ixz * (pdot - q * r) + (a.iyy - a.ixx) * p * q) * force / a.span
        half = 0.5 / v
        lift, drag = cx * np.sin(alpha) - cz * np.cos(alpha), -cx * np.cos(alpha) - cz * np.sin(alpha)
        phat, qhat, rhat = p * a.span * half, q * a.chord * half, r * a.span * half
    return Coefficients(
        CX=cx,
        CY=cy,
        CZ=cz,
        CL=lift,
        CD=drag,
        Cl=cl,
        Cm=cm,
        Cn=cn,
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
    return differentiate(rate, dt) if column is None or not np.isfinite(column).any() else column


def gyroscopic(airframe: Airframe) -> float | Array:
    """Ixx - Izz; 0 if either is unknown: with wings level the term is far below the noise."""
    difference = airframe.ixx - airframe.izz
    return difference if np.all(np.isfinite(difference)) else 0.0


def differentiate(x: Array, dt: float) -> Array:
    """Slope of the least-squares parabola through five samples, (n,); at the ends that of the first or last five.

    Source: Klein and Morelli 2006, section 11.4. Raises ValueError below five samples.
    """
    if len(x) < 5:
        raise ValueError("a derivative needs at least 5 samples")
    inner = np.correlate(x, np.array([-2.0, -1.0, 0.0, 1.0, 2.0]), "valid") / (10 * dt)
    # The same parabola's slope two and one steps from its middle: 2 a t + b with a from the second differences.
    curve = np.array([2.0, -1.0, -2.0, -1.0, 2.0]) / (7 * dt)
    head, tail = x[:5] @ curve, x[-5:] @ curve
    first = [inner[0] - 2 * head, inner[0] - head]
    last = [inner[-1] + tail, inner[-1] + 2 * tail]
    return np.concatenate([first, inner, last])


def at_centre_of_gravity(
    motion: Mapping[str, Array], position: tuple[float, float, float], dt: float
) -> dict[str, Array]:
    """The motion with ax, ay, az moved from an accelerometer at `position` (m, body axes from the CG) to the CG.

    a_cg = a - wdot x r - w x (w x r); Klein and Morelli 2006, equation 10.6. Missing rates count as 0.
    """
    moved = dict(motion)
    if position == (0.0, 0.0, 0.0):
        return moved
    w = np.column_stack([signal(motion, name, len(motion["ax"])) for name in "pqr"])
    wdot = np.column_stack([acceleration(motion, f"{name}dot", w[:, i], dt) for i, name in enumerate("pqr")])
    arm = np.array(position)
    extra = np.cross(wdot, arm) + np.cross(w, np.cross(w, arm))
    for i, name in enumerate(("ax", "ay", "az")):
        if name in motion:
            moved[name] = motion[name] - extra[:, i]
    return moved
