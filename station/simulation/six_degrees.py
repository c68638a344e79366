"""Six degrees of freedom: the longitudinal equations with sideslip, roll and yaw added to them.

The longitudinal part is `aircraft.rates` itself, so that without lateral motion the flight is the three-degree-of-
freedom one. Side force, rolling and yawing moment are linear in sideslip, rates and surfaces, per rad, rates normalised
with b/2V, in body axes (Klein and Morelli 2006; rigid body: Stevens and Lewis 2003). Side gusts act at the CG; the air
does not roll. A pilot levels the wings and holds the heading with slow ailerons.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import G0
from station.profile import Actuator, Aircraft, Flight, Manoeuvre
from station.rows import ProfileError
from station.simulation import airframe as ac
from station.simulation.boom import NO_BOOM, VaneConstants, vane_constants
from station.simulation.gusts import GustField, dryden_of, field_constants, gust_at
from station.simulation.manoeuvres import surface_input
from station.simulation.motion import COLUMNS, DT, Memory, Site, Tables, at_rest, places, record, stage_rates, vanes_now
from station.simulation.three_degrees import BLOCK, SPEED_MARGIN, elevator_play, indicial_tables, reach, site
from station.simulation.trigonometry import sine_cosine

SIDE, ROLL, YAW, BANK, TURN, NORTH, EAST, AILERON, RUDDER, HELD, SIZE = range(11)
"""State beside the longitudinal one: v (m/s), p, r (rad/s), bank, heading turned since the start (rad), way through the
air mass north and east (m), aileron, rudder, what the pilot adds to the aileron (rad)."""

COEFFICIENTS: Final = ("CY", "Cl", "Cn")
ARGUMENTS: Final = ("beta", "p", "r", "da", "dr")
LATERAL_TRUTH: Final = ("beta", *COEFFICIENTS)
"""What no sensor shows: sideslip at the CG, rad, and the lateral coefficients."""
LATERAL_COLUMNS: Final = (*COLUMNS, *LATERAL_TRUTH)
SURFACES: Final = ("elevator", "aileron", "rudder")

# A bank of 10 deg is met with 2 deg of aileron, 2 s late: slower than any lateral mode that a test excites.
HOLD_BANK: Final = 0.2
HOLD_HEADING: Final = 0.15
"""Bank by which a heading error is met, rad per rad."""
HOLD_LAG: Final = 2.0

_P, _R, _AX, _AY, _AZ, _PHI, _PSI = places("p", "r", "ax", "ay", "az", "phi", "psi")
_V_NORTH, _V_EAST, _LATITUDE, _LONGITUDE = places("v_north", "v_east", "latitude", "longitude")
_AILERON, _RUDDER, _PDOT, _RDOT = places("aileron", "rudder", "pdot", "rdot")
_TRUE = len(COLUMNS)


class Lateral(NamedTuple):
    """What the lateral equations need, SI."""

    ixx: float
    izz: float
    ixz: float
    span: float
    slopes: NDArray[np.float64]
    """(3, 5): of CY, Cl, Cn by beta, p, r, aileron, rudder."""
    vane_y: float
    actuators: NDArray[np.float64]
    """(2, 3): lag (s), rate limit (rad/s) and travel (rad) of aileron and rudder."""
    hold_bank: float
    hold_heading: float


def has_lateral(aircraft: Aircraft) -> bool:
    """Whether the profile has any lateral derivative."""
    return any(aircraft.value(f"{c}_{a}") for c in COEFFICIENTS for a in ARGUMENTS)


def lateral_constants(aircraft: Aircraft, hold: bool = True) -> Lateral:
    """Raises ProfileError for an aircraft that cannot be flown in six degrees of freedom."""
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

    return Lateral(
        ixx=inertia.ixx,
        izz=inertia.izz,
        ixz=inertia.ixz,
        span=aircraft.geometry.span,
        slopes=np.array([[aircraft.value(f"{c}_{a}") for a in ARGUMENTS] for c in COEFFICIENTS]),
        vane_y=aircraft.boom.vane_y if aircraft.boom else 0.0,
        actuators=np.array([row(aircraft.aileron), row(aircraft.rudder)]),
        hold_bank=HOLD_BANK if hold else 0.0,
        hold_heading=HOLD_HEADING if hold else 0.0,
    )


@njit(cache=True, error_model="numpy", inline="always")
def add_lateral(
    c: ac.Constants,
    side: Lateral,
    heading: float,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    commands: tuple[float, float],
    side_air: float,
    dx: NDArray[np.float64],
    dy: NDArray[np.float64],
    aux: NDArray[np.float64],
    lateral: NDArray[np.float64],
) -> None:
    """The lateral state's derivative into `dy`, and what it changes of the longitudinal one's in `dx`.

    dx and aux as `aircraft.rates` leaves them; `commands`: aileron and rudder, rad; `side_air`: sideways velocity
    relative to the air, m/s. `lateral` (5): beta, CY, Cl, Cn, side specific force.
    """
    u, w, q, theta = x[ac.U], x[ac.W], x[ac.Q], x[ac.THETA]
    v, p, r = y[SIDE], y[ROLL], y[YAW]
    speed = aux[ac.AIRSPEED]
    beta = math.asin(side_air / speed)
    per_rate = 0.5 * side.span / (c.reference_speed if c.fixed_rate_reference > 0.0 else speed)
    lateral[0] = beta
    for i in range(3):
        s = side.slopes[i]
        lateral[1 + i] = s[0] * beta + (s[1] * p + s[2] * r) * per_rate + s[3] * y[AILERON] + s[4] * y[RUDDER]
    force = aux[ac.PRESSURE] * c.area
    lateral[4] = force * lateral[1] / c.mass
    rolling, yawing = force * side.span * lateral[2], force * side.span * lateral[3]

    sin_t, cos_t = sine_cosine(theta)
    sin_b, cos_b = sine_cosine(y[BANK])
    dx[ac.U] += r * v
    dx[ac.W] += G0 * cos_t * (cos_b - 1.0) - p * v
    dx[ac.Q] += ((side.izz - side.ixx) * p * r - side.ixz * (p * p - r * r)) / c.iyy
    dx[ac.THETA] = q * cos_b - r * sin_b
    across = v * sin_b + w * cos_b
    dx[ac.DISTANCE] = u * cos_t + across * sin_t
    dx[ac.HEIGHT] = u * sin_t - across * cos_t

    dy[SIDE] = lateral[4] + p * w - r * u + G0 * cos_t * sin_b
    product = side.ixx * side.izz - side.ixz * side.ixz
    mixed = side.ixz * (side.ixx - c.iyy + side.izz)
    spin = mixed * p * q - (side.izz * (side.izz - c.iyy) + side.ixz * side.ixz) * q * r
    dy[ROLL] = (spin + side.izz * rolling + side.ixz * yawing) / product
    spin = ((side.ixx - c.iyy) * side.ixx + side.ixz * side.ixz) * p * q - mixed * q * r
    dy[YAW] = (spin + side.ixz * rolling + side.ixx * yawing) / product
    turning = (q * sin_b + r * cos_b) / cos_t
    dy[BANK] = p + turning * sin_t
    dy[TURN] = turning
    to_the_right = v * cos_b - w * sin_b
    sin_h, cos_h = math.sin(heading + y[TURN]), math.cos(heading + y[TURN])
    dy[NORTH] = dx[ac.DISTANCE] * cos_h - to_the_right * sin_h
    dy[EAST] = dx[ac.DISTANCE] * sin_h + to_the_right * cos_h
    for i in range(2):
        lag, rate, travel = side.actuators[i]
        wanted = commands[i] + (y[HELD] if i == 0 else 0.0)
        wanted = min(max(wanted, -travel), travel)
        dy[AILERON + i] = min(max((wanted - y[AILERON + i]) / lag, -rate), rate)
    # A positive aileron rolls left.
    dy[HELD] = (side.hold_bank * (y[BANK] + side.hold_heading * y[TURN]) - y[HELD]) / HOLD_LAG


@njit(cache=True, error_model="numpy", inline="always")
def _record_lateral(
    site: Site,
    time: float,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    dx: NDArray[np.float64],
    dy: NDArray[np.float64],
    aux: NDArray[np.float64],
    lateral: NDArray[np.float64],
    row: NDArray[np.float64],
) -> None:
    """What lateral motion changes of a row that `motion.record` wrote, and its own truth."""
    p, q, r = y[ROLL], x[ac.Q], y[YAW]
    pdot, qdot, rdot = dy[ROLL], dx[ac.Q], dy[YAW]
    i, j, k = site.imu_x, site.imu_y, site.imu_z
    row[_P], row[_R] = p, r
    row[_AX] = aux[ac.FORCE_X] + qdot * k - rdot * j + p * (q * j + r * k) - (q * q + r * r) * i
    row[_AY] = lateral[4] + rdot * i - pdot * k + q * (p * i + r * k) - (p * p + r * r) * j
    row[_AZ] = aux[ac.FORCE_Z] + pdot * j - qdot * i + r * (p * i + q * j) - (p * p + q * q) * k
    row[_PHI] = y[BANK]
    heading = site.heading + y[TURN]
    row[_PSI] = heading - 2.0 * math.pi * math.floor((heading + math.pi) / (2.0 * math.pi))
    row[_V_NORTH], row[_V_EAST] = dy[NORTH] + site.wind_north, dy[EAST] + site.wind_east
    north, east = y[NORTH] + site.wind_north * time, y[EAST] + site.wind_east * time
    latitude = site.latitude + north / site.radius_north
    row[_LATITUDE] = latitude
    row[_LONGITUDE] = site.longitude + east / (site.radius_east * math.cos(0.5 * (latitude + site.latitude)))
    row[_AILERON], row[_RUDDER] = y[AILERON], y[RUDDER]
    row[_PDOT], row[_RDOT] = pdot, rdot
    row[_TRUE], row[_TRUE + 1], row[_TRUE + 2], row[_TRUE + 3] = lateral[0], lateral[1], lateral[2], lateral[3]


@njit(cache=True, error_model="numpy")
def advance_lateral(
    c: ac.Constants,
    side: Lateral,
    tables: Tables,
    vane: VaneConstants,
    site: Site,
    memory: Memory,
    y: NDArray[np.float64],
    commands: NDArray[np.float64],
    field: NDArray[np.float64],
    first: int,
    out: NDArray[np.float64],
) -> None:
    """Step on by len(out) steps of DT: classical Runge-Kutta of fourth order.

    y (SIZE): the lateral state, changed in place. commands (3, 2n + 1): elevator, aileron and rudder at steps and
    half-steps. out (n, len(LATERAL_COLUMNS)): the instants before the steps.
    """
    x, marks = memory.x, memory.marks
    n = x.shape[0]
    dx, total_x, trial_x = np.zeros(n), np.zeros(n), np.zeros(n)
    dy, total_y, trial_y = np.zeros(SIZE), np.zeros(SIZE), np.zeros(SIZE)
    aux, lateral = np.zeros(ac.AUX_SIZE), np.zeros(5)
    ring = memory.wake.shape[1]
    for k in range(out.shape[0]):
        air = ac.air_at(c, x[ac.HEIGHT])
        trial_x[:], trial_y[:] = x, y
        total_x[:], total_y[:] = 0.0, 0.0
        for stage in range(4):
            at = 2 * k + (stage + 1) // 2
            side_air = trial_y[SIDE] + gust_at(field, first, trial_x[ac.DISTANCE], 1)
            entry = stage_rates(c, tables, trial_x, commands[0, at], field, first, air, memory, side_air, dx, aux)
            add_lateral(
                c,
                side,
                site.heading,
                trial_x,
                trial_y,
                (commands[1, at], commands[2, at]),
                side_air,
                dx,
                dy,
                aux,
                lateral,
            )
            if stage == 0:
                s = x[ac.DISTANCE]
                marks[2] = entry
                memory.last[2] = aux[ac.SURFACE]
                sideways = y[SIDE] + y[YAW] * vane.x - y[ROLL] * vane.z
                moving = (dx[ac.Q], sideways, y[ROLL] * side.vane_y)
                vanes = vanes_now(c.memory_chord, tables, vane, memory, field, first, moving, aux)
                here = (gust_at(field, first, s, 0), gust_at(field, first, s, 2))
                record(c, site, marks[0] * DT, x, dx, aux, here, vanes, out[k])
                _record_lateral(site, marks[0] * DT, x, y, dx, dy, aux, lateral, out[k])
                marks[0] += 1
                marks[1] += 1
                memory.wake[0, marks[1] % ring] = s
                memory.wake[1, marks[1] % ring] = aux[ac.WING]
            weight = DT / 6.0 if stage == 0 or stage == 3 else DT / 3.0
            ahead = DT if stage == 2 else 0.5 * DT
            for i in range(n):
                total_x[i] += weight * dx[i]
                trial_x[i] = x[i] + ahead * dx[i]
            for i in range(SIZE):
                total_y[i] += weight * dy[i]
                trial_y[i] = y[i] + ahead * dy[i]
        for i in range(n):
            x[i] += total_x[i]
        for i in range(SIZE):
            y[i] += total_y[i]


class LateralSimulation:
    """As `Simulation`, in six degrees of freedom: from the same trim, wings level.

    Gusts are met along the way flown; the heading turns where ailerons, rudder and side gusts turn it.
    """

    def __init__(
        self,
        aircraft: Aircraft,
        flight: Flight,
        manoeuvres: Sequence[Manoeuvre] = (),
        imu_position: tuple[float, float, float] = (0.0, 0.0, 0.0),
        seed: int | None = None,
        hold: bool = True,
    ) -> None:
        """As Simulation's; `hold` also levels the wings. Raises ProfileError."""
        self.constants = ac.constants(aircraft, flight.speed, flight.altitude, hold, elevator_play(aircraft))
        self.lateral = lateral_constants(aircraft, hold)
        self._tables = indicial_tables(aircraft)
        self._vane = vane_constants(aircraft.boom or NO_BOOM, DT)
        self._site = site(flight, imu_position)
        self._manoeuvres = tuple(manoeuvres)
        self._behind, self._ahead = reach(aircraft)
        self._field = GustField(
            field_constants(dryden_of(flight), flight.speed, flight.gust_start),
            self._behind,
            np.random.SeedSequence(flight.seed if seed is None else seed),
        )
        self._field.cover(-self._behind, self._ahead)
        self._memory = at_rest(self.constants, self._tables, self._behind, self._field.values, self._field.first)
        self._state = np.zeros(SIZE)
        self._commands: NDArray[np.float64] = np.empty((3, 0))
        self._block = -1

    def advance(self, n: int) -> dict[str, NDArray[np.float64]]:
        """The next `n` instants at 200 Hz: "time" (s of flight), every signal true in SI, TRUTH and LATERAL_TRUTH."""
        begin = int(self._memory.marks[0])
        out = np.empty((n, len(LATERAL_COLUMNS)))
        done = 0
        while done < n:
            number, offset = divmod(begin + done, BLOCK)
            m = min(n - done, BLOCK - offset)
            self._prepare(number)
            advance_lateral(
                self.constants,
                self.lateral,
                self._tables,
                self._vane,
                self._site,
                self._memory,
                self._state,
                np.ascontiguousarray(self._commands[:, 2 * offset : 2 * (offset + m) + 1]),
                self._field.values,
                self._field.first,
                out[done : done + m],
            )
            done += m
        columns = np.ascontiguousarray(out.T)
        return {"time": (begin + np.arange(n)) * DT, **dict(zip(LATERAL_COLUMNS, columns, strict=True))}

    def _prepare(self, number: int) -> None:
        """Commands and gusts for a block of steps."""
        if number != self._block:
            half_steps = (np.arange(2 * BLOCK + 1, dtype=np.float64) + 2 * number * BLOCK) * (0.5 * DT)
            self._commands = np.stack([surface_input(self._manoeuvres, half_steps, s) for s in SURFACES])
            self._commands[0] += self.constants.trim_elevator
            self._block = number
        s = float(self._memory.x[ac.DISTANCE])
        far = SPEED_MARGIN * self.constants.trim_speed * BLOCK * DT
        self._field.cover(s - self._behind, s + self._ahead + far)
