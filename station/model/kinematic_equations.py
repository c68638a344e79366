"""The kinematic equations as sums of terms, each of one instrument: what instruments say of each other.

    theta'      = q cos(phi) - r sin(phi)
    phi'        = p + tan(theta) (q sin(phi) + r cos(phi))
    psi'        = (q sin(phi) + r cos(phi)) / cos(theta)
    (V alpha)'  = q u - p v + g cos(theta) cos(phi) + az     V alpha: at the CG, of the vane's angle and rate term
    (V beta)'   = p w - r u + g cos(theta) sin(phi) + ay
    V'          = ax cos(alpha) cos(beta) + ay sin(beta) + az sin(alpha) cos(beta) - g sin(gamma)
    v_north', v_east', v_down' = R(phi, theta, psi) (ax, ay, az) + (0, 0, g),   altitude'' = -v_down'

Every row is linear in one instrument's readings at a time, so a lag, a scale and a zero of each act on its own terms.
Its factors (speed, direction cosines) are those of the motion: what is read a lag late goes with the factor of a lag
before. The signal that heads a row is the one that no rate or acceleration is needed for. SI, rad; body axes x forward,
z down.

The speed is held against forces along the path, not along the body: u' has w (q - alpha'), small by the difference of
two large motions, which a vane's lag and rate term upset.

Source: Klein and Morelli 2006, equations 3.29-3.34 and section 10.1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import G0, ned_from_body

Array = NDArray[np.float64]

ANGLES: Final = ("theta", "phi", "psi")
FLOW: Final = ("alpha_vane", "beta_vane")
IMU: Final = ("p", "q", "r", "ax", "ay", "az")
GROUND: Final = ("v_north", "v_east", "v_down")
MISALIGNED: Final = ("incidence", "sideslip")
"""Angles, rad, by which the vanes' mean flow is out of line with the accelerometers: each an instrument that reads
nothing and has a zero."""
AGAINST: Final[Mapping[str, tuple[str, ...]]] = {
    "theta": (),
    "phi": ("beta_vane", "ay"),
    "psi": ("r", "q"),
    "alpha_vane": ("q", "az"),
    "beta_vane": ("r", "ay"),
    "airspeed": ("ax", "theta"),
    "v_north": ("ax", "ay", "psi"),
    "v_east": ("ax", "ay", "psi"),
    "v_down": ("az", "theta"),
    "altitude": ("az", "theta"),
    "q": ("theta",),
    "p": ("phi",),
    "r": ("psi", "beta_vane", "phi"),
    "ax": ("airspeed", "theta"),
    "ay": ("beta_vane", "r"),
    "az": ("alpha_vane", "q"),
}
"""What an instrument's signal is held against; the attitude is the reference."""


@dataclass(frozen=True, slots=True)
class Term:
    """d^order/dt^order of factor times the readings (n,) of an instrument, in one row."""

    row: str
    instrument: str
    readings: Array
    factor: Array
    order: int
    slope: float
    """Mean derivative by the reading: what its noise is multiplied by."""
    late: float = 0.0
    """Samples by which the readings are known to come after the motion."""

    @property
    def factor_read(self) -> Array:
        """The factor (n,) of the motion that each reading shows."""
        ticks = np.arange(len(self.factor))
        return np.interp(ticks - self.late, ticks, self.factor) if self.late else self.factor


@dataclass(slots=True)
class Equations:
    """`heads` of the rows, in order, and the terms, which sum to zero in each."""

    heads: list[str] = field(default_factory=list)
    terms: list[Term] = field(default_factory=list)

    def add(self, row: str, instrument: str, readings: Array, factor: Array, order: int = 0) -> None:
        self.terms.append(Term(row, instrument, readings, factor, order, float(np.mean(factor))))


def equations(
    motion: Mapping[str, Array],
    arm: tuple[float, float, float],
    upwash: float = 1.0,
    mended: Mapping[str, Array] | None = None,
    late: Mapping[str, float] | None = None,
) -> Equations:
    """Of the signals (n,) that the record has, forces at the CG; `arm` (m): the vanes' place from it; `upwash`: scale
    that the profile gives the vane of angle of attack, which the other rows' velocities are free of. `mended`: flow
    angles, rates and roll angle as the instruments would show them without errors, for the factors, where that is
    known; `late`: by how many samples the instruments are late, as far as that is known."""
    made = Equations()
    mended = mended or {}
    true = {**motion, **mended}
    _attitude(made, motion, true)
    if "alpha_vane" in motion and "alpha_vane" not in mended:
        true["alpha_vane"] = motion["alpha_vane"] / upwash
    _air(made, motion, true, arm)
    _ground(made, motion, true)
    if late:
        made.terms = [replace(t, late=late.get(t.instrument, 0.0)) for t in made.terms]
    return made


def _attitude(made: Equations, m: Mapping[str, Array], true: Mapping[str, Array]) -> None:
    one = np.ones(len(m["theta"]))
    phi, theta = true.get("phi", 0.0 * one), m["theta"]
    rates: dict[str, dict[str, Array]] = {
        "theta": {"q": -np.cos(phi), "r": np.sin(phi)},
        "phi": {"p": -one, "q": -np.tan(theta) * np.sin(phi), "r": -np.tan(theta) * np.cos(phi)},
        "psi": {"q": -np.sin(phi) / np.cos(theta), "r": -np.cos(phi) / np.cos(theta)},
    }
    for head, driver in (("theta", "q"), ("phi", "p"), ("psi", "r")):
        # An angle that never moves (a flight in one plane) turns the others' axes, and has no row of its own.
        if head not in m or driver not in m or not np.ptp(m[head]):
            continue
        made.heads.append(head)
        made.add(head, head, np.unwrap(m[head]), one, 1)
        for name, factor in rates[head].items():
            if name in m:
                made.add(head, name, m[name], factor)


def _air(made: Equations, m: Mapping[str, Array], true: Mapping[str, Array], arm: tuple[float, float, float]) -> None:
    """Rows of the flow angles and the airspeed: the motion of the CG through the air, vanes at `arm`; `true`: what
    the factors are made of."""
    one = np.ones(len(m["theta"]))
    zero = 0.0 * one
    phi, theta = m.get("phi", zero), m["theta"]
    if "airspeed" not in m:
        return
    speed, beta = m["airspeed"], true.get("beta_vane", zero)
    alpha = true.get("alpha_vane", theta + np.arctan2(m.get("v_down", zero), speed))
    p, q, r = (true.get(name, zero) for name in "pqr")
    x, y, z = arm
    u = speed * np.cos(alpha) * np.cos(beta)
    v = speed * np.sin(beta) - x * r + z * p
    w = speed * np.sin(alpha) * np.cos(beta) + x * q - y * p

    def row(head: str, parts: tuple[tuple[str, Array | float, int], ...], of_attitude: tuple[str, Array]) -> None:
        made.heads.append(head)
        for name, factor, order in parts:
            if name in m and np.any(factor):
                made.add(head, name, m[name], factor * one, order)
        name, gravity = of_attitude
        if name in m:
            slope = float(np.mean(np.gradient(gravity) * np.gradient(m[name]))) / max(
                float(np.mean(np.gradient(m[name]) ** 2)), 1e-30
            )
            made.terms.append(Term(head, name, gravity, one, 0, slope))
        else:
            made.terms.append(Term(head, "", gravity, one, 0, 0.0))

    if "alpha_vane" in m:
        head = ("alpha_vane", speed * np.cos(beta) * np.sinc(alpha / np.pi), 1)
        turning = (("q", x, 1), ("p", -y, 1), ("q", -u, 0), ("p", v, 0), ("az", -1.0, 0))
        row("alpha_vane", (head, *turning), ("theta", -G0 * np.cos(theta) * np.cos(phi)))
    if "beta_vane" in m and "r" in m and "ay" in m:
        head = ("beta_vane", speed * np.sinc(beta / np.pi), 1)
        turning = (("r", -x, 1), ("p", z, 1), ("r", u, 0), ("p", -w, 0), ("ay", -1.0, 0))
        row("beta_vane", (head, *turning), ("phi", -G0 * np.cos(theta) * np.sin(phi)))
    incidence, slip = np.arctan2(w, u), np.arctan2(v, np.hypot(u, w))
    along, across, up = np.cos(incidence) * np.cos(slip), np.sin(slip), np.sin(incidence) * np.cos(slip)
    row("airspeed", (("airspeed", 1.0, 1), ("ax", -along, 0)), ("theta", G0 * np.sin(theta) * along))
    # Lift and side force have parts along the path, too small to tell their own instruments' errors; the angles of the
    # mean flow that make them are as wrong as the vanes are out of line with the accelerometers.
    roll = true.get("phi", zero)
    lift = m["az"] + G0 * np.cos(theta) * np.cos(roll) if "az" in m else zero
    push = m["ay"] + G0 * np.cos(theta) * np.sin(roll) if "ay" in m else zero
    made.terms.append(Term("airspeed", "", -up * lift - across * push, one, 0, 0.0))
    rolling = speed * p
    for angle, of, factor in (
        ("incidence", "airspeed", -lift),
        ("incidence", "beta_vane", -rolling),
        ("sideslip", "airspeed", -push),
        ("sideslip", "alpha_vane", rolling),
    ):
        if of in made.heads and np.any(factor):
            made.terms.append(Term(of, angle, zero, factor, 0, 0.0))


def _ground(made: Equations, m: Mapping[str, Array], true: Mapping[str, Array]) -> None:
    """Rows of the velocity over ground and the altitude."""
    one = np.ones(len(m["theta"]))
    zero = 0.0 * one
    has_heading = "psi" in m
    turned = ned_from_body(true.get("phi", zero), m["theta"], m.get("psi", zero))
    for axis, head in enumerate((*GROUND, "altitude")):
        if head not in m or (axis < GROUND.index("v_down") and not has_heading):
            continue
        made.heads.append(head)
        is_altitude = head == "altitude"
        made.add(head, head, m[head], -one if is_altitude else one, 2 if is_altitude else 1)
        down = min(axis, GROUND.index("v_down"))
        for column, name in enumerate(("ax", "ay", "az")):
            if name in m:
                made.add(head, name, m[name], -turned[:, down, column])
        if down == GROUND.index("v_down"):
            made.terms.append(Term(head, "", -G0 * one, one, 0, 0.0))
