"""A simulated flight: aircraft, air, boom and test inputs together, stepped at 200 Hz.

`Simulation` gives the truth piece by piece, as far as it is asked; `fly` a whole flight with its sensors. Both are
deterministic: the same seed gives the same bits however the flight is cut into pieces.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import SIGNALS, TICK_HZ
from station.profile import Aircraft, Card, Flight, Manoeuvre, Rig
from station.simulation import aircraft as ac
from station.simulation.boom import NO_BOOM, VaneConstants, flow_angle, upwash_step, vane_constants, vane_step
from station.simulation.gusts import GustField, dryden, gust_at
from station.simulation.manoeuvres import elevator_input
from station.simulation.sensors import Channel, Sensor, sensors_of

RATE_HZ: Final = 200
DT: Final = 1.0 / RATE_HZ
EVERY: Final = RATE_HZ // TICK_HZ

TRUTH: Final = ("alpha", "alpha_inertial", "alpha_gust", "w_gust", "u_gust", "CL", "Cm")
"""What no sensor shows: angle of attack at the CG and its parts from motion and gust (rad), the gust at the CG (m/s,
updraught and headwind positive), the aerodynamic coefficients about the CG."""
COLUMNS: Final = (*SIGNALS, *TRUTH)

ORIGIN: Final = (math.radians(41.4), math.radians(-81.9))
"""Latitude and longitude where every simulated flight begins, rad."""
_EQUATOR: Final = 6378137.0
_ECCENTRICITY2: Final = 6.69437999014e-3
_BLOCK: Final = 400
"""Steps whose elevator commands are made together."""
_SPEED_MARGIN: Final = 2.0
"""The gust field is made this many trim speeds times the block's time ahead."""


class Site(NamedTuple):
    """The imu's place, the mean wind, the heading and the earth under the flight; m, m/s, rad."""

    imu_x: float
    imu_z: float
    wind_north: float
    wind_east: float
    heading: float
    latitude: float
    longitude: float
    radius_north: float
    radius_east: float


class Memory(NamedTuple):
    """What a flight carries from one step to the next, changed in place by `_advance`."""

    x: NDArray[np.float64]
    """State of the equations of motion."""
    wake: NDArray[np.float64]
    """(2, n) ring: distance at which the wing was, and its incidence from trim there."""
    marks: NDArray[np.int64]
    """Steps done, last entry of the wake, entry of the wake whose downwash is at the tail."""
    upwash_motion: NDArray[np.float64]
    upwash_gust: NDArray[np.float64]
    vane: NDArray[np.float64]
    """(2, 3): states of the alpha and beta vanes."""
    last: NDArray[np.float64]
    """Inertial and leading-edge gust incidence at the last step, rad."""


class Tables(NamedTuple):
    """Indicial responses, each (2, n)."""

    lift_motion: NDArray[np.float64]
    lift_gust: NDArray[np.float64]
    upwash_motion: NDArray[np.float64]
    upwash_gust: NDArray[np.float64]


@njit(cache=True, error_model="numpy")
def _downwash_source(wake: NDArray[np.float64], newest: int, start: int, place: float) -> tuple[float, int]:
    """Wing incidence when the wing was at `place`, and the ring entry before it; the search begins at `start`."""
    n = wake.shape[1]
    j = start
    while j < newest and wake[0, (j + 1) % n] <= place:
        j += 1
    a = j % n
    if j >= newest:
        return wake[1, a], j
    b = (j + 1) % n
    part = min(max((place - wake[0, a]) / (wake[0, b] - wake[0, a]), 0.0), 1.0)
    return wake[1, a] + part * (wake[1, b] - wake[1, a]), j


@njit(cache=True, error_model="numpy")
def _stage(
    c: ac.Constants,
    tables: Tables,
    x: NDArray[np.float64],
    command: float,
    field: NDArray[np.float64],
    first: int,
    memory: Memory,
    dx: NDArray[np.float64],
    aux: NDArray[np.float64],
) -> int:
    """The state's derivative with the gusts and the downwash where each part of the aircraft is."""
    s = x[ac.DISTANCE]
    nose, tail = s + 0.25 * c.chord, s - c.tail_arm
    gust = (
        gust_at(field, first, s, 0),
        gust_at(field, first, s, 2),
        gust_at(field, first, nose, 0),
        gust_at(field, first, nose, 2),
        gust_at(field, first, tail, 0),
        gust_at(field, first, tail, 2),
    )
    past, entry = _downwash_source(memory.wake, memory.marks[1], memory.marks[2], tail)
    ac.rates(c, tables.lift_motion, tables.lift_gust, x, command, gust, past, dx, aux)
    return entry


@njit(cache=True, error_model="numpy")
def _record(
    c: ac.Constants,
    site: Site,
    time: float,
    x: NDArray[np.float64],
    dx: NDArray[np.float64],
    aux: NDArray[np.float64],
    gust: tuple[float, float],
    vanes: tuple[float, float],
    row: NDArray[np.float64],
) -> None:
    """Everything there is to know at one instant, in the order of COLUMNS."""
    q, theta, height = x[ac.Q], x[ac.THETA], x[ac.HEIGHT]
    pressure, temperature, _ = ac.atmosphere(height)
    north = x[ac.DISTANCE] * math.cos(site.heading) + site.wind_north * time
    east = x[ac.DISTANCE] * math.sin(site.heading) + site.wind_east * time
    latitude = site.latitude + north / site.radius_north
    row[0], row[1] = vanes
    row[2], row[3], row[4], row[5] = aux[ac.AIRSPEED], aux[ac.PRESSURE], pressure, temperature
    row[6], row[7], row[8] = 0.0, q, 0.0
    row[9] = aux[ac.FORCE_X] + dx[ac.Q] * site.imu_z - q * q * site.imu_x
    row[10] = 0.0
    row[11] = aux[ac.FORCE_Z] - dx[ac.Q] * site.imu_x - q * q * site.imu_z
    row[12], row[13], row[14] = 0.0, theta, site.heading
    row[15] = dx[ac.DISTANCE] * math.cos(site.heading) + site.wind_north
    row[16] = dx[ac.DISTANCE] * math.sin(site.heading) + site.wind_east
    row[17] = -dx[ac.HEIGHT]
    row[18] = latitude
    row[19] = site.longitude + east / (site.radius_east * math.cos(0.5 * (latitude + site.latitude)))
    row[20] = height
    row[21], row[22], row[23] = x[ac.ELEVATOR], 0.0, 0.0
    row[24], row[25] = x[ac.THRUST], c.mass
    row[26], row[27], row[28] = 0.0, dx[ac.Q], 0.0
    row[29], row[30] = aux[ac.ALPHA], aux[ac.ALPHA_INERTIAL]
    row[31] = aux[ac.ALPHA] - aux[ac.ALPHA_INERTIAL]
    row[32], row[33], row[34], row[35] = gust[1], gust[0], aux[ac.CL], aux[ac.CM]


# numba's cache does not notice changes of what `_advance` calls in other modules: after editing one, touch this file.
@njit(cache=True, error_model="numpy")
def _advance(
    c: ac.Constants,
    tables: Tables,
    vane: VaneConstants,
    site: Site,
    memory: Memory,
    command: NDArray[np.float64],
    field: NDArray[np.float64],
    first: int,
    out: NDArray[np.float64],
) -> None:
    """Step on by len(out) steps of DT: classical Runge-Kutta of fourth order, the instant before each step recorded.

    command (2n + 1): commanded elevator at steps and half-steps.
    """
    x, marks = memory.x, memory.marks
    n = x.shape[0]
    k1, k2, k3, k4, trial = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    aux, spare = np.zeros(ac.AUX_SIZE), np.zeros(ac.AUX_SIZE)
    ring = memory.wake.shape[1]
    for k in range(out.shape[0]):
        marks[2] = _stage(c, tables, x, command[2 * k], field, first, memory, k1, aux)
        # The vane, from the inputs of the last step and of this one.
        s, alpha_i, gust_le = x[ac.DISTANCE], aux[ac.ALPHA_INERTIAL], aux[ac.GUST_LE]
        begins = marks[0] == 0
        if begins:
            memory.last[0], memory.last[1] = alpha_i, gust_le
            memory.upwash_motion[:] = alpha_i
            memory.upwash_gust[:] = gust_le
        chords = aux[ac.AIRSPEED] * DT / c.memory_chord
        wing = upwash_step(tables.upwash_motion, memory.upwash_motion, memory.last[0], alpha_i, chords)
        wing += upwash_step(tables.upwash_gust, memory.upwash_gust, memory.last[1], gust_le, chords)
        memory.last[0], memory.last[1] = alpha_i, gust_le
        ug, wg = gust_at(field, first, s + vane.x, 0), gust_at(field, first, s + vane.x, 2)
        flow = flow_angle(vane, x[ac.U], x[ac.W], x[ac.Q], ug, wg, wing)
        side = math.asin(gust_at(field, first, s + vane.x, 1) / aux[ac.AIRSPEED])
        if begins:
            memory.vane[0, 0], memory.vane[0, 2] = flow, flow
            memory.vane[1, 0], memory.vane[1, 2] = side, side
        vanes = (vane_step(vane, memory.vane[0], flow) + vane.zero, vane_step(vane, memory.vane[1], side))
        here = (gust_at(field, first, s, 0), gust_at(field, first, s, 2))
        _record(c, site, marks[0] * DT, x, k1, aux, here, vanes, out[k])

        marks[0] += 1
        marks[1] += 1
        memory.wake[0, marks[1] % ring] = s
        memory.wake[1, marks[1] % ring] = aux[ac.WING]
        for i in range(n):
            trial[i] = x[i] + 0.5 * DT * k1[i]
        _stage(c, tables, trial, command[2 * k + 1], field, first, memory, k2, spare)
        for i in range(n):
            trial[i] = x[i] + 0.5 * DT * k2[i]
        _stage(c, tables, trial, command[2 * k + 1], field, first, memory, k3, spare)
        for i in range(n):
            trial[i] = x[i] + DT * k3[i]
        _stage(c, tables, trial, command[2 * k + 2], field, first, memory, k4, spare)
        for i in range(n):
            x[i] += DT / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])


class Simulation:
    """One flight from trim, as far as it is asked for; memory stays flat however long it lasts.

    The aircraft begins trimmed at the flight's speed and altitude in a turbulence that has always been there (or that
    begins at `gust_start`). Wings stay level and the heading constant; a mean wind carries the air. Unless `hold` is
    false, a pilot holds speed and height with slow thrust. Side gusts show on the beta vane only.
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
        """`imu_position` from the CG in body axes, m; `seed` in place of the flight's. Raises ProfileError."""
        self.constants = ac.constants(aircraft, flight.speed, flight.altitude, hold)
        boom = aircraft.boom or NO_BOOM
        unsteady = aircraft.unsteady
        self._tables = Tables(
            ac.indicial_table(unsteady.lift_motion),
            ac.indicial_table(unsteady.lift_gust),
            ac.indicial_table(unsteady.upwash_motion),
            ac.indicial_table(unsteady.upwash_gust),
        )
        self._vane = vane_constants(boom, DT)
        self._site = _site(flight, imu_position)
        self._manoeuvres = tuple(manoeuvres)
        self._behind = unsteady.tail_arm + 1.0
        self._ahead = max(boom.vane_x, aircraft.geometry.chord) + 1.0
        self._field = GustField(
            dryden(flight.altitude, flight.gust_sigma),
            flight.speed,
            flight.gust_start,
            self._behind,
            np.random.SeedSequence(flight.seed if seed is None else seed),
        )
        self._field.cover(-self._behind, self._ahead)
        self._memory = self._at_rest(flight.speed)
        self._commands: NDArray[np.float64] = np.empty(0)
        self._block = 0
        """Number of the block of elevator commands at hand, plus 1."""

    @property
    def steps_done(self) -> int:
        """How many steps of DT have been given; the next one is at steps_done * DT seconds of flight."""
        return int(self._memory.marks[0])

    def advance(self, n: int) -> dict[str, NDArray[np.float64]]:
        """The next `n` instants at 200 Hz: "time" (s of flight), every signal true in SI, and TRUTH; each (n,)."""
        begin = self.steps_done
        out = np.empty((n, len(COLUMNS)))
        done = 0
        while done < n:
            self._prepare(begin + done)
            offset = (begin + done) % _BLOCK
            m = min(n - done, _BLOCK - offset)
            command = self._commands[2 * offset : 2 * (offset + m) + 1]
            _advance(
                self.constants,
                self._tables,
                self._vane,
                self._site,
                self._memory,
                command,
                self._field.values,
                self._field.first,
                out[done : done + m],
            )
            done += m
        columns = np.ascontiguousarray(out.T)
        return {"time": (begin + np.arange(n)) * DT, **dict(zip(COLUMNS, columns, strict=True))}

    def _prepare(self, step: int) -> None:
        """Elevator commands and gusts for the block that the step is in."""
        number = step // _BLOCK
        if self._block != number + 1:
            half_steps = np.arange(2 * _BLOCK + 1, dtype=np.float64) + 2 * number * _BLOCK
            added = elevator_input(self._manoeuvres, half_steps * (0.5 * DT))
            self._commands = self.constants.trim_elevator + added
            self._block = number + 1
        s = float(self._memory.x[ac.DISTANCE])
        reach = _SPEED_MARGIN * self.constants.trim_speed * _BLOCK * DT
        self._field.cover(s - self._behind, s + self._ahead + reach)

    def _at_rest(self, speed: float) -> Memory:
        """Trimmed flight, the wing's memory of gusts as if the one at the start had lasted."""
        c, tables = self.constants, self._tables
        nm, ng = tables.lift_motion.shape[1], tables.lift_gust.shape[1]
        x = ac.trimmed_state(c, nm + ng)
        nose = 0.25 * c.chord
        field, first = self._field.values, self._field.first
        ug, wg = gust_at(field, first, nose, 0), gust_at(field, first, nose, 2)
        met = math.atan2(x[ac.W] + wg, x[ac.U] + ug) - math.atan2(x[ac.W], x[ac.U])
        x[ac.LAGS + nm :] = met
        wake = np.zeros((2, 64 + math.ceil(4 * c.tail_arm / (speed * DT))))
        wake[0, 0] = -self._behind
        wake[1, 0] = met
        return Memory(
            x,
            wake,
            np.zeros(3, dtype=np.int64),
            np.zeros(tables.upwash_motion.shape[1]),
            np.zeros(tables.upwash_gust.shape[1]),
            np.zeros((2, 3)),
            np.zeros(2),
        )


def _site(flight: Flight, imu_position: tuple[float, float, float]) -> Site:
    """The earth is taken round with WGS-84's radii of curvature at the origin."""
    w2 = 1 - _ECCENTRICITY2 * math.sin(ORIGIN[0]) ** 2
    return Site(
        imu_x=imu_position[0],
        imu_z=imu_position[2],
        wind_north=flight.wind_north,
        wind_east=flight.wind_east,
        heading=flight.heading,
        latitude=ORIGIN[0],
        longitude=ORIGIN[1],
        radius_north=_EQUATOR * (1 - _ECCENTRICITY2) / w2**1.5,
        radius_east=_EQUATOR / math.sqrt(w2),
    )


def fly(
    aircraft: Aircraft,
    sensors: Rig | Mapping[str, Sensor],
    card: Card,
    duration_s: float,
    seed: int | None = None,
) -> tuple[dict[str, NDArray[np.float64]], dict[str, NDArray[np.float64]]]:
    """A whole flight of a card: what the sensors show at 50 Hz, and the truth at the same instants.

    With a rig, its signals with its noise; with a mapping, every signal, perfect where the mapping has none. Both
    dictionaries hold (n,) arrays in SI; truth has "time" (s), all signals without errors, and TRUTH. `seed` replaces
    the flight's. Raises ProfileError.
    """
    place = (0.0, 0.0, 0.0)
    if isinstance(sensors, Rig):
        channels, place = sensors_of(sensors), sensors.imu_position
    else:
        channels = {name: sensors.get(name, Sensor()) for name in SIGNALS}
    seed = card.flight.seed if seed is None else seed
    simulation = Simulation(aircraft, card.flight, card.manoeuvres, place, seed)
    exact = simulation.advance(math.ceil(duration_s * TICK_HZ) * EVERY)
    shown = {name: Channel(name, s, DT, EVERY, seed).measure(exact[name]) for name, s in channels.items()}
    return shown, {name: values[::EVERY].copy() for name, values in exact.items()}
