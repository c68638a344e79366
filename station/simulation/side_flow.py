"""Side force, rolling and yawing moment: linear in sideslip, rates and surfaces, or with a fin that meets the air late.

Per rad, rates normalised with b/2V, in body axes (Klein and Morelli 2006). In a field that has a span (gust_plane) the
wing's and the body's share is apart from the fin's: a gradient of w along the span counts as a rate of roll and one of
u as a rate of yaw (Etkin 1972, 13.3), and the fin's force is its slope times its own sideslip

    beta + (p height - r arm) / V + (gust there, arm/V later) - sidewash beta(arm/V earlier)

where beta is the wing's and the body's. In steady flight, and slowly, the sum is the profile's derivatives, as at the
tail: of a sideslip that turns as fast as the aircraft yaws, the sidewash's delay counts as a rate of yaw.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.profile import Actuator, Aircraft
from station.rows import ProfileError
from station.simulation import longitudinal as eq
from station.simulation.airframe import Constants
from station.simulation.gusts import SIDEWAYS, Field, gust_at
from station.simulation.legs import Wanted
from station.simulation.motion import AT_FIN, NEWEST, SIDESLIP, Memory, passed

SIDE, ROLL, YAW, BANK, TURN, NORTH, EAST, AILERON, RUDDER, HELD, SIZE = range(11)
"""State beside the longitudinal one: v (m/s), p, r (rad/s), bank, heading turned since the start (rad), way through the
air mass north and east (m), aileron, rudder, what the pilot adds to the aileron (rad)."""

COEFFICIENTS: Final = ("CY", "Cl", "Cn")
ARGUMENTS: Final = ("beta", "p", "r", "da", "dr")

# A bank of 10 deg is met with 2 deg of aileron, 2 s late: slower than any lateral mode that a test excites.
HOLD_BANK: Final = 0.2
HOLD_HEADING: Final = 0.15
"""Bank by which a heading error is met, rad per rad."""
TURN_HEADING: Final = 0.6
"""The same of an aircraft that flies legs: a turn rolls out within ten seconds."""
HOLD_LAG: Final = 2.0


class FinConstants(NamedTuple):
    """The fin where it is flown apart, SI; a slope of 0 otherwise."""

    apart: bool
    slope: float
    arm: float
    height: float
    sidewash: float
    sidewash_delay: float
    met: float
    """Where gusts meet it, behind the CG, m."""


TOGETHER: Final = FinConstants(False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""In the derivatives: all of the aircraft meets the air at the CG."""


class Lateral(NamedTuple):
    """What the lateral equations need, SI."""

    ixx: float
    izz: float
    ixz: float
    span: float
    slopes: NDArray[np.float64]
    """(3, 5): of CY, Cl, Cn by beta, p, r, aileron, rudder; without the fin's share where it is apart."""
    fin: FinConstants
    actuators: NDArray[np.float64]
    """(2, 3): lag (s), rate limit (rad/s) and travel (rad) of aileron and rudder."""
    hold_bank: float
    hold_heading: float
    turn: float
    """Heading turned since the start that the pilot holds, rad,"""
    bank: float
    """and of a turn its bank, rad; NaN where he holds the heading."""


class SideAir(NamedTuple):
    """The air that the aircraft meets sideways, at an instant."""

    speed: float
    """Sideways velocity at the CG relative to the air, m/s."""
    roll: float
    """Gusts as rates of roll and yaw, rad/s."""
    yaw: float
    fin: float
    """Gust at the fin, m/s."""
    past: float
    """Sideslip whose sidewash reaches the fin now, rad."""


class SideFlow(NamedTuple):
    """Quantities on the way from the lateral state to its derivative."""

    beta: float
    """Sideslip at the CG, rad."""
    cy: float
    cl: float
    cn: float
    force_y: float
    """Specific force at the CG, m/s2."""
    fin: float
    """The fin's sideslip where it is apart, rad; 0 where not."""


def has_lateral(aircraft: Aircraft) -> bool:
    """Whether the profile has any lateral derivative."""
    return any(aircraft.value(f"{c}_{a}") for c in COEFFICIENTS for a in ARGUMENTS)


def lateral_constants(
    aircraft: Aircraft, hold: bool = True, wanted: Wanted | None = None, apart: bool = False
) -> Lateral:
    """`apart`: the fin meets the air where it is. Raises ProfileError for an aircraft that cannot be flown in six
    degrees of freedom, or so."""
    inertia = aircraft.inertia
    if not has_lateral(aircraft):
        raise ProfileError(
            f"aircraft {aircraft.name}: derivatives: no lateral ones (CY_beta, Cl_p, ...), and the card moves ailerons "
            "or rudder"
        )
    if inertia.ixx is None or inertia.izz is None:
        missing = "ixx" if inertia.ixx is None else "izz"
        raise ProfileError(f"aircraft {aircraft.name}: inertia.{missing}: missing; lateral motion needs it")
    known = {f"{c}_{a}" for c in COEFFICIENTS for a in ARGUMENTS}
    for name, derivative in aircraft.derivatives.items():
        if name[:2] in COEFFICIENTS and name not in known and derivative.value != 0:
            raise ProfileError(f"aircraft {aircraft.name}: derivatives.{name}: the simulation has no such term")

    def row(a: Actuator) -> tuple[float, float, float]:
        return a.time_constant, a.rate_limit, a.position_limit

    fin = fin_apart(aircraft) if apart else TOGETHER
    slopes = np.array([[aircraft.value(f"{c}_{a}") for a in ARGUMENTS] for c in COEFFICIENTS])
    return Lateral(
        ixx=inertia.ixx,
        izz=inertia.izz,
        ixz=inertia.ixz,
        span=aircraft.geometry.span,
        slopes=slopes - _share(fin, aircraft.geometry.span) if fin.apart else slopes,
        fin=fin,
        actuators=np.array([row(aircraft.aileron), row(aircraft.rudder)]),
        hold_bank=HOLD_BANK if hold else 0.0,
        hold_heading=(TURN_HEADING if wanted else HOLD_HEADING) if hold else 0.0,
        turn=wanted.turn if wanted else 0.0,
        bank=math.nan if wanted is None or wanted.bank is None else wanted.bank,
    )


def fin_apart(aircraft: Aircraft) -> FinConstants:
    """Raises ProfileError for a profile without a fin."""
    fin = aircraft.fin
    if fin is None:
        raise ProfileError(
            f'aircraft {aircraft.name}: fin: missing; flight.field = "plane" needs [fin] lift_slope and arm\n'
            'lift_slope = 0.0 for an aircraft without one, or field = "line"'
        )
    met = fin.arm * fin.penetration
    return FinConstants(True, fin.lift_slope, fin.arm, fin.height, fin.sidewash, fin.sidewash_delay, met)


def _share(fin: FinConstants, span: float) -> NDArray[np.float64]:
    """(3, 5): what the fin makes of the derivatives."""
    by_beta, by_p = 1.0 - fin.sidewash, 2.0 * fin.height / span
    by_r = -2.0 * fin.arm / span * (1.0 + fin.sidewash)
    force = -fin.slope * np.array([by_beta, by_p, by_r, 0.0, 0.0])
    return np.stack([force, force * fin.height / span, -force * fin.arm / span])


@njit(cache=True, error_model="numpy", inline="always")
def side_air(
    c: Constants, side: Lateral, memory: Memory, field: Field, x: NDArray[np.float64], y: NDArray[np.float64],
) -> tuple[SideAir, int]:  # fmt: skip
    """The air met sideways in the state x, y, and the entry of the wake whose sidewash is at the fin."""
    s, entry = x[eq.DISTANCE], memory.marks[AT_FIN]
    speed = y[SIDE] + gust_at(field, s, SIDEWAYS)
    roll, yaw, fin, past = 0.0, 0.0, 0.0, 0.0
    if side.fin.apart:
        roll, yaw = gust_at(field, s + c.gust_edge, field.meets.roll), gust_at(field, s + c.gust_edge, field.meets.yaw)
        fin = gust_at(field, s - side.fin.met, SIDEWAYS)
        place = s - side.fin.arm - side.fin.sidewash_delay * x[eq.U]
        past, entry = passed(memory.wake, SIDESLIP, memory.marks[NEWEST], entry, place)
    return SideAir(speed, roll, yaw, fin, past), entry


@njit(cache=True, error_model="numpy", inline="always")
def side_flow(c: Constants, side: Lateral, y: NDArray[np.float64], air: SideAir, flow: eq.Flow) -> SideFlow:
    """Sideslip, coefficients and side force."""
    beta = math.asin(air.speed / flow.airspeed)
    per_rate = 0.5 * side.span / (c.reference_speed if c.fixed_rate_reference > 0.0 else flow.airspeed)
    p, r, da, dr = y[ROLL] + air.roll, y[YAW] + air.yaw, y[AILERON], y[RUDDER]
    of_y, of_l, of_n = side.slopes[0], side.slopes[1], side.slopes[2]
    cy = of_y[0] * beta + (of_y[1] * p + of_y[2] * r) * per_rate + of_y[3] * da + of_y[4] * dr
    cl = of_l[0] * beta + (of_l[1] * p + of_l[2] * r) * per_rate + of_l[3] * da + of_l[4] * dr
    cn = of_n[0] * beta + (of_n[1] * p + of_n[2] * r) * per_rate + of_n[3] * da + of_n[4] * dr
    at_fin = 0.0
    if side.fin.apart:
        across = y[SIDE] + air.fin - y[YAW] * side.fin.arm + y[ROLL] * side.fin.height
        at_fin = math.asin(across / flow.airspeed) - side.fin.sidewash * air.past
        force = -side.fin.slope * at_fin
        cy += force
        cl += force * side.fin.height / side.span
        cn -= force * side.fin.arm / side.span
    return SideFlow(beta, cy, cl, cn, flow.pressure * c.area * cy / c.mass, at_fin)
