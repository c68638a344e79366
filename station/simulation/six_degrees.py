"""Six degrees of freedom: the longitudinal equations with sideslip, roll and yaw added to them.

The longitudinal part is `longitudinal.rates` itself, so that without lateral motion the flight is the three-degree-of-
freedom one. Forces: side_flow; rigid body: Stevens and Lewis 2003. Of air that is a line, side gusts act at the CG and
the air does not roll; of air that is a plane, wing, fin and boom meet their own. A pilot levels the wings and holds the
heading with slow ailerons.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import G0, SURFACES
from station.profile import Aircraft, Flight, Manoeuvre, Order, Pilot
from station.simulation import longitudinal as eq
from station.simulation.airframe import Constants
from station.simulation.flown_aircraft import FlownAircraft
from station.simulation.gusts import Field
from station.simulation.legs import BANK as MOST_BANK
from station.simulation.legs import without_legs
from station.simulation.manoeuvres import surface_input
from station.simulation.motion import (
    AT_FIN,
    AT_TAIL,
    COLUMNS,
    DONE,
    DT,
    EVERY,
    NEWEST,
    SIDESLIP,
    STAGES,
    SURFACE,
    Flown,
    Memory,
    Site,
    at_rest,
    held_elevator,
    places,
    record,
    remember,
    runge_kutta,
    stage_rates,
    tip_now,
)
from station.simulation.pilot import asked_across
from station.simulation.side_flow import (
    AILERON,
    BANK,
    EAST,
    HELD,
    HOLD_LAG,
    NORTH,
    ROLL,
    RUDDER,
    SIDE,
    SIZE,
    TURN,
    YAW,
    Lateral,
    SideAir,
    SideFlow,
    lateral_constants,
    side_air,
    side_flow,
)
from station.simulation.three_degrees import BLOCK, HANDS_OFF, SPEED_MARGIN, gusts_of, tremor, tremors_across
from station.simulation.trigonometry import sine_cosine
from station.simulation.truth import LATERAL_TRUTH

LATERAL_COLUMNS: Final = (*COLUMNS, *LATERAL_TRUTH)

_P, _R, _AX, _AY, _AZ, _PHI, _PSI = places("p", "r", "ax", "ay", "az", "phi", "psi")
_V_NORTH, _V_EAST, _LATITUDE, _LONGITUDE = places("v_north", "v_east", "latitude", "longitude")
_AILERON, _RUDDER, _PDOT, _RDOT = places("aileron", "rudder", "pdot", "rdot")
_BETA, _CY, _CROLL, _CN, _V_GUST, _P_GUST, _R_GUST, _BETA_FIN = (LATERAL_COLUMNS.index(n) for n in LATERAL_TRUTH)


class Both(NamedTuple):
    """The longitudinal and the lateral state, or their derivatives."""

    along: NDArray[np.float64]
    across: NDArray[np.float64]


@njit(cache=True, error_model="numpy", inline="always")
def _wanted_bank(side: Lateral, by_heading: float, turned: float) -> float:
    """Of a turn its own, otherwise by what the heading is off, rad."""
    bank = side.bank
    if math.isnan(bank):
        bank = min(max(by_heading * (side.turn - turned), -MOST_BANK), MOST_BANK)
    return bank


@njit(cache=True, error_model="numpy", inline="always")
def add_lateral(
    c: Constants, side: Lateral, heading: float, state: Both, commands: tuple[float, float], air: SideAir,
    slope: Both, flow: eq.Flow,
) -> SideFlow:  # fmt: skip
    """The lateral state's derivative into `slope`, and what it changes of the longitudinal one's there.

    The latter and `flow` as `longitudinal.rates` leaves them; `heading`: where the flight began, rad; `commands`:
    aileron and rudder, rad; `air`: what is met sideways.
    """
    x, y, dx, dy = state.along, state.across, slope.along, slope.across
    u, w, q, theta = x[eq.U], x[eq.W], x[eq.Q], x[eq.THETA]
    v, p, r = y[SIDE], y[ROLL], y[YAW]
    seen = side_flow(c, side, y, air, flow)
    force = flow.pressure * c.area
    rolling, yawing = force * side.span * seen.cl, force * side.span * seen.cn

    sin_t, cos_t = sine_cosine(theta)
    sin_b, cos_b = sine_cosine(y[BANK])
    dx[eq.U] += r * v
    dx[eq.W] += G0 * cos_t * (cos_b - 1.0) - p * v
    dx[eq.Q] += ((side.izz - side.ixx) * p * r - side.ixz * (p * p - r * r)) / c.iyy
    dx[eq.THETA] = q * cos_b - r * sin_b
    across = v * sin_b + w * cos_b
    dx[eq.DISTANCE] = u * cos_t + across * sin_t
    dx[eq.HEIGHT] = u * sin_t - across * cos_t

    dy[SIDE] = seen.force_y + p * w - r * u + G0 * cos_t * sin_b
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
    dy[NORTH] = dx[eq.DISTANCE] * cos_h - to_the_right * sin_h
    dy[EAST] = dx[eq.DISTANCE] * sin_h + to_the_right * cos_h
    for i in range(2):
        lag, rate, travel = side.actuators[i]
        wanted = commands[i] + (y[HELD] if i == 0 else 0.0)
        wanted = min(max(wanted, -travel), travel)
        dy[AILERON + i] = min(max((wanted - y[AILERON + i]) / lag, -rate), rate)
    # A positive aileron rolls left.
    bank = _wanted_bank(side, side.hold_heading, y[TURN])
    dy[HELD] = (side.hold_bank * (y[BANK] - bank) - y[HELD]) / HOLD_LAG
    return seen


@njit(cache=True, error_model="numpy", inline="always")
def _record_lateral(
    site: Site, time: float, state: Both, slope: Both, flow: eq.Flow, sideways: tuple[SideFlow, SideAir],
    row: NDArray[np.float64],
) -> None:  # fmt: skip
    """What lateral motion changes of a row that `motion.record` wrote, and its own truth."""
    seen, met = sideways
    y, dy = state.across, slope.across
    p, q, r = y[ROLL], state.along[eq.Q], y[YAW]
    pdot, qdot, rdot = dy[ROLL], slope.along[eq.Q], dy[YAW]
    i, j, k = site.imu_x, site.imu_y, site.imu_z
    row[_P], row[_R] = p, r
    row[_AX] = flow.force_x + qdot * k - rdot * j + p * (q * j + r * k) - (q * q + r * r) * i
    row[_AY] = seen.force_y + rdot * i - pdot * k + q * (p * i + r * k) - (p * p + r * r) * j
    row[_AZ] = flow.force_z + pdot * j - qdot * i + r * (p * i + q * j) - (p * p + q * q) * k
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
    row[_BETA], row[_CY], row[_CROLL], row[_CN] = seen.beta, seen.cy, seen.cl, seen.cn
    row[_V_GUST], row[_P_GUST], row[_R_GUST], row[_BETA_FIN] = met.speed - y[SIDE], met.roll, met.yaw, seen.fin


@njit(cache=True, error_model="numpy")
def advance_lateral(
    flown: Flown, side: Lateral, memory: Memory, y: NDArray[np.float64], commands: NDArray[np.float64], field: Field,
    out: NDArray[np.float64],
) -> None:  # fmt: skip
    """Step on by len(out) steps: classical Runge-Kutta of fourth order.

    y (SIZE): the lateral state, changed in place. commands (3, 2n + 1): elevator, aileron and rudder at steps and
    half-steps. out (n, len(LATERAL_COLUMNS)): the instants before the steps.
    """
    c, x, marks, dt = flown.constants, memory.x, memory.marks, flown.vane.dt
    weights, ahead = runge_kutta(dt)
    n = x.shape[0]
    now, trial, slope = Both(x, y), Both(np.zeros(n), np.zeros(SIZE)), Both(np.zeros(n), np.zeros(SIZE))
    total = Both(np.zeros(n), np.zeros(SIZE))
    for k in range(out.shape[0]):
        air = eq.air_at(c, x[eq.HEIGHT])
        banked = _wanted_bank(side, flown.hands.by_heading, y[TURN])
        across = asked_across(flown.hands, memory.across, marks[DONE], y[ROLL], y[YAW], y[BANK], banked)
        held = held_elevator(flown.hands, memory, field, y[SIDE])
        # By loops: numba takes seconds to compile the check of two arrays' shapes.
        for i in range(n):
            trial.along[i], total.along[i] = x[i], 0.0
        for i in range(SIZE):
            trial.across[i], total.across[i] = y[i], 0.0
        for stage in range(STAGES):
            at = 2 * k + (stage + 1) // 2
            met, at_fin = side_air(c, side, memory, field, trial.along, trial.across)
            flow, gust, entry = stage_rates(
                flown, memory, field, air, trial.along, commands[0, at] + held, met.speed, slope.along
            )
            surfaces = (commands[1, at] + across[0], commands[2, at] + across[1])
            seen = add_lateral(c, side, flown.site.heading, trial, surfaces, met, slope, flow)
            if stage == 0:
                marks[AT_TAIL], marks[AT_FIN] = entry, at_fin
                memory.last[SURFACE] = flow.surface
                vane = flown.vane
                sideways = y[SIDE] + y[YAW] * vane.x - y[ROLL] * vane.z
                moving = (slope.along[eq.Q], sideways, y[ROLL])
                tip = tip_now(c.indicial_chord, flown.tables, (vane, flown.second), memory, field, moving, flow)
                record(flown, marks[DONE] * dt, x, slope.along, flow, gust, tip, out[k])
                _record_lateral(flown.site, marks[DONE] * dt, now, slope, flow, (seen, met), out[k])
                remember(c, dt, memory, x[eq.DISTANCE], flow)
                memory.wake[SIDESLIP, marks[NEWEST] % memory.wake.shape[1]] = seen.beta
            for i in range(n):
                total.along[i] += weights[stage] * slope.along[i]
                trial.along[i] = x[i] + ahead[stage] * slope.along[i]
            for i in range(SIZE):
                total.across[i] += weights[stage] * slope.across[i]
                trial.across[i] = y[i] + ahead[stage] * slope.across[i]
        for i in range(n):
            x[i] += total.along[i]
        for i in range(SIZE):
            y[i] += total.across[i]


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
        pilot: Pilot = HANDS_OFF,
    ) -> None:
        """As Simulation's; `hold` also levels the wings. Raises ProfileError."""
        self.aircraft = FlownAircraft(aircraft, flight, imu_position, hold, pilot, seed=seed)
        self._tremor = tremor(flight, pilot, seed)
        self._across = tremors_across(flight, pilot, seed)
        self._shakes: NDArray[np.float64] = np.empty((2, 0))
        self._hold = hold = hold and not pilot.bank
        self._apart = flight.is_plane
        self.lateral = lateral_constants(self.aircraft.now, hold, apart=self._apart)
        self._manoeuvres = tuple(manoeuvres)
        self._asked: Sequence[Manoeuvre] = ()
        self._trimmed: NDArray[np.float64] = np.empty(0)
        self._behind, self._ahead = self.aircraft.behind, self.aircraft.ahead
        self._field = gusts_of(flight, self.aircraft, seed)
        self._begun = self.flown.constants
        self._memory = at_rest(self._begun, self.flown.tables, self._behind, self._field.now, self.flown.hands)
        self._state = np.zeros(SIZE)
        self._commands: NDArray[np.float64] = np.empty((3, 0))
        self._block = -1

    def ask(self, manoeuvres: Sequence[Order]) -> None:
        """As Simulation's."""
        self.aircraft.legs.ask(manoeuvres)
        self._asked = without_legs(manoeuvres)
        if self._block >= 0:
            self._command(self._block)

    @property
    def flown(self) -> Flown:
        """What the equations take, now."""
        return self.aircraft.flown

    def advance(self, n: int) -> dict[str, NDArray[np.float64]]:
        """The next `n` instants at 200 Hz: "time" (s of flight), every signal true in SI, TRUTH and LATERAL_TRUTH."""
        begin = int(self._memory.marks[DONE])
        out = np.empty((n, len(LATERAL_COLUMNS)))
        done = 0
        while done < n:
            number, offset = divmod(begin + done, BLOCK)
            m = min(n - done, BLOCK - offset)
            self._prepare(number)
            commands = self._commands
            if self.aircraft.changes:
                m = min(m, self.aircraft.renewed - offset % self.aircraft.renewed)
                if offset % self.aircraft.renewed == 0:
                    self.aircraft.go_on(begin + done, float(self._state[TURN]), float(self._state[BANK]))
                    wanted = self.aircraft.legs.wanted if self.aircraft.legs.any else None
                    self.lateral = lateral_constants(self.aircraft.now, self._hold, wanted, self._apart)
                commands = commands + np.array([[self.aircraft.retrimmed], [0.0], [0.0]])
            advance_lateral(
                self.flown,
                self.lateral,
                self._memory,
                self._state,
                np.ascontiguousarray(commands[:, 2 * offset : 2 * (offset + m) + 1]),
                self._field.now,
                out[done : done + m],
            )
            done += m
        columns = np.ascontiguousarray(out.T)
        return {"time": (begin + np.arange(n)) * DT, **dict(zip(LATERAL_COLUMNS, columns, strict=True))}

    def _prepare(self, number: int) -> None:
        """Commands and gusts for a block of steps."""
        if number != self._block:
            self._trimmed = self._begun.trim_elevator + self._tremor.half_steps(BLOCK // EVERY)
            self._shakes = np.stack([t.half_steps(BLOCK // EVERY) for t in self._across])
            self._command(number)
            self._block = number
        s = float(self._memory.x[eq.DISTANCE])
        far = SPEED_MARGIN * self._begun.trim_speed * BLOCK * DT
        self._field.cover(s - self._behind, s + self._ahead + far)

    def _command(self, number: int) -> None:
        """What is commanded at the half steps of a block."""
        half_steps = (np.arange(2 * BLOCK + 1, dtype=np.float64) + 2 * number * BLOCK) * (0.5 * DT)
        unasked = np.stack([surface_input(self._manoeuvres, half_steps, s) for s in SURFACES])
        self._commands = unasked + np.stack([surface_input(self._asked, half_steps, s) for s in SURFACES])
        self._commands[0] += self._trimmed
        self._commands[1:] += self._shakes
