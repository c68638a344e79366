"""A simulated flight with its wings level: aircraft, air, boom and test inputs together, stepped at 200 Hz.

Deterministic: the same seed gives the same bits however the flight is cut into pieces.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.profile import Aircraft, Flight, Manoeuvre, Order, Pilot
from station.simulation.discrete_gusts import on_a_line
from station.simulation.flown_aircraft import FlownAircraft
from station.simulation.gust_plane import PlaneField, across, in_a_plane
from station.simulation.gusts import GustField, dryden_of, field_constants, ramp
from station.simulation.legs import without_legs
from station.simulation.longitudinal import DISTANCE
from station.simulation.manoeuvres import elevator_input
from station.simulation.motion import COLUMNS, DONE, DT, EVERY, Flown, advance, at_rest
from station.simulation.pilot import RATE_HZ, Tremor, deviation, deviations_across

BLOCK: Final = 400
"""Steps whose elevator commands are made together."""
SPEED_MARGIN: Final = 2.0
"""The gust field is made this many trim speeds times the block's time ahead."""
HANDS_OFF: Final = Pilot()


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
        deflection: NDArray[np.float64] | None = None,
        pilot: Pilot = HANDS_OFF,
    ) -> None:
        """`imu_position` from the CG in body axes, m; `seed` in place of the flight's; `deflection`, where there is
        one, commanded from trim at every half step (rad), is flown in place of the manoeuvres; `pilot`: the
        elevator's feedback. Raises ProfileError."""
        self.aircraft = FlownAircraft(aircraft, flight, imu_position, hold, pilot, seed=seed)
        self._tremor = tremor(flight, pilot, seed)
        self._manoeuvres = tuple(manoeuvres)
        self._asked: Sequence[Manoeuvre] = ()
        self._trimmed: NDArray[np.float64] = np.empty(0)
        self._deflection = deflection
        self._behind, self._ahead = self.aircraft.behind, self.aircraft.ahead
        self._field = gusts_of(flight, self.aircraft, seed)
        self._begun = self.flown.constants
        self._memory = at_rest(self._begun, self.flown.tables, self._behind, self._field.now, self.flown.hands)
        self._commands: NDArray[np.float64] = np.empty(0)
        self._block = 0
        """Number of the block of elevator commands at hand, plus 1."""

    @property
    def flown(self) -> Flown:
        """What the equations take, now."""
        return self.aircraft.flown

    def ask(self, manoeuvres: Sequence[Order]) -> None:
        """Fly these beside the others from now on, `start` in seconds of flight; none to fly what was asked no more.
        The heading stays: legs are not flown."""
        self._asked = without_legs(manoeuvres)
        if self._block:
            self._commands = self._trimmed + self._added(self._block - 1)

    @property
    def steps_done(self) -> int:
        """How many steps of DT have been given; the next one is at steps_done * DT seconds of flight."""
        return int(self._memory.marks[DONE])

    def advance(self, n: int) -> dict[str, NDArray[np.float64]]:
        """The next `n` instants at 200 Hz: "time" (s of flight), every signal true in SI, and TRUTH; each (n,)."""
        begin = self.steps_done
        out = np.empty((n, len(COLUMNS)))
        done = 0
        while done < n:
            self._prepare(begin + done)
            offset = (begin + done) % BLOCK
            m = min(n - done, BLOCK - offset)
            command = self._commands
            if self.aircraft.changes:
                m = min(m, self.aircraft.renewed - offset % self.aircraft.renewed)
                if offset % self.aircraft.renewed == 0:
                    self.aircraft.go_on(begin + done)
                command = command + self.aircraft.retrimmed
            command = command[2 * offset : 2 * (offset + m) + 1]
            advance(self.flown, self._memory, command, self._field.now, 1, out[done : done + m])
            done += m
        columns = np.ascontiguousarray(out.T)
        return {"time": (begin + np.arange(n)) * DT, **dict(zip(COLUMNS, columns, strict=True))}

    def _prepare(self, step: int) -> None:
        """Elevator commands and gusts for the block that the step is in."""
        number = step // BLOCK
        if self._block != number + 1:
            self._trimmed = self._begun.trim_elevator + self._tremor.half_steps(BLOCK // EVERY)
            self._commands = self._trimmed + self._added(number)
            self._block = number + 1
        s = float(self._memory.x[DISTANCE])
        far = SPEED_MARGIN * self._begun.trim_speed * BLOCK * DT
        self._field.cover(s - self._behind, s + self._ahead + far)

    def _added(self, number: int) -> NDArray[np.float64]:
        """What the inputs add at the half steps of a block, rad."""
        half_steps = np.arange(2 * BLOCK + 1) + 2 * number * BLOCK
        if self._deflection is not None:
            return self._deflection[np.minimum(half_steps, len(self._deflection) - 1)]
        time = half_steps.astype(np.float64) * (0.5 * DT)
        return elevator_input(self._manoeuvres, time) + elevator_input(self._asked, time)


def tremor(flight: Flight, pilot: Pilot, seed: int | None, rate_hz: int = RATE_HZ) -> Tremor:
    """The noise of the feedback's sensors; `seed` in place of the flight's; `rate_hz`: steps a second."""
    remnant = pilot.remnant if "elevator" in pilot.moved else 0.0
    return Tremor(deviation(pilot), flight.seed if seed is None else seed, rate_hz, remnant=remnant)


def tremors_across(flight: Flight, pilot: Pilot, seed: int | None, rate_hz: int = RATE_HZ) -> tuple[Tremor, Tremor]:
    """The same, of aileron and rudder."""
    own, (aileron, rudder) = flight.seed if seed is None else seed, deviations_across(pilot)
    of = {s: pilot.remnant if s in pilot.moved else 0.0 for s in ("aileron", "rudder")}
    return Tremor(aileron, own, rate_hz, 1, of["aileron"]), Tremor(rudder, own, rate_hz, 2, of["rudder"])


def gusts_of(flight: Flight, flown: FlownAircraft, seed: int | None) -> GustField | PlaneField:
    """The flight's field, as far as the aircraft reaches at first; `seed` in place of the flight's. Raises ProfileError
    for an aircraft that cannot fly in a plane."""
    if not flight.is_plane:
        return line_of(flight, flown.behind, flown.ahead, seed)
    parts = across(flown.now)
    field = PlaneField(
        parts,
        dryden_of(flight),
        flight.spectrum,
        ramp(flight.speed, flight.gust_start),
        flown.behind,
        np.random.SeedSequence(flight.seed if seed is None else seed),
        in_a_plane(flight.gusts, flight.speed, parts),
    )
    field.cover(-flown.behind, flown.ahead)
    return field


def line_of(flight: Flight, behind: float, ahead: float, seed: int | None) -> GustField:
    """The field on the way of the CG, from `behind` to `ahead` of the origin at first, m."""
    field = GustField(
        field_constants(dryden_of(flight), flight.speed, flight.gust_start),
        behind,
        np.random.SeedSequence(flight.seed if seed is None else seed),
        on_a_line(flight.gusts, flight.speed),
    )
    field.cover(-behind, ahead)
    return field
