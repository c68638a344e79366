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

_STILL_TO_COME: Final = 0.1
"""Share of a gust's lift, below which the wing counts as having followed it."""
_LONGEST_CHORDS: Final = 30.0
"""After as many chords travelled every wing has: by Wagner's function after five."""


@dataclass(frozen=True, slots=True)
class Inputs:
    """Measured, instrument errors undone; (n,) each, every `dt` seconds, SI."""

    dt: float
    elevator: Array
    airspeed: Array
    gust: Array
    """Vertical, where the vane meets it, upwards positive, m/s."""
    headwind: Array
    """Its change, at the CG, m/s; 0 where it is not known."""
    motion: Array
    """(n, 4) of the aircraft in the air mass, in the order of Start: speed (m/s), angle of attack without gust, pitch
    angle (rad), pitch rate (rad/s)."""
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
    """How long after its start a record, flown at a speed (m/s), does not show what drives the aircraft, s: until wing
    and tail fly in air that the vane has met in it, and the lift has followed."""
    amplitudes, rates = indicial_tables(aircraft).lift_gust
    chords = np.arange(0.0, _LONGEST_CHORDS, 0.1)
    left = np.abs(np.exp(-np.outer(chords, rates)) @ amplitudes)
    lift = float(chords[left > _STILL_TO_COME].max(initial=0.0))
    chord = aircraft.unsteady.reference_chord or aircraft.geometry.chord
    return (sum(reach(aircraft)) + lift * chord) / speed


class MeasuredFlight:
    """One aircraft on one record's inputs: flown from as many starts as are tried."""

    def __init__(
        self, aircraft: Aircraft, inputs: Inputs, height: float, imu: tuple[float, float, float],
        led_s: float = 0.0,
    ) -> None:  # fmt: skip
        """`imu`: from the CG in body axes, m; the air is of the aircraft's `air_density`. `led_s`: for so long it moves
        as the inputs' `motion` says, while wake and lift follow; then it flies by itself. Raises ProfileError for an
        aircraft that cannot be flown at the record's mean speed."""
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
        led = fine[: round(led_s / DT)]
        self._led = _states(*(np.interp(led, self._t, x) for x in inputs.motion.T))
        v = np.interp(fine, self._t, inputs.airspeed)
        self._distance = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1])) * DT])
        self._field = self._met(*(np.interp(fine, self._t, x) for x in (inputs.gust, inputs.headwind)))

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
        """What the profile's instruments show, at the record's times, (n,) each; `start`: where it begins to fly by
        itself."""
        c = self._flown.constants
        c = c._replace(cl_trim=c.cl_trim + start.cl_0, cm_trim=c.cm_trim + start.cm_0, cd_0=c.cd_0 + start.cd_0)
        flown = self._flown._replace(constants=c)
        out = np.empty((len(self._elevator), len(COLUMNS)))
        led = np.vstack([self._led, _states(start.speed, start.alpha, start.theta, start.q)])
        _advance(flown, self._begin(led[0]), self._elevator, self._thrust, self._distance, self._field, led, out)
        rows = _Played(dict(zip(COLUMNS, np.ascontiguousarray(out.T), strict=True)))
        shown = Installed(rows, self._aircraft).advance(len(out))
        fine = DT * np.arange(len(out))
        return {name: np.interp(self._t, fine, values) for name, values in shown.items()}

    def _begin(self, states: Array) -> Memory:
        """At u, w, theta and q, the wake as if the incidence had lasted."""
        speed, alpha = math.hypot(states[0], states[1]), math.atan2(states[1], states[0])
        c, tables = self._flown.constants, self._flown.tables
        motions, gusts = tables.lift_motion.shape[1], tables.lift_gust.shape[1]
        x = eq.trimmed_state(c, motions + gusts)
        x[eq.U], x[eq.W], x[eq.THETA], x[eq.Q] = states
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


def _states(speed: float | Array, alpha: float | Array, theta: float | Array, q: float | Array) -> Array:
    """(..., 4) u, w, theta and q."""
    return np.stack([speed * np.cos(alpha), speed * np.sin(alpha), theta, q], axis=-1)


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
    flown: Flown, memory: Memory, elevator: Array, thrust: Array, distance: Array, field: Field, led: Array,
    out: Array,
) -> None:  # fmt: skip
    """As motion.advance, with elevator, thrust and the place among the gusts as measured, at every step; u, w, theta
    and q as `led`, (m, 4), at the first m."""
    command = np.empty(3)
    for k in range(out.shape[0]):
        if k < led.shape[0]:
            memory.x[eq.U], memory.x[eq.W] = led[k, 0], led[k, 1]
            memory.x[eq.THETA], memory.x[eq.Q] = led[k, 2], led[k, 3]
        memory.x[eq.DISTANCE] = distance[k]
        memory.x[eq.ELEVATOR] = elevator[k]
        memory.x[eq.THRUST] = thrust[k]
        command[:] = elevator[k]
        advance(flown, memory, command, field, 1, out[k : k + 1])
