"""What the lateral instruments say of each other in flight: the last two minutes, by the tenth of a second.

As consistency.py has it for the longitudinal ones: roll rate and yaw rate against the change of roll angle and heading;
the vane of sideslip against the inertial sideslip at its place, with what aileron and rudder alone would do by the
profile as instrument, which side gusts have nothing to do with:

    beta' = qbar S/(m V) CY - r + g phi/V,   Ixx p' - Ixz r' = qbar S b Cl,   Izz r' - Ixz p' = qbar S b Cn

Source: Klein and Morelli 2006, chapters 3 (motion) and 10 (kinematic consistency). SI, rad.
"""

from __future__ import annotations

import math
from operator import itemgetter
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import FRESH_AGE_S, G0, LATERAL, SIGNAL_INDEX
from station.model.consistency import FARTHEST, KEEP, PER_MEAN, SEA_LEVEL, Means
from station.numerics.angles import wrap
from station.numerics.named_state import Element, blank, packed
from station.numerics.second_order import vane_lag
from station.profile import Aircraft
from station.rows import Frame

Array = NDArray[np.float64]

LEAK_S: Final = 20.0
"""Time constant with which the roll angle by the surfaces alone goes back to level, as a pilot brings it."""
SIGNALS_USED: Final = (
    *("p", "q", "r", "phi", "theta", "psi", "beta_vane", "aileron", "rudder"),
    *("airspeed", "dynamic_pressure", "mass"),
)
_P, _Q, _R, _PHI, _THETA, _PSI, _BETA, _DA, _DR, _V, _QBAR, _MASS, _SLIP = range(13)
"""After the signals: the inertial sideslip at the CG."""
OF_ITS_TIME: Final = 9
INPUTS: Final = 13

# channels of a mean
ROLL, ROLLED, HEADING, YAWED, VANE, SLIP, SLIP_Z = range(7)
CHANNELS: Final = 7


class Constants(NamedTuple):
    """What `step` goes by."""

    dt: float
    area: float
    span: float
    mass: float
    slopes: Annotated[Array, (3, 5)]
    """Of CY, and of Cl and Cn through the inverse of the inertia matrix (1/(kg m2)), by sideslip, p b/2V, r b/2V,
    aileron and rudder."""
    arm: float
    raised: float
    """Of the vane: x and z from the CG."""


class State:
    """What `step` edits."""

    sums: Annotated[Array, CHANNELS]
    """Of the mean under way."""
    ticks: int
    """In it."""
    rows: int
    """Means completed."""
    means: Annotated[Array, (KEEP, CHANNELS)]
    """The newest; number i is at i % KEEP."""
    roll: float
    roll_was: float
    heading: float
    heading_was: float
    """Angles without turns, and the last readings."""
    rolled: float
    yawed: float
    """Integrals of the rates."""
    beta: float
    p: float
    r: float
    phi: float
    """What the surfaces alone make."""
    aileron_0: float
    rudder_0: float
    """Where they were at first."""


@njit(cache=True, error_model="numpy")
def add(constants: Element, state: Element, u: Array, age: Array) -> None:
    """One tick of `u` (INPUTS,): signals and the inertial sideslip, NaN where missing; edits the state. `age`: of the
    signals that count only at the frame's own time, s."""
    c: Constants = constants[0]
    s: State = state[0]
    for i in range(OF_ITS_TIME):
        if not age[i] <= FRESH_AGE_S:
            u[i] = math.nan
    phi, theta = u[_PHI], u[_THETA]
    turning = u[_Q] * math.sin(phi) + u[_R] * math.cos(phi)
    rolling, yawing = u[_P] + math.tan(theta) * turning, turning / math.cos(theta)
    if math.isfinite(rolling):
        s.rolled += c.dt * rolling
    if math.isfinite(yawing):
        s.yawed += c.dt * yawing
    moved, turned = wrap(phi - s.roll_was), wrap(u[_PSI] - s.heading_was)
    s.roll += moved if math.isfinite(moved) else 0.0
    s.heading += turned if math.isfinite(turned) else 0.0
    s.roll_was, s.heading_was = phi, u[_PSI]
    s.sums[ROLL] += s.roll if math.isfinite(moved) else math.nan
    s.sums[HEADING] += s.heading if math.isfinite(turned) else math.nan
    # Integrals by trapezes: half of the newest step belongs to the next tick.
    s.sums[ROLLED] += s.rolled - 0.5 * c.dt * rolling
    s.sums[YAWED] += s.yawed - 0.5 * c.dt * yawing
    s.sums[VANE] += u[_BETA]
    s.sums[SLIP] += u[_SLIP] + (u[_R] * c.arm - u[_P] * c.raised) / u[_V]
    s.sums[SLIP_Z] += _by_surfaces(c, s, u)
    s.ticks += 1
    if s.ticks < PER_MEAN:
        return
    row = s.rows % KEEP
    for k in range(CHANNELS):
        s.means[row, k] = s.sums[k] / PER_MEAN
        s.sums[k] = 0.0
    s.ticks = 0
    s.rows += 1


@njit(cache=True, error_model="numpy")
def _by_surfaces(c: Constants, s: State, u: Array) -> float:
    """Sideslip at the vane that aileron and rudder alone make by the profile: an instrument, not a prediction. Each
    motion's own damping is implicit, which bears any; one that diverges begins anew."""
    v, da, dr, qbar = u[_V], u[_DA], u[_DR], u[_QBAR]
    if not (math.isfinite(da + dr) and v > 0.0):
        return math.nan
    if not math.isfinite(s.aileron_0):
        s.aileron_0, s.rudder_0 = da, dr
    da, dr = da - s.aileron_0, dr - s.rudder_0
    pressure = qbar if qbar > 0.0 else SEA_LEVEL * v * v
    mass = u[_MASS] if u[_MASS] > 0.0 else c.mass
    half = c.span / (2.0 * v)
    force, moment = c.dt * pressure * c.area / (mass * v), c.dt * pressure * c.area * c.span
    y, roll, yaw = c.slopes[0], c.slopes[1], c.slopes[2]
    beta = s.beta + c.dt * (G0 * s.phi / v - s.r)
    beta += force * (half * (y[1] * s.p + y[2] * s.r) + y[3] * da + y[4] * dr)
    beta /= 1.0 - force * y[0]
    p = s.p + moment * (roll[0] * beta + half * roll[2] * s.r + roll[3] * da + roll[4] * dr)
    p /= 1.0 - moment * half * roll[1]
    r = s.r + moment * (yaw[0] * beta + half * yaw[1] * p + yaw[3] * da + yaw[4] * dr)
    r /= 1.0 - moment * half * yaw[2]
    phi = (s.phi + c.dt * p) / (1.0 + c.dt / LEAK_S)
    if not (abs(beta) < FARTHEST and abs(phi) < FARTHEST):
        beta = p = r = phi = 0.0
    s.beta, s.p, s.r, s.phi = beta, p, r, phi
    return float(beta + (r * c.arm - p * c.raised) / v)


def constants(aircraft: Aircraft, dt: float) -> Constants:
    """Of `add`; where the profile lacks inertia or derivatives, slopes are NaN, and no vane is judged."""
    g, i, boom = aircraft.geometry, aircraft.inertia, aircraft.boom
    values = np.array([aircraft.value(name) for name in LATERAL]).reshape(3, 5)
    ixx, izz = (math.nan if x is None else x for x in (i.ixx, i.izz))
    if aircraft.kinematics_only or not values[:, 0].all():
        values = values * math.nan
    mixed = np.array([[izz, i.ixz], [i.ixz, ixx]]) / (ixx * izz - i.ixz**2)
    return Constants(
        dt=dt,
        area=g.wing_area,
        span=g.span,
        mass=i.mass,
        slopes=np.vstack([values[:1], np.einsum("ij,jk->ik", mixed, values[1:])]),
        arm=boom.vane_x if boom else 0.0,
        raised=boom.vane_z if boom else 0.0,
    )


class LateralWindow(Means):
    """The state of `add`: what is kept of the last two minutes."""

    def __init__(self, aircraft: Aircraft, dt: float) -> None:
        state = blank(State)
        state["means"] = math.nan
        for name in ("roll_was", "heading_was", "aileron_0", "rudder_0"):
            state[name] = math.nan
        super().__init__(state)
        self._constants = packed(constants(aircraft, dt))
        boom = aircraft.boom
        self.vane_lag = vane_lag(boom.vane_frequency, boom.vane_damping) if boom else 0.0
        """Of the vane on its spring, by the profile, s."""
        columns = [SIGNAL_INDEX[name] for name in SIGNALS_USED]
        self._pick: Any = itemgetter(*columns)
        self._pick_ages: Any = itemgetter(*columns[:OF_ITS_TIME])

    def add(self, frame: Frame, sideslip: float) -> None:
        """One tick's frame, and the inertial sideslip at the CG."""
        u = np.array((*self._pick(frame.values), sideslip))
        add(self._constants, self._state, u, np.array(self._pick_ages(frame.age_s)))
