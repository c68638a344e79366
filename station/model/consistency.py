"""What the instruments say of each other in flight, and of the profile's model: the last two minutes, by the tenth of a
second.

Each tick adds to the means of 0.1 s; once a second one pair of signals is compared over all that is kept:

    y(t) = gain x(t - delay) + error, in differences from one mean to the next

The vane against the inertial flow angle and coefficients against the model are regressed with an instrument: what the
elevator alone would do by the profile. Gusts, which move the aircraft and the vane both, have nothing to do with it, so
that gain and delay are right in turbulence too (a pilot who fights the gusts spoils this a little). For attitude
against pitch rate and velocity against acceleration it is what the rate shows a little earlier and later. Compiled, of
fixed cost, and without clock: the same frames give the same bits.

Source: Klein and Morelli 2006, chapter 10 (kinematic consistency).
"""

from __future__ import annotations

import math
from operator import itemgetter
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import FRESH_AGE_S, G0, SIGNAL_INDEX
from station.model.gain_and_delay import Match, beside, compare, level
from station.numerics.atmosphere import air_density
from station.numerics.named_state import Element, blank, packed
from station.profile import Aircraft
from station.rows import AlphaEstimate, Frame

Array = NDArray[np.float64]

PER_MEAN: Final = 5
KEEP: Final = 1200
"""Means kept: 120 s."""
FARTHEST: Final = 1.0
"""What the elevator alone can do to the angle of attack, rad."""
SEA_LEVEL: Final = 0.6
"""Half the density of the air at sea level, kg/m3: dynamic pressure of the instrument where none is measured."""

SIGNALS_USED: Final = (
    *("q", "theta", "az", "ax", "v_down", "v_north", "v_east", "elevator", "airspeed", "dynamic_pressure"),
    *("phi", "psi", "r", "ay", "static_pressure", "air_temperature", "mass"),
)
_Q, _THETA, _AZ, _AX, _VD, _VN, _VE, _DE, _V, _QBAR, _PHI, _PSI, _R, _AY, _STATIC, _TEMP, _MASS = range(17)
OF_ITS_TIME: Final = 8
"""Signals before this one count only where they are measured at the frame's own time."""
_VANE, _FLOW, _ALPHA = range(17, 20)
"""After the signals: the vane with calibration and dynamics undone, the inertial flow angle at its place, alpha."""
INPUTS: Final = 20

# channels of a mean
VANE, FLOW, FLOW_Z, THETA, TURNED, SINK, FALLEN, GAINED, PUSHED, SPEED, PITOT = range(11)
LIFT, LIFT_MODEL, LIFT_Z, MOMENT, MOMENT_MODEL, MOMENT_Z = range(11, 17)
CHANNELS: Final = 17


class Constants(NamedTuple):
    """What `step` goes by: SI, derivatives as in Klein and Morelli."""

    dt: float
    area: float
    chord: float
    mass: float
    iyy: float
    cl_0: float
    cl_alpha: float
    cl_q: float
    cl_de: float
    cm_0: float
    cm_alpha: float
    cm_q: float
    cm_de: float
    imu_x: float
    imu_z: float
    arm: float
    """Of IMU and vane, from the CG."""
    density: float
    """Of the air; NaN: not known."""


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
    alpha: float
    q: float
    """What the elevator alone makes, rad and rad/s."""
    elevator_0: float
    """Where it was at first, rad."""
    q_was: float
    north_was: float
    east_was: float
    """Pitch rate and velocity at the last tick."""
    turned: float
    fallen: float
    gained: float
    pushed: float
    """Integrals of pitch rate, of the acceleration down, of the velocity's change along the heading, and of the
    acceleration along it."""


@njit(cache=True, error_model="numpy")
def step(c: Constants, s: State, u: Array, age: Array) -> bool:
    """One tick of `u` (INPUTS,): signals and the vane's three, NaN where missing; edits `s`.

    `age`: of the signals that count only at the frame's own time, s. Returns whether a mean was completed.
    """
    for i in range(OF_ITS_TIME):
        if not age[i] <= FRESH_AGE_S:
            u[i] = math.nan
    mass = u[_MASS] if u[_MASS] > 0.0 else c.mass
    _integrate(c, s, u)
    _follow_elevator(c, s, u, mass)
    _compare_model(c, s, u, mass)
    s.sums[VANE] += u[_VANE]
    s.sums[FLOW] += u[_FLOW]
    s.sums[THETA] += u[_THETA]
    s.sums[SPEED] += u[_V]
    # Not by altitude: the standard atmosphere's temperature is too coarse to judge a sensor by.
    density = air_density(c.density, u[_STATIC], u[_TEMP], math.nan)
    s.sums[PITOT] += math.sqrt(2.0 * u[_QBAR] / density) if u[_QBAR] > 0.0 else math.nan
    s.ticks += 1
    if s.ticks < PER_MEAN:
        return False
    row = s.rows % KEEP
    for k in range(CHANNELS):
        s.means[row, k] = s.sums[k] / PER_MEAN
        s.sums[k] = 0.0
    s.ticks = 0
    s.rows += 1
    return True


@njit(cache=True, error_model="numpy")
def _integrate(c: Constants, s: State, u: Array) -> None:
    """Attitude and velocity as rates and accelerations have them; a gap leaves them where they were and spoils the
    mean."""
    q, theta = u[_Q], u[_THETA]
    phi = u[_PHI] if math.isfinite(u[_PHI]) else 0.0
    r = u[_R] if math.isfinite(u[_R]) else 0.0
    ay = u[_AY] if math.isfinite(u[_AY]) else 0.0
    psi = u[_PSI] if math.isfinite(u[_PSI]) else math.atan2(u[_VE], u[_VN])
    turn = q * math.cos(phi) - r * math.sin(phi)
    if math.isfinite(turn):
        s.turned += c.dt * turn
    cth, sth, cph, sph = math.cos(theta), math.sin(theta), math.cos(phi), math.sin(phi)
    down = -sth * u[_AX] + sph * cth * ay + cph * cth * u[_AZ] + G0
    along = cth * u[_AX] + sph * sth * ay + cph * sth * u[_AZ]
    if math.isfinite(down):
        s.fallen += c.dt * down
    if math.isfinite(along):
        s.pushed += c.dt * along
    # The imu is turned about the CG, whose velocity the stream has.
    arm_down = -sth * (q * c.imu_z) + cph * cth * (-q * c.imu_x)
    north, east = u[_VN] - s.north_was, u[_VE] - s.east_was
    gained = math.cos(psi) * north + math.sin(psi) * east
    if math.isfinite(gained):
        s.gained += gained
    s.north_was, s.east_was = u[_VN], u[_VE]
    # Integrals by trapezes: half of the newest step belongs to the next tick.
    s.sums[TURNED] += s.turned - 0.5 * c.dt * turn
    s.sums[SINK] += u[_VD] + arm_down
    s.sums[FALLEN] += s.fallen - 0.5 * c.dt * down
    s.sums[GAINED] += s.gained if math.isfinite(gained) else math.nan
    s.sums[PUSHED] += s.pushed - 0.5 * c.dt * along


@njit(cache=True, error_model="numpy")
def _follow_elevator(c: Constants, s: State, u: Array, mass: float) -> None:
    """What the elevator alone does by the profile: an instrument, not a prediction."""
    v, de, qbar = u[_V], u[_DE], u[_QBAR]
    if not (math.isfinite(de) and v > 0.0):
        for channel in (FLOW_Z, LIFT_Z, MOMENT_Z):
            s.sums[channel] += math.nan
        return
    if not math.isfinite(s.elevator_0):
        s.elevator_0 = de
    pressure = qbar if qbar > 0.0 else SEA_LEVEL * v * v
    moved = de - s.elevator_0
    # By trapezes, which bear any short period; one that diverges begins anew.
    lift, pitch = 0.5 * c.dt * pressure * c.area / (mass * v), 0.5 * c.dt * pressure * c.area * c.chord / c.iyy
    damping = c.cm_q * c.chord / (2.0 * v)
    a, b = s.alpha, s.q
    right = a + 0.5 * c.dt * b - lift * (c.cl_alpha * a + 2.0 * c.cl_de * moved)
    turned = b + pitch * (c.cm_alpha * a + damping * b + 2.0 * c.cm_de * moved)
    free = 1.0 + lift * c.cl_alpha, 1.0 - pitch * damping
    size = free[0] * free[1] - 0.5 * c.dt * pitch * c.cm_alpha
    s.alpha = (right * free[1] + 0.5 * c.dt * turned) / size
    s.q = (turned * free[0] + pitch * c.cm_alpha * right) / size
    if not abs(s.alpha) < FARTHEST:
        s.alpha = s.q = 0.0
    moment = c.cm_alpha * s.alpha + damping * s.q + c.cm_de * moved
    s.sums[FLOW_Z] += s.alpha - c.arm * s.q / v if math.isfinite(moment) else math.nan
    s.sums[LIFT_Z] += c.cl_alpha * s.alpha + c.cl_de * moved + c.cl_q * s.q * c.chord / (2.0 * v)
    s.sums[MOMENT_Z] += moment


@njit(cache=True, error_model="numpy")
def _compare_model(c: Constants, s: State, u: Array, mass: float) -> None:
    """Coefficients of lift and pitching moment, and the profile's model of them."""
    q, v, de, alpha = u[_Q], u[_V], u[_DE], u[_ALPHA]
    acceleration = (q - s.q_was) / c.dt
    s.q_was = q
    force = u[_QBAR] * c.area
    lift = -(math.cos(alpha) * (u[_AZ] + acceleration * c.imu_x) - math.sin(alpha) * u[_AX]) * mass / force
    rates = q * c.chord / (2.0 * v)
    s.sums[LIFT] += lift
    s.sums[LIFT_MODEL] += c.cl_0 + c.cl_alpha * alpha + c.cl_q * rates + c.cl_de * de
    s.sums[MOMENT] += c.iyy * acceleration / (force * c.chord)
    s.sums[MOMENT_MODEL] += c.cm_0 + c.cm_alpha * alpha + c.cm_q * rates + c.cm_de * de


def constants(aircraft: Aircraft, imu: tuple[float, float, float], dt: float) -> tuple[Constants, bool]:
    """Constants of `step`, and whether the profile has a model to compare with."""
    names = ("CL_0", "CL_alpha", "CL_q", "CL_de", "Cm_0", "Cm_alpha", "Cm_q", "Cm_de")
    known = not aircraft.kinematics_only and aircraft.inertia.iyy is not None
    known = known and all(aircraft.value(n) for n in ("CL_alpha", "Cm_alpha", "Cm_q", "Cm_de"))
    # Without a model: the derivatives of an ordinary aircraft, for the instrument, which need not be right.
    values = [aircraft.value(n) for n in names] if known else [0.0, 5.0, 0.0, 0.0, 0.0, -1.0, -20.0, -1.5]
    iyy = aircraft.inertia.iyy if known else None
    chord, mass = aircraft.geometry.chord, aircraft.inertia.mass
    imu_x, _, imu_z = aircraft.imu_at(imu)
    made = Constants(
        dt=dt,
        area=aircraft.geometry.wing_area,
        chord=chord,
        mass=mass,
        iyy=iyy or mass * (1.5 * chord) ** 2,
        **{name.lower(): value for name, value in zip(names, values, strict=True)},
        imu_x=imu_x,
        imu_z=imu_z,
        arm=aircraft.boom.vane_x if aircraft.boom else 0.0,
        density=aircraft.air_density if aircraft.air_density is not None else math.nan,
    )
    return made, known


def at_rest() -> Element:
    """A State before the first tick."""
    state = blank(State)
    state["means"] = math.nan
    for name in ("elevator_0", "q_was", "north_was", "east_was"):
        state[name] = math.nan
    return state


@njit(cache=True, error_model="numpy")
def add(constants: Element, state: Element, u: Array, age: Array) -> bool:
    """`step` with constants and state packed."""
    return step(constants[0], state[0], u, age)


class Means:
    """What a window keeps: `state` has `rows`, the means completed, and `means` (KEEP, channels)."""

    def __init__(self, state: Element) -> None:
        self._state = state
        self._means: Array = state["means"][0]
        self._delays: dict[int, float] = {}

    def _column(self, channel: int, count: int) -> Array:
        """The newest means of a channel, oldest first."""
        newest = int(self._state["rows"][0])
        rows = np.arange(newest - min(count, newest), newest) % KEEP
        return np.ascontiguousarray(self._means[rows, channel])

    def compare(self, y: int, x: int, z: int) -> Match:
        """`compare` of three channels; one that is its own instrument by what it shows beside."""
        moved = self._column(x, KEEP)
        instrument = beside(moved) if z == x else self._column(z, KEEP)
        found = compare(self._column(y, KEEP), moved, instrument, self._delays.get(y, 0.0))
        self._delays[y] = found.delay if math.isfinite(found.delay) else 0.0
        return found

    def level(self, y: int, x: int, moving: bool, count: int) -> tuple[float, float]:
        """`level` of two channels over the newest `count` means: mean and sd."""
        mean, sd = level(self._column(y, count), self._column(x, count), moving)
        return mean, sd


class Window(Means):
    """The state of `step`: what is kept of the last two minutes."""

    def __init__(self, aircraft: Aircraft, imu: tuple[float, float, float], dt: float) -> None:
        self._known, self.has_model = constants(aircraft, imu, dt)
        super().__init__(at_rest())
        self._constants = packed(self._known)
        columns = [SIGNAL_INDEX[name] for name in SIGNALS_USED]
        self._pick: Any = itemgetter(*columns)
        self._pick_ages: Any = itemgetter(*columns[:OF_ITS_TIME])
        self._nothing = (math.nan,) * 3

    def add(self, frame: Frame, a: AlphaEstimate) -> None:
        """One tick's frame and what was made of its vane."""
        vane = a.vane + a.instrument + a.zero + a.upwash + a.lag
        rest = (vane, a.alpha_inertial - a.rate, a.alpha) if a.valid else self._nothing
        u = np.array(self._pick(frame.values) + rest)
        age = np.array(self._pick_ages(frame.age_s))
        add(self._constants, self._state, u, age)

    @property
    def slopes(self) -> tuple[float, float]:
        """CL_alpha and Cm_alpha of the model."""
        return self._known.cl_alpha, self._known.cm_alpha

    @property
    def speed(self) -> float:
        """The newest mean airspeed, m/s."""
        return float(self._means[(int(self._state["rows"][0]) - 1) % KEEP, SPEED])
