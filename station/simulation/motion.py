"""The motion of one flight, compiled: aircraft, air and vanes together, stepped at its vane's interval."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import ENGINE_SIGNALS, SIGNALS, TICK_HZ
from station.numerics.atmosphere import atmosphere
from station.simulation import longitudinal as eq
from station.simulation.airframe import Constants, Tables
from station.simulation.boom import (
    VaneConstants,
    bending,
    flow_angle,
    second_order_step,
    settle,
    tip_force,
    upwash_step,
)
from station.simulation.gusts import ALONG, SIDEWAYS, UP, Field, gust_at
from station.simulation.pilot import RATE_HZ, Hands, asked, ring, rings
from station.simulation.stalling import BRIEF, attached
from station.simulation.truth import TRUTH

DT: Final = 1.0 / RATE_HZ
"""Of a step where nothing from outside is in the loop, s."""
EVERY: Final = RATE_HZ // TICK_HZ

FLOWN: Final = tuple(name for name in SIGNALS if name not in ENGINE_SIGNALS)
"""Signals that every simulated flight has; an engine's come with the profile's engine (engine_setting.py)."""
COLUMNS: Final = (*FLOWN, *TRUTH)


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
_ALPHA, _INERTIAL, _GUST, _W_GUST, _U_GUST, _CL, _CM, _DRIVE, _AZ_BOOM, _SECOND_VANE = places(*TRUTH)


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


class Flown(NamedTuple):
    """An aircraft and where it flies."""

    constants: Constants
    tables: Tables
    vane: VaneConstants
    second: VaneConstants
    """A further one; `there` or not."""
    site: Site
    hands: Hands


DONE, NEWEST, AT_TAIL, AT_FIN = range(4)
"""Memory.marks: steps done, last entry of the wake, entries of the wake whose downwash is at the tail and whose
sidewash is at the fin."""
DISTANCE, INCIDENCE, SIDESLIP = range(3)
"""Memory.wake: where the wing was, m, its incidence from trim there and the sideslip, rad."""
INERTIAL, GUST, SURFACE, ALPHA, TURNING, ATTACHED = range(6)
"""Memory.last: inertial and leading-edge gust incidence and the elevator's surface at the last step, rad; angle of
attack (rad) and its rate (rad/s) there; the share of the wing's chord along which the flow is attached."""


class Memory(NamedTuple):
    """What a flight carries from one step to the next, changed in place by `advance`."""

    x: NDArray[np.float64]
    """State of the equations of motion."""
    wake: NDArray[np.float64]
    """(3, n): a ring of the places that the wing has passed."""
    marks: NDArray[np.int64]
    """(4,)."""
    upwash_motion: NDArray[np.float64]
    upwash_gust: NDArray[np.float64]
    alpha_vane: NDArray[np.float64]
    """(3,): of a second-order system, as those of the beta vane and of the boom's bending."""
    beta_vane: NDArray[np.float64]
    boom: NDArray[np.float64]
    second: NDArray[np.float64]
    """(2, 3): of the second vane and of what it sits on."""
    last: NDArray[np.float64]
    """(6,)."""
    asked: NDArray[np.float64]
    """pilot.ring's."""
    across: NDArray[np.float64]
    """pilot.rings'."""


def memory_of(x: NDArray[np.float64], entries: int, tables: Tables, surface: float, hands: Hands) -> Memory:
    """Nothing remembered yet; `entries` of the wake."""
    return Memory(
        x,
        np.zeros((3, entries)),
        np.zeros(4, dtype=np.int64),
        np.zeros(tables.upwash_motion.shape[1]),
        np.zeros(tables.upwash_gust.shape[1]),
        np.zeros(3),
        np.zeros(3),
        np.zeros(3),
        np.zeros((2, 3)),
        np.array([0.0, 0.0, surface, math.atan2(x[eq.W], x[eq.U]), 0.0, 1.0]),
        ring(hands),
        rings(hands),
    )


def at_rest(c: Constants, tables: Tables, behind: float, field: Field, hands: Hands, dt: float = DT) -> Memory:
    """Trimmed flight, the wing's response to gusts as if the one at the start had lasted.

    `behind`: where the wake begins, m behind the origin; farther than the tail. `dt`: of a step, s.
    """
    motions, gusts = tables.lift_motion.shape[1], tables.lift_gust.shape[1]
    x = eq.trimmed_state(c, motions + gusts)
    meets = field.meets
    ug, wg = gust_at(field, c.gust_edge, meets.u_wing), gust_at(field, c.gust_edge, meets.w_wing)
    met = math.atan2(x[eq.W] + wg, x[eq.U] + ug) - math.atan2(x[eq.W], x[eq.U])
    x[eq.LAGS + motions :] = met
    memory = memory_of(x, 64 + math.ceil(4 * behind / (c.trim_speed * dt)), tables, c.trim_elevator, hands)
    memory.wake[DISTANCE, 0] = -behind
    memory.wake[INCIDENCE, 0] = met
    memory.wake[SIDESLIP, 0] = math.atan2(gust_at(field, 0.0, SIDEWAYS), c.trim_speed)
    memory.last[ALPHA] += met
    memory.last[ATTACHED] = steadily_attached(c, memory.last[ALPHA])
    return memory


@njit(cache=True, error_model="numpy")
def passed(wake: NDArray[np.float64], row: int, newest: int, start: int, place: float) -> tuple[float, int]:
    """INCIDENCE or SIDESLIP, `row`, when the wing was at `place`, and the ring entry before it; the search begins at
    `start`."""
    n = wake.shape[1]
    j = start
    while j < newest and wake[DISTANCE, (j + 1) % n] <= place:
        j += 1
    a = j % n
    if j >= newest:
        return wake[row, a], j
    b = (j + 1) % n
    part = min(max((place - wake[DISTANCE, a]) / (wake[DISTANCE, b] - wake[DISTANCE, a]), 0.0), 1.0)
    return wake[row, a] + part * (wake[row, b] - wake[row, a]), j


# This and what follows is inlined: a call would copy all the constants, which takes as long as using them.
@njit(cache=True, error_model="numpy", inline="always")
def stage_rates(
    flown: Flown, memory: Memory, field: Field, air: eq.Air, x: NDArray[np.float64], command: float, side: float,
    dx: NDArray[np.float64],
) -> tuple[eq.Flow, eq.Gust, int]:  # fmt: skip
    """The state's derivative with the gusts and the downwash where each part of the aircraft is.

    `side`: the sideways velocity relative to the air, m/s. Returns the quantities on the way, the gusts, and the entry
    of the wake whose downwash is at the tail.
    """
    c = flown.constants
    s = x[eq.DISTANCE]
    nose, tail, late = s + c.gust_edge, s - c.tail_arm, s - c.gust_arm
    meets = field.meets
    gust = eq.Gust(
        gust_at(field, s, ALONG),
        gust_at(field, s, UP),
        gust_at(field, nose, meets.u_wing),
        gust_at(field, nose, meets.w_wing),
        gust_at(field, late, meets.u_tail),
        gust_at(field, late, meets.w_tail),
    )
    marks = memory.marks
    place = tail - c.downwash_delay * x[eq.U]
    past, entry = passed(memory.wake, INCIDENCE, marks[NEWEST], marks[AT_TAIL], place)
    met = eq.Met(air, gust, side, past, memory.last[SURFACE], command, memory.last[ATTACHED])
    return eq.rates(c, flown.tables, x, met, dx), gust, entry


def steadily_attached(c: Constants, alpha: float) -> float:
    """Share of the chord along which the flow is attached when the angle of attack (rad) has lasted."""
    return float(attached(alpha, c.sharpness, c.alpha_star)) if c.separates > 0.0 else 1.0


@njit(cache=True, error_model="numpy")
def _separate(c: Constants, dt: float, last: NDArray[np.float64], alpha: float, speed: float) -> None:
    """The flow along the wing goes on by a step of `dt` s, at an angle of attack (rad) and airspeed."""
    brief = min(dt / BRIEF, 1.0)
    last[TURNING] += brief * ((alpha - last[ALPHA]) / dt - last[TURNING])
    last[ALPHA] = alpha
    chords = dt * speed / c.chord
    delay = c.leave_delay if last[TURNING] > 0.0 else c.return_delay
    late = delay * c.chord / speed * last[TURNING]
    towards = attached(alpha - late, c.sharpness, c.alpha_star)
    share = 1.0 - math.exp(-chords / c.separation_lag) if c.separation_lag > 0.0 else 1.0
    last[ATTACHED] += share * (towards - last[ATTACHED])


@njit(cache=True, error_model="numpy", inline="always")
def remember(c: Constants, dt: float, memory: Memory, distance: float, flow: eq.Flow) -> None:
    """A step of `dt` s begins, with the wing at that distance."""
    memory.marks[DONE] += 1
    memory.marks[NEWEST] += 1
    at = memory.marks[NEWEST] % memory.wake.shape[1]
    memory.wake[DISTANCE, at] = distance
    memory.wake[INCIDENCE, at] = flow.wing
    if c.separates > 0.0:
        _separate(c, dt, memory.last, flow.alpha, flow.airspeed)


@njit(cache=True, error_model="numpy", inline="always")
def record(
    flown: Flown, time: float, x: NDArray[np.float64], dx: NDArray[np.float64], flow: eq.Flow, gust: eq.Gust,
    tip: tuple[float, float, float, float], row: NDArray[np.float64],
) -> None:  # fmt: skip
    """Everything there is to know at one instant, in the order of COLUMNS; `tip`: what tip_now gives."""
    site = flown.site
    q, theta, height = x[eq.Q], x[eq.THETA], x[eq.HEIGHT]
    pressure, temperature, _ = atmosphere(height)
    north = x[eq.DISTANCE] * math.cos(site.heading) + site.wind_north * time
    east = x[eq.DISTANCE] * math.sin(site.heading) + site.wind_east * time
    latitude = site.latitude + north / site.radius_north
    row[_ALPHA_VANE], row[_BETA_VANE], row[_AZ_BOOM], row[_SECOND_VANE] = tip
    row[_AIRSPEED], row[_DYNAMIC_PRESSURE] = flow.airspeed, flow.pressure
    row[_STATIC_PRESSURE], row[_AIR_TEMPERATURE] = pressure, temperature
    row[_P], row[_Q], row[_R] = 0.0, q, 0.0
    row[_AX] = flow.force_x + dx[eq.Q] * site.imu_z - q * q * site.imu_x
    row[_AY] = 0.0
    row[_AZ] = flow.force_z - dx[eq.Q] * site.imu_x - q * q * site.imu_z
    row[_PHI], row[_THETA], row[_PSI] = 0.0, theta, site.heading
    row[_NORTH] = dx[eq.DISTANCE] * math.cos(site.heading) + site.wind_north
    row[_EAST] = dx[eq.DISTANCE] * math.sin(site.heading) + site.wind_east
    row[_DOWN] = -dx[eq.HEIGHT]
    row[_LATITUDE] = latitude
    row[_LONGITUDE] = site.longitude + east / (site.radius_east * math.cos(0.5 * (latitude + site.latitude)))
    row[_ALTITUDE] = height
    row[_ELEVATOR], row[_AILERON], row[_RUDDER] = flow.surface, 0.0, 0.0
    row[_THRUST], row[_MASS] = x[eq.THRUST], flown.constants.mass
    row[_PDOT], row[_QDOT], row[_RDOT] = 0.0, dx[eq.Q], 0.0
    row[_ALPHA], row[_INERTIAL] = flow.alpha, flow.alpha_inertial
    row[_GUST] = flow.alpha - flow.alpha_inertial
    row[_W_GUST], row[_U_GUST], row[_CL], row[_CM] = gust.w, gust.u, flow.cl, flow.cm
    row[_DRIVE] = x[eq.ELEVATOR]


@njit(cache=True, error_model="numpy", inline="always")
def held_elevator(hands: Hands, memory: Memory, field: Field, side: float) -> float:
    """What feedback asks of the elevator at a step, rad; `side`: the sideways velocity through the air mass,
    m/s: what a side gust adds to the airspeed is less than its sensor's noise."""
    x, speed = memory.x, hands.speed
    if hands.by_speed > 0.0:
        u, w = x[eq.U] + gust_at(field, x[eq.DISTANCE], ALONG), x[eq.W] + gust_at(field, x[eq.DISTANCE], UP)
        speed = math.sqrt(u * u + side * side + w * w)
    return asked(hands, memory.asked, memory.marks[DONE], x[eq.Q], x[eq.THETA], x[eq.HEIGHT], speed)


STAGES: Final = 4


@njit(cache=True, error_model="numpy", inline="always")
def runge_kutta(dt: float) -> tuple[tuple[float, float, float, float], tuple[float, float, float, float]]:
    """Of fourth order, classical: what each stage's slope counts, and how far ahead of the step's begin the next stage
    is, s."""
    return (dt / 6.0, dt / 3.0, dt / 3.0, dt / 6.0), (0.5 * dt, 0.5 * dt, dt, 0.0)


@njit(cache=True, error_model="numpy", nogil=True)
def advance(
    flown: Flown, memory: Memory, command: NDArray[np.float64], field: Field, every: int, out: NDArray[np.float64]
) -> None:
    """Step on by every * len(out) steps: classical Runge-Kutta of fourth order.

    command (2n + 1): commanded elevator at steps and half-steps, beside feedback. out (., len(COLUMNS)): the instants
    before the steps, every `every`-th of them.
    """
    c, x, marks, dt = flown.constants, memory.x, memory.marks, flown.vane.dt
    weights, ahead = runge_kutta(dt)
    n = x.shape[0]
    slope, total, trial = np.zeros(n), np.zeros(n), np.zeros(n)
    for k in range(every * out.shape[0]):
        air = eq.air_at(c, x[eq.HEIGHT])
        held = held_elevator(flown.hands, memory, field, 0.0)
        for i in range(n):
            trial[i] = x[i]
            total[i] = 0.0
        for stage in range(STAGES):
            wanted = command[2 * k + (stage + 1) // 2] + held
            flow, gust, entry = stage_rates(flown, memory, field, air, trial, wanted, 0.0, slope)
            if stage == 0:
                marks[AT_TAIL] = entry
                memory.last[SURFACE] = flow.surface
                moving = (slope[eq.Q], 0.0, 0.0)
                vanes = (flown.vane, flown.second)
                tip = tip_now(c.indicial_chord, flown.tables, vanes, memory, field, moving, flow)
                if k % every == 0:
                    record(flown, marks[DONE] * dt, x, slope, flow, gust, tip, out[k // every])
                remember(c, dt, memory, x[eq.DISTANCE], flow)
            for i in range(n):
                total[i] += weights[stage] * slope[i]
                trial[i] = x[i] + ahead[stage] * slope[i]
        for i in range(n):
            x[i] += total[i]


@njit(cache=True, error_model="numpy", inline="always")
def tip_now(
    chord: float, tables: Tables, vanes: tuple[VaneConstants, VaneConstants], memory: Memory, field: Field,
    moving: tuple[float, float, float], flow: eq.Flow,
) -> tuple[float, float, float, float]:  # fmt: skip
    """The angles that the vanes of alpha and beta show now, rad, from the flow at the last step and at this one, the
    specific force down there, m/s2, and what a second vane of alpha shows, rad; NaN without one.

    `chord`: what the times of the upwash's responses are counted in, m. `moving`: pitch acceleration (rad/s2), how fast
    the vane moves sideways (m/s), and the roll rate (rad/s).
    """
    vane, second = vanes
    x, last = memory.x, memory.last
    begins = memory.marks[DONE] == 0
    if begins:
        last[INERTIAL], last[GUST] = flow.alpha_inertial, flow.gust_edge
        memory.upwash_motion[:] = flow.alpha_inertial
        memory.upwash_gust[:] = flow.gust_edge
    chords = flow.airspeed * vane.dt / chord
    wing = upwash_step(tables.upwash_motion, memory.upwash_motion, last[INERTIAL], flow.alpha_inertial, chords)
    wing += upwash_step(tables.upwash_gust, memory.upwash_gust, last[GUST], flow.gust_edge, chords)
    last[INERTIAL], last[GUST] = flow.alpha_inertial, flow.gust_edge
    met, meets = x[eq.DISTANCE] + vane.gust_x, field.meets
    side = math.asin((gust_at(field, met, meets.v_boom) + moving[1]) / flow.airspeed) * (1.0 + vane.sidewash)
    if begins:
        settle(memory.beta_vane, side)
    gust = gust_at(field, met, meets.u_boom), gust_at(field, met, meets.w_boom)
    shown = _alpha_shown(vane, (memory.alpha_vane, memory.boom), begins, x, gust, moving, wing, flow)
    felt = tip_force(vane, memory.boom, flow.force_z, x[eq.Q], moving[0])
    other = math.nan
    if second.there:
        met = x[eq.DISTANCE] + second.gust_x
        gust = gust_at(field, met, meets.u_second), gust_at(field, met, meets.w_second)
        other = _alpha_shown(second, (memory.second[0], memory.second[1]), begins, x, gust, moving, wing, flow)
    return shown, second_order_step(vane.dynamics, memory.beta_vane, side), felt, other


@njit(cache=True, error_model="numpy")
def _alpha_shown(
    vane: VaneConstants, states: tuple[NDArray[np.float64], NDArray[np.float64]], begins: bool,
    x: NDArray[np.float64], gust: tuple[float, float], moving: tuple[float, float, float], wing: float, flow: eq.Flow,
) -> float:  # fmt: skip
    """One vane's angle, rad. `states`: its own and that of what it sits on; `gust`: u and w there, m/s; `wing`:
    incidence behind the wing's upwash, rad; `moving` as tip_now's."""
    angle = flow_angle(vane, x[eq.U], x[eq.W], x[eq.Q], gust[0], gust[1], wing, moving[2])
    angle += bending(vane, states[1], begins, flow.force_z, moving[0], flow.pressure, flow.airspeed, angle)
    if begins:
        settle(states[0], angle)
    return second_order_step(vane.dynamics, states[0], angle) + vane.zero
