"""The aircraft flown by measured inputs: elevator, thrust and vertical gust as a record shows them, open loop.

The equations, the wake and the vane are those of every simulated flight; here nobody commands, and the air is the one
that was met. Wings level, at a constant density.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.profile import Aircraft, Flight, Order
from station.simulation import longitudinal as eq
from station.simulation.airframe import constants, indicial_tables
from station.simulation.boom import vane_constants
from station.simulation.flown_aircraft import elevator_backlash, reach, site
from station.simulation.gusts import ALONG, STEP, UP, Field
from station.simulation.installed import Installed
from station.simulation.motion import (
    ALPHA,
    ATTACHED,
    COLUMNS,
    DISTANCE,
    DT,
    INCIDENCE,
    Flown,
    Memory,
    advance,
    memory_of,
    steadily_attached,
)
from station.simulation.pilot import hands
from station.simulation.three_degrees import HANDS_OFF

Array = NDArray[np.float64]

_STATES: Final = 4
"""Of the aircraft's own motion: u, w, theta, q."""
_FOLLOWING: Final = 0.1
"""Of a gust's lift, still to come."""
_FOLLOWED: Final = 30.0
"""Chords travelled in which no wing's lift is as far behind: Wagner's is within 10 % in 5."""


@dataclass(frozen=True, slots=True)
class Inputs:
    """Measured, instrument errors undone; (n,) each, every `dt` seconds, SI."""

    dt: float
    elevator: Array
    airspeed: Array
    gust: Array
    """Vertical, where the vane meets it, upwards positive, m/s."""
    headwind: Array | None = None
    """Its change, at the CG, m/s; none where it is not known."""
    thrust: Array | None = None
    """The trim's where it is not recorded."""


@dataclass(frozen=True, slots=True)
class Start:
    """Where a flight begins, and what is added to the aircraft's constants; SI, rad."""

    speed: float
    alpha: float
    """Of the motion, without gust."""
    theta: float
    q: float
    cl_0: float = 0.0
    cm_0: float = 0.0
    cd_0: float = 0.0


def settled_s(aircraft: Aircraft, speed: float) -> float:
    """How long, from the start of a record at a speed (m/s), wing and tail fly in air that the vane met before it, and
    a gust's lift follows, s: so long no record says what drove the aircraft."""
    amplitudes, rates = indicial_tables(aircraft).lift_gust
    chords = np.arange(0.0, _FOLLOWED, 0.1)
    left = np.abs(np.exp(-np.outer(chords, rates)) @ amplitudes)
    lift = float(chords[left > _FOLLOWING].max(initial=0.0))
    chord = aircraft.unsteady.reference_chord or aircraft.geometry.chord
    return (sum(reach(aircraft)) + lift * chord) / speed


class MeasuredFlight:
    """One aircraft on one record's inputs: flown from as many starts as are tried."""

    def __init__(
        self, aircraft: Aircraft, inputs: Inputs, height: float, imu: tuple[float, float, float],
        led: Sequence[Start] = (),
    ) -> None:  # fmt: skip
        """`imu`: from the CG in body axes, m; the air is of the aircraft's `air_density`. `led`: how the aircraft moved
        at the inputs' first instants: so long it is led as it was flown, while wake and lift follow, and begins to fly
        by itself at the instant after them. Raises ProfileError for one that cannot be flown at the record's mean
        speed."""
        speed = float(np.mean(inputs.airspeed))
        self._aircraft = aircraft
        self._flown = Flown(
            constants(aircraft, speed, max(height, 0.0), False, elevator_backlash(aircraft)),
            indicial_tables(aircraft),
            vane_constants(aircraft.boom, DT),
            vane_constants(None, DT),
            site(Flight().model_copy(update={"speed": speed}), aircraft.imu_at(imu)),
            hands(HANDS_OFF, 0.0, 0.0, 0.0),
        )
        self._t = inputs.dt * np.arange(len(inputs.elevator))
        fine = np.arange(0.0, self._t[-1] + 2 * DT, DT)
        # Held over each step at what it is in the step's middle: of second order in the step.
        self._elevator = np.interp(fine + 0.5 * DT, self._t, inputs.elevator)
        thrust = inputs.thrust
        trim = self._flown.constants.trim_thrust
        self._thrust = np.full(len(fine), trim) if thrust is None else np.interp(fine + 0.5 * DT, self._t, thrust)
        shown = np.array([_moving(x) for x in led]).reshape(-1, _STATES)
        until = fine[: round(len(led) * inputs.dt / DT)]
        columns = [np.interp(until, self._t[: len(led)], x) for x in shown.T] if led else list(shown.T)
        self._led = np.stack(columns, axis=1)
        """(steps, u, w, theta and q)."""
        v = np.interp(fine, self._t, inputs.airspeed)
        self._distance = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1])) * DT])
        headwind = np.zeros(len(self._t)) if inputs.headwind is None else inputs.headwind
        self._field = self._met(*(np.interp(fine, self._t, x) for x in (inputs.gust, headwind)))

    def _met(self, gust: Array, headwind: Array) -> Field:
        """The gusts along the way, held before and after."""
        behind, ahead = reach(self._aircraft)
        first = math.floor(-behind / STEP) - 2
        places = STEP * np.arange(first, math.ceil((self._distance[-1] + ahead) / STEP) + 2)
        values = np.zeros((len(places), 3))
        values[:, UP] = np.interp(places, self._distance + self._flown.vane.gust_x, gust)
        values[:, ALONG] = np.interp(places, self._distance, headwind)
        return Field(values, first)

    def fly(self, start: Start) -> dict[str, Array]:
        """What the profile's instruments show, at the record's times; (n,) each."""
        c = self._flown.constants
        c = c._replace(cl_trim=c.cl_trim + start.cl_0, cm_trim=c.cm_trim + start.cm_0, cd_0=c.cd_0 + start.cd_0)
        flown = self._flown._replace(constants=c)
        out = np.empty((len(self._elevator), len(COLUMNS)))
        moving = np.vstack([self._led, _moving(start)])
        _advance(flown, self._begin(moving[0]), self._elevator, self._thrust, self._distance, self._field, moving, out)
        rows = _Played(dict(zip(COLUMNS, np.ascontiguousarray(out.T), strict=True)))
        shown = Installed(rows, self._aircraft).advance(len(out))
        fine = DT * np.arange(len(out))
        return {name: np.interp(self._t, fine, values) for name, values in shown.items()}

    def _begin(self, moving: Array) -> Memory:
        """The wake as if the incidence had lasted."""
        speed, alpha = float(np.hypot(moving[0], moving[1])), float(np.arctan2(moving[1], moving[0]))
        c, tables = self._flown.constants, self._flown.tables
        motions, gusts = tables.lift_motion.shape[1], tables.lift_gust.shape[1]
        x = eq.trimmed_state(c, motions + gusts)
        x[eq.U], x[eq.W], x[eq.THETA], x[eq.Q] = moving
        met = float(self._field.values[0, UP]) / speed
        x[eq.LAGS : eq.LAGS + motions] = alpha - c.trim_alpha
        x[eq.LAGS + motions :] = met
        ring = 64 + math.ceil(4 * c.tail_arm / (c.trim_speed * DT))
        memory = memory_of(x, ring, tables, float(self._elevator[0]), self._flown.hands)
        memory.wake[DISTANCE, 0] = -reach(self._aircraft)[0]
        memory.wake[INCIDENCE, 0] = alpha - c.trim_alpha + met
        memory.last[ALPHA] += met
        memory.last[ATTACHED] = steadily_attached(c, memory.last[ALPHA])
        return memory


def _moving(x: Start) -> tuple[float, float, float, float]:
    """u, w, theta, q."""
    return x.speed * math.cos(x.alpha), x.speed * math.sin(x.alpha), x.theta, x.q


class _Played:
    """Rows that have been flown, as a source for the instruments; the last is held for those that show what comes."""

    def __init__(self, rows: dict[str, Array]) -> None:
        self._rows = rows

    def ask(self, manoeuvres: Sequence[Order]) -> None:
        """Nothing: they have been flown."""

    def advance(self, n: int) -> dict[str, Array]:
        return {k: np.concatenate([v, np.full(max(n - len(v), 0), v[-1])])[:n] for k, v in self._rows.items()}


@njit(cache=True, error_model="numpy", nogil=True)
def _advance(
    flown: Flown, memory: Memory, elevator: Array, thrust: Array, distance: Array, field: Field, moving: Array,
    out: Array,
) -> None:  # fmt: skip
    """As motion.advance, with elevator, thrust and the place among the gusts as measured, at every step; u, w, theta
    and q, `moving`, at the first."""
    command = np.empty(3)
    for k in range(out.shape[0]):
        if k < moving.shape[0]:
            memory.x[eq.U], memory.x[eq.W] = moving[k, 0], moving[k, 1]
            memory.x[eq.THETA], memory.x[eq.Q] = moving[k, 2], moving[k, 3]
        memory.x[eq.DISTANCE] = distance[k]
        memory.x[eq.ELEVATOR] = elevator[k]
        memory.x[eq.THRUST] = thrust[k]
        command[:] = elevator[k]
        advance(flown, memory, command, field, 1, out[k : k + 1])
