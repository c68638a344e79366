"""The simulation a step at a time, its surfaces moved from outside: by a hand on the bench, an autopilot, a stick.

The same equations as in `three_degrees` and `six_degrees`; what nobody moves from outside is flown as there, by the
card's pilot and test inputs. A measured surface is where it is said to be; a commanded one follows through the
profile's actuator, with the card's test inputs laid over the command.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import SURFACES, TICK_HZ
from station.profile import LOOP_HZ, MOVED, Aircraft, Card, Manoeuvre, Order
from station.rows import ProfileError
from station.simulation.flown_aircraft import FlownAircraft, Position
from station.simulation.legs import without_legs
from station.simulation.longitudinal import DISTANCE, ELEVATOR
from station.simulation.manoeuvres import surface_input
from station.simulation.motion import COLUMNS, DONE, advance, at_rest
from station.simulation.side_flow import AILERON, RUDDER, SIZE, TURN, has_lateral, lateral_constants
from station.simulation.six_degrees import LATERAL_COLUMNS, advance_lateral
from station.simulation.three_degrees import SPEED_MARGIN, gusts_of, tremor, tremors_across

_BLOCK_S: Final = 1.0
"""Of test inputs, made together."""


class SteppedFlight:
    """One flight from trim. Six degrees of freedom where the aircraft has lateral derivatives, three otherwise."""

    def __init__(
        self,
        aircraft: Aircraft,
        card: Card,
        imu_position: Position = (0.0, 0.0, 0.0),
        outside: Collection[str] = (),
        measured: bool = False,
        rate_hz: int = LOOP_HZ,
    ) -> None:
        """`outside`: those of MOVED that somebody else moves, `measured` or commanded. Raises ProfileError, also for a
        card that moves a surface that is measured, or one that two would move."""
        _check(aircraft, card, outside, measured)
        flight = card.flight
        self._outside, self._measured = frozenset(outside), measured
        self._dt = 1.0 / rate_hz
        self.aircraft = FlownAircraft(aircraft, flight, imu_position, "thrust" not in outside, card.pilot, rate_hz)
        flown = self.aircraft.flown
        self._levels = "aileron" not in outside and not card.pilot.bank
        self.is_lateral = has_lateral(self.aircraft.now)
        self.columns = LATERAL_COLUMNS if self.is_lateral else COLUMNS
        self._apart = flight.is_plane
        now = self.aircraft.now
        self._side = lateral_constants(now, self._levels, apart=self._apart) if self.is_lateral else None
        self._behind, self._ahead = self.aircraft.behind, self.aircraft.ahead
        self._field = gusts_of(flight, self.aircraft, None)
        self._memory = at_rest(flown.constants, flown.tables, self._behind, self._field.now, flown.hands, self._dt)
        self._state = np.zeros(SIZE)
        self._begun = flown.constants
        self.rest: Mapping[str, float] = dict.fromkeys(MOVED, 0.0) | {
            "elevator": self._begun.trim_elevator,
            "thrust": self._begun.trim_thrust,
        }
        """Where what is moved from outside is in trim."""
        self._manoeuvres, self._asked = tuple(card.manoeuvres), tuple[Manoeuvre, ...]()
        self._tremor, self._shakes = tremor(flight, card.pilot, None, rate_hz), np.empty(0)
        self._across, self._swayed = tremors_across(flight, card.pilot, None, rate_hz), np.empty((2, 0))
        self._block_steps = round(_BLOCK_S * rate_hz)
        self._added: NDArray[np.float64] | None = None

    def ask(self, manoeuvres: Sequence[Order]) -> None:
        """Fly these beside the card's from now on, `start` in seconds of flight; none to fly what was asked no more.
        Those on a measured surface are the hand's to fly."""
        self.aircraft.legs.ask(manoeuvres)
        self._asked = tuple(without_legs(manoeuvres))
        self._added = None

    @property
    def steps_done(self) -> int:
        return int(self._memory.marks[DONE])

    @property
    def time_s(self) -> float:
        """Of the next row, seconds of flight."""
        return self.steps_done * self._dt

    def step(self, given: Mapping[str, float]) -> NDArray[np.float64]:
        """The instant now with what is given from outside, else in trim, in the order of `columns`; then a step on."""
        step, given = self.steps_done, {**self.rest, **given}
        if self.aircraft.changes and step % self.aircraft.renewed == 0:
            self.aircraft.go_on(step, float(self._state[TURN]))
            wanted = self.aircraft.legs.wanted if self.aircraft.legs.any else None
            if self._side is not None:
                self._side = lateral_constants(self.aircraft.now, self._levels, wanted, self._apart)
        commands = self._commanded(step, given)
        s = float(self._memory.x[DISTANCE])
        # A block's way ahead at once: making the field takes longer than a step.
        far = SPEED_MARGIN * self._begun.trim_speed * _BLOCK_S
        if step % self._block_steps == 0:
            self._field.cover(s - self._behind, s + self._ahead + far)
        flown = self.aircraft.flown
        if "thrust" in self._outside:
            flown = flown._replace(constants=flown.constants._replace(trim_thrust=max(0.0, given["thrust"])))
        out = np.empty((1, len(self.columns)))
        if self._side is None:
            advance(flown, self._memory, commands[0], self._field.now, 1, out)
        else:
            advance_lateral(flown, self._side, self._memory, self._state, commands, self._field.now, out)
        row: NDArray[np.float64] = out[0]
        return row

    def _commanded(self, step: int, given: Mapping[str, float]) -> NDArray[np.float64]:
        """Of each surface at the step's begin, middle and end, rad; a measured surface is put where it is."""
        number, offset = divmod(step, self._block_steps)
        if offset == 0:
            self._shakes = self._tremor.half_steps(round(_BLOCK_S * TICK_HZ))
            self._swayed = np.stack([t.half_steps(round(_BLOCK_S * TICK_HZ)) for t in self._across])
        if offset == 0 or self._added is None:
            half_steps = np.arange(2 * self._block_steps + 1, dtype=np.float64) + 2 * number * self._block_steps
            times = half_steps * (0.5 * self._dt)
            own = np.stack([surface_input(self._manoeuvres, times, s) for s in SURFACES])
            self._added = own + np.stack([surface_input(self._asked, times, s) for s in SURFACES])
        commands: NDArray[np.float64] = self._added[:, 2 * offset : 2 * offset + 3].copy()
        if "elevator" not in self._outside:
            commands[0] += self._begun.trim_elevator + self._shakes[2 * offset : 2 * offset + 3]
            commands[0] += self.aircraft.retrimmed
        commands[1:] += self._swayed[:, 2 * offset : 2 * offset + 3]
        for i, surface in enumerate(SURFACES):
            if surface not in self._outside:
                continue
            commands[i] = given[surface] + (0.0 if self._measured else commands[i])
            if self._measured and i == 0:
                self._memory.x[ELEVATOR] = given[surface]
            elif self._measured:
                self._state[(AILERON, RUDDER)[i - 1]] = given[surface]
        return commands


def _check(aircraft: Aircraft, card: Card, outside: Collection[str], measured: bool) -> None:
    if unknown := set(outside) - set(MOVED):
        raise ProfileError(f"nothing from outside moves {', '.join(sorted(unknown))}: only {', '.join(MOVED)}")
    if card.flight.source != "simulation":
        raise ProfileError(
            f"card {card.name}: flight.source: {card.flight.source} cannot be flown from outside\n"
            'use "simulation", or a rig without [loop]'
        )
    lateral = [s for s in SURFACES[1:] if s in outside]
    if lateral and not has_lateral(aircraft):
        raise ProfileError(
            f"aircraft {aircraft.name}: derivatives: no lateral ones (CY_beta, Cl_p, ...), and {lateral[0]} comes from "
            "outside"
        )
    if both := sorted(card.pilot.moved & set(outside)):
        raise ProfileError(f"card {card.name}: [pilot]: the {both[0]} comes from outside: one of the two can move it")
    moved = {m.surface for m in card.manoeuvres} & set(outside)
    if measured and moved:
        raise ProfileError(
            f"card {card.name}: manoeuvres: {sorted(moved)[0]} is measured on the rig: it is where the hand puts it\n"
            "take the inputs out, or fly with commands"
        )
