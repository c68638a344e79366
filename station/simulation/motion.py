"""The motion of one flight, compiled: aircraft, air and vanes together, stepped at 200 Hz."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import SIGNALS, TICK_HZ
from station.numerics.atmosphere import atmosphere
from station.simulation import airframe as ac
from station.simulation.boom import VaneConstants, bending, flow_angle, second_order_step, upwash_step
from station.simulation.gusts import gust_at

RATE_HZ: Final = 200
DT: Final = 1.0 / RATE_HZ
EVERY: Final = RATE_HZ // TICK_HZ

TRUTH: Final = ("alpha", "alpha_inertial", "alpha_gust", "w_gust", "u_gust", "CL", "Cm", "elevator_drive")
"""What no sensor shows: angle of attack at the CG and its parts from motion and gust (rad), the gust at the CG (m/s,
updraught and headwind positive), the aerodynamic coefficients about the CG, and the angle (rad) that drives the
elevator's surface through its play: where the sensor is."""
COLUMNS: Final = (*SIGNALS, *TRUTH)


def places(*names: str) -> tuple[int, ...]:
    """Where columns are in a row."""
    return tuple(COLUMNS.index(name) for name in names)


_ALPHA_VANE, _BETA_VANE = places("alpha_vane", "beta_vane")
_AIRSPEED, _DYNAMIC_PRESSURE, _STATIC_PRESSURE = places("airspeed", "dynamic_pressure", "static_pressure")
(_AIR_TEMPERATURE,) = places("air_temperature")
_P, _Q, _R = places("p", "q", "r")
_AX, _AY, _AZ = places("ax", "ay", "az")
_PHI, _THETA, _PSI = places("phi", "theta", "psi")
_NORTH, _EAST, _DOWN = places("v_north", "v_east", "v_down")
_LATITUDE, _LONGITUDE, _ALTITUDE = places("latitude", "longitude", "altitude")
_ELEVATOR, _AILERON, _RUDDER = places("elevator", "aileron", "rudder")
_THRUST, _MASS = places("thrust", "mass")
_PDOT, _QDOT, _RDOT = places("pdot", "qdot", "rdot")
_ALPHA, _INERTIAL, _GUST, _W_GUST, _U_GUST, _CL, _CM, _DRIVE = places(*TRUTH)


class Site(NamedTuple):
    """The imu's place, the mean wind, the heading and the earth under the flight; m, m/s, rad."""

    imu_x: float
    imu_y: float
    imu_z: float
    wind_north: float
    wind_east: float
    heading: float
    latitude: float
    longitude: float
    radius_north: float
    radius_east: float


class Memory(NamedTuple):
    """What a flight carries from one step to the next, changed in place by `advance`."""

    x: NDArray[np.float64]
    """State of the equations of motion."""
    wake: NDArray[np.float64]
    """(2, n) ring: distance at which the wing was, and its incidence from trim there."""
    marks: NDArray[np.int64]
    """Steps done, last entry of the wake, entry of the wake whose downwash is at the tail."""
    upwash_motion: NDArray[np.float64]
    upwash_gust: NDArray[np.float64]
    vane: NDArray[np.float64]
    """(3, 3): states of the alpha and beta vanes and of the boom's bending."""
    last: NDArray[np.float64]
    """Inertial and leading-edge gust incidence and the elevator's surface at the last step, rad."""


class Tables(NamedTuple):
    """Indicial responses, each (2, n)."""

    lift_motion: NDArray[np.float64]
    lift_gust: NDArray[np.float64]
    upwash_motion: NDArray[np.float64]
    upwash_gust: NDArray[np.float64]


@njit(cache=True, error_model="numpy")
def at_rest(c: ac.Constants, tables: Tables, behind: float, field: NDArray[np.float64], first: int) -> Memory:
    """Trimmed flight, the wing's memory of gusts as if the one at the start had lasted.

    `behind`: where the wake begins, m behind the origin; farther than the tail.
    """
    nm, ng = tables.lift_motion.shape[1], tables.lift_gust.shape[1]
    x = ac.trimmed_state(c, nm + ng)
    nose = c.gust_edge
    ug, wg = gust_at(field, first, nose, 0), gust_at(field, first, nose, 2)
    met = math.atan2(x[ac.W] + wg, x[ac.U] + ug) - math.atan2(x[ac.W], x[ac.U])
    x[ac.LAGS + nm :] = met
    wake = np.zeros((2, 64 + math.ceil(4 * c.tail_arm / (c.trim_speed * DT))))
    wake[0, 0] = -behind
    wake[1, 0] = met
    return Memory(
        x,
        wake,
        np.zeros(3, dtype=np.int64),
        np.zeros(tables.upwash_motion.shape[1]),
        np.zeros(tables.upwash_gust.shape[1]),
        np.zeros((3, 3)),
        np.array([0.0, 0.0, c.trim_elevator]),
    )


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


# This and what follows is inlined: a call would copy all the constants, which takes as long as using them.
@njit(cache=True, error_model="numpy", inline="always")
def stage_rates(
    c: ac.Constants,
    tables: Tables,
    x: NDArray[np.float64],
    command: float,
    field: NDArray[np.float64],
    first: int,
    air: tuple[float, float, float],
    memory: Memory,
    side: float,
    dx: NDArray[np.float64],
    aux: NDArray[np.float64],
) -> int:
    """The state's derivative with the gusts and the downwash where each part of the aircraft is. `side`: the sideways
    velocity relative to the air, m/s."""
    s = x[ac.DISTANCE]
    nose, tail = s + c.gust_edge, s - c.tail_arm
    late = s - c.gust_arm
    gust = (
        gust_at(field, first, s, 0),
        gust_at(field, first, s, 2),
        gust_at(field, first, nose, 0),
        gust_at(field, first, nose, 2),
        gust_at(field, first, late, 0),
        gust_at(field, first, late, 2),
    )
    past, entry = _downwash_source(memory.wake, memory.marks[1], memory.marks[2], tail - c.downwash_delay * x[ac.U])
    surface = memory.last[2]
    ac.rates(c, tables.lift_motion, tables.lift_gust, x, command, air, gust, past, side, surface, dx, aux)
    return entry


@njit(cache=True, error_model="numpy", inline="always")
def record(
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
    pressure, temperature, _ = atmosphere(height)
    north = x[ac.DISTANCE] * math.cos(site.heading) + site.wind_north * time
    east = x[ac.DISTANCE] * math.sin(site.heading) + site.wind_east * time
    latitude = site.latitude + north / site.radius_north
    row[_ALPHA_VANE], row[_BETA_VANE] = vanes
    row[_AIRSPEED], row[_DYNAMIC_PRESSURE] = aux[ac.AIRSPEED], aux[ac.PRESSURE]
    row[_STATIC_PRESSURE], row[_AIR_TEMPERATURE] = pressure, temperature
    row[_P], row[_Q], row[_R] = 0.0, q, 0.0
    row[_AX] = aux[ac.FORCE_X] + dx[ac.Q] * site.imu_z - q * q * site.imu_x
    row[_AY] = 0.0
    row[_AZ] = aux[ac.FORCE_Z] - dx[ac.Q] * site.imu_x - q * q * site.imu_z
    row[_PHI], row[_THETA], row[_PSI] = 0.0, theta, site.heading
    row[_NORTH] = dx[ac.DISTANCE] * math.cos(site.heading) + site.wind_north
    row[_EAST] = dx[ac.DISTANCE] * math.sin(site.heading) + site.wind_east
    row[_DOWN] = -dx[ac.HEIGHT]
    row[_LATITUDE] = latitude
    row[_LONGITUDE] = site.longitude + east / (site.radius_east * math.cos(0.5 * (latitude + site.latitude)))
    row[_ALTITUDE] = height
    row[_ELEVATOR], row[_AILERON], row[_RUDDER] = aux[ac.SURFACE], 0.0, 0.0
    row[_THRUST], row[_MASS] = x[ac.THRUST], c.mass
    row[_PDOT], row[_QDOT], row[_RDOT] = 0.0, dx[ac.Q], 0.0
    row[_ALPHA], row[_INERTIAL] = aux[ac.ALPHA], aux[ac.ALPHA_INERTIAL]
    row[_GUST] = aux[ac.ALPHA] - aux[ac.ALPHA_INERTIAL]
    row[_W_GUST], row[_U_GUST], row[_CL], row[_CM] = gust[1], gust[0], aux[ac.CL], aux[ac.CM]
    row[_DRIVE] = x[ac.ELEVATOR]


@njit(cache=True, error_model="numpy", nogil=True)
def advance(
    c: ac.Constants,
    tables: Tables,
    vane: VaneConstants,
    site: Site,
    memory: Memory,
    command: NDArray[np.float64],
    field: NDArray[np.float64],
    first: int,
    every: int,
    out: NDArray[np.float64],
) -> None:
    """Step on by every * len(out) steps of DT: classical Runge-Kutta of fourth order.

    command (2n + 1): commanded elevator at steps and half-steps. out (., len(COLUMNS)): the instants before the steps,
    every `every`-th of them.
    """
    x, marks = memory.x, memory.marks
    n = x.shape[0]
    slope, total, trial = np.zeros(n), np.zeros(n), np.zeros(n)
    aux, spare = np.zeros(ac.AUX_SIZE), np.zeros(ac.AUX_SIZE)
    ring = memory.wake.shape[1]
    for k in range(every * out.shape[0]):
        air = ac.air_at(c, x[ac.HEIGHT])
        s = x[ac.DISTANCE]
        for i in range(n):
            trial[i] = x[i]
            total[i] = 0.0
        for stage in range(4):
            entry = stage_rates(
                c,
                tables,
                trial,
                command[2 * k + (stage + 1) // 2],
                field,
                first,
                air,
                memory,
                0.0,
                slope,
                aux if stage == 0 else spare,
            )
            if stage == 0:
                marks[2] = entry
                memory.last[2] = aux[ac.SURFACE]
                vanes = vanes_now(c.memory_chord, tables, vane, memory, field, first, (slope[ac.Q], 0.0, 0.0), aux)
                if k % every == 0:
                    here = (gust_at(field, first, s, 0), gust_at(field, first, s, 2))
                    record(c, site, marks[0] * DT, x, slope, aux, here, vanes, out[k // every])
                marks[0] += 1
                marks[1] += 1
                memory.wake[0, marks[1] % ring] = s
                memory.wake[1, marks[1] % ring] = aux[ac.WING]
            weight = DT / 6.0 if stage == 0 or stage == 3 else DT / 3.0
            ahead = DT if stage == 2 else 0.5 * DT
            for i in range(n):
                total[i] += weight * slope[i]
                trial[i] = x[i] + ahead * slope[i]
        for i in range(n):
            x[i] += total[i]


@njit(cache=True, error_model="numpy", inline="always")
def vanes_now(
    chord: float,
    tables: Tables,
    vane: VaneConstants,
    memory: Memory,
    field: NDArray[np.float64],
    first: int,
    moving: tuple[float, float, float],
    aux: NDArray[np.float64],
) -> tuple[float, float]:
    """The angles that both vanes show now, rad, from the flow at the last step and at this one.

    `chord`: what the upwash's memory is counted in, m. `moving`: pitch acceleration (rad/s2), and how much faster than
    pitching alone makes it the vane moves sideways and down, m/s.
    """
    x = memory.x
    s, alpha_i, gust_le = x[ac.DISTANCE], aux[ac.ALPHA_INERTIAL], aux[ac.GUST_LE]
    begins = memory.marks[0] == 0
    if begins:
        memory.last[0], memory.last[1] = alpha_i, gust_le
        memory.upwash_motion[:] = alpha_i
        memory.upwash_gust[:] = gust_le
    chords = aux[ac.AIRSPEED] * DT / chord
    wing = upwash_step(tables.upwash_motion, memory.upwash_motion, memory.last[0], alpha_i, chords)
    wing += upwash_step(tables.upwash_gust, memory.upwash_gust, memory.last[1], gust_le, chords)
    memory.last[0], memory.last[1] = alpha_i, gust_le
    met = s + vane.gust_x
    ug, wg = gust_at(field, first, met, 0), gust_at(field, first, met, 2)
    speed = aux[ac.AIRSPEED]
    flow = flow_angle(vane, x[ac.U], x[ac.W] + moving[2], x[ac.Q], ug, wg, wing)
    flow += bending(vane, memory.vane[2], begins, aux[ac.FORCE_Z], moving[0], aux[ac.PRESSURE], speed, flow)
    side = math.asin((gust_at(field, first, met, 1) + moving[1]) / speed)
    if begins:
        memory.vane[0, 0], memory.vane[0, 2] = flow, flow
        memory.vane[1, 0], memory.vane[1, 2] = side, side
    shown = second_order_step(vane.dynamics, memory.vane[0], flow) + vane.zero
    return shown, second_order_step(vane.dynamics, memory.vane[1], side)
