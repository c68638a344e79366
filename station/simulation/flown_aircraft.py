"""The aircraft as a flight begins with it, where it flies and who; and one that changes in flight, `[flight.truth]`.

A change renews the equations' constants every tenth of a second. The equations stay stated about the trim that the
flight began in; the pilot retrims: elevator and thrust go to the trim of the aircraft as it is, in the turn that it is
in, a few seconds late.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from typing import Final

from station.numerics.earth import radii
from station.profile import NO_BOOM, Aircraft, AlteredAircraft, Flight, Pilot
from station.rows import ProfileError
from station.simulation.airframe import Trim, constants, find_trim, indicial_tables
from station.simulation.boom import vane_constants
from station.simulation.legs import ORIGIN, Legs, WalkingWind
from station.simulation.motion import Flown, Site
from station.simulation.pilot import RATE_HZ, hands

RENEWED_S: Final = 0.1
"""Between two states of the aircraft: ice that builds up within a minute grows by 0.2 %."""
_TRIMMED: Final = 10
"""States of the aircraft between two searches for its trim: a second."""
ACCELERATION: Final = 0.4
"""At which the pilot changes speed, m/s2: what engines have to spare in level flight."""
_STEEPEST: Final = math.radians(60.0)
"""Bank that elevator and thrust are trimmed to at most: twice the weight, more than a transport is turned with."""
_RETRIM_S: Final = 5.0
"""Time constant with which the pilot's trim follows: slower than a short period, faster than a phugoid."""

Position = tuple[float, float, float]


class FlownAircraft:
    """An aircraft of a flight: `flown` is what the equations take, now."""

    def __init__(
        self,
        profile: Aircraft,
        flight: Flight,
        imu_position: Position,
        hold: bool,
        pilot: Pilot,
        rate_hz: int = RATE_HZ,
        seed: int | None = None,
    ) -> None:
        """`imu_position` from the CG that the profile states, m; `rate_hz`: steps a second; `seed` in place of the
        flight's. Raises ProfileError, also for a change after which the aircraft cannot be trimmed."""
        self._rate_hz, self._dt = rate_hz, 1.0 / rate_hz
        self.renewed = round(RENEWED_S * rate_hz)
        """Steps between two of its states."""
        self._altered = AlteredAircraft(profile, flight.truth)
        self.legs = Legs(flight)
        self._speed = flight.speed
        self._wind = WalkingWind(flight, flight.seed if seed is None else seed, RENEWED_S)
        self._flight, self._place, self._hold, self._pilot = flight, imu_position, hold, pilot
        self.now = self._altered.at(0.0)
        """The aircraft as it is."""
        for time in self._altered.times[1:]:
            self._own_trim(self._altered.at(time), time)
        self._trim = self._goal = find_trim(self.now, flight.speed, flight.altitude)
        self._begun = self._trim
        self.flown = self._made(None)
        self.behind, self.ahead = reach(self.now, flight.is_plane)
        """How far behind and ahead of the CG it meets the air at most, m."""
        for time in self._altered.times:
            behind, ahead = reach(self._altered.at(time), flight.is_plane)
            self.behind, self.ahead = max(self.behind, behind), max(self.ahead, ahead)

    @property
    def changes(self) -> bool:
        """Whether it is another from one tenth of a second to the next."""
        return bool(self._altered.keys) or self.legs.any or self._flight.wind_walk > 0

    @property
    def retrimmed(self) -> float:
        """What the pilot's trim adds to the elevator that the flight began with, rad."""
        return self._trim.elevator - self._begun.elevator

    def go_on(self, step: int, turned: float = 0.0, bank: float = 0.0) -> None:
        """The next `renewed` steps begin with this one; the heading has `turned` so far, in this `bank`, rad."""
        time, state = step * self._dt, step // self.renewed
        wanted = self.legs.at(time, turned)
        if state % _TRIMMED == 0:
            turning = min(max(bank, -_STEEPEST), _STEEPEST) if self.legs.any else 0.0
            self._goal = self._own_trim(self._altered.at(time), time, turning)
        if state and self._flight.wind_walk:
            self._wind.go_on(time)
        share = 1.0 - math.exp(-RENEWED_S / _RETRIM_S) if state else 1.0
        furthest = ACCELERATION * RENEWED_S
        self._speed += min(max(wanted.speed - self._speed, -furthest), furthest)
        old, goal = self._trim, self._goal
        self._trim = Trim(*(a + share * (b - a) for a, b in zip(_numbers(old), _numbers(goal), strict=True)))
        self.now = self._altered.at(time)
        self.flown = self._made(self._begun)

    def _own_trim(self, aircraft: Aircraft, time: float, bank: float = 0.0) -> Trim:
        if bank:
            with suppress(ProfileError):  # too slow to be turned so at one height: the trim stays that of level flight
                return find_trim(aircraft, self._speed, self._flight.altitude, bank)
        try:
            return find_trim(aircraft, self._speed, self._flight.altitude)
        except ProfileError as error:
            raise ProfileError(f"flight.truth, {time:g} s of flight: {error}") from None

    def _made(self, about: Trim | None) -> Flown:
        aircraft, flight = self.now, self._flight
        stated = replace(about, thrust=self._trim.thrust) if about else None
        backlash = elevator_backlash(aircraft)
        trimmed = constants(aircraft, flight.speed, flight.altitude, self._hold, backlash, stated, self._speed)
        moved = (b - a for a, b in zip(self._altered.profile.imu_offset, aircraft.imu_offset, strict=True))
        x, y, z = (a + b for a, b in zip(self._place, moved, strict=True))
        tables = indicial_tables(aircraft, flight.is_plane)
        if about and any(a.shape != b.shape for a, b in zip(tables, self.flown.tables, strict=True)):
            raise ProfileError("flight.truth: unsteady.gust_span: let it be above 0 from the start on")
        return Flown(
            trimmed,
            tables,
            vane_constants(aircraft.boom, self._dt),
            vane_constants(aircraft.second_vane, self._dt),
            site(flight, (x, y, z), self._wind),
            hands(self._pilot, self._trim.alpha, trimmed.trim_height, self._speed, self._rate_hz),
        )


def _numbers(trim: Trim) -> tuple[float, float, float, float]:
    return trim.alpha, trim.elevator, trim.thrust, trim.lift_coefficient


def elevator_backlash(aircraft: Aircraft) -> float:
    """Width of the backlash between the elevator's drive and its surface, rad."""
    errors = aircraft.instruments.get("elevator")
    return errors.backlash if errors else 0.0


def reach(aircraft: Aircraft, apart: bool = False) -> tuple[float, float]:
    """How far behind and ahead of the CG the aircraft meets the air, m, with a metre to spare; `apart`: its fin too."""
    boom, unsteady = aircraft.boom or NO_BOOM, aircraft.unsteady
    behind = unsteady.tail_arm * max(1.0, unsteady.tail_penetration)
    if apart and aircraft.fin:
        behind = max(behind, aircraft.fin.arm * max(1.0, aircraft.fin.penetration))
    ahead = aircraft.second_vane.gust_x if aircraft.second_vane else 0.0
    return behind + 1.0, max(boom.gust_x, ahead, aircraft.geometry.chord) + 1.0


def site(flight: Flight, imu_position: tuple[float, float, float], wind: WalkingWind | None = None) -> Site:
    """The earth is taken round with WGS-84's radii of curvature at the origin."""
    wind = wind or WalkingWind(flight, flight.seed, 0.0)
    north, east = radii(ORIGIN[0])
    return Site(
        imu_x=imu_position[0],
        imu_y=imu_position[1],
        imu_z=imu_position[2],
        wind_north=float(wind.now[0]),
        wind_east=float(wind.now[1]),
        heading=flight.heading,
        latitude=ORIGIN[0] + float(wind.drifted[0]) / north,
        longitude=ORIGIN[1] + float(wind.drifted[1]) / (east * math.cos(ORIGIN[0])),
        radius_north=north,
        radius_east=east,
    )
