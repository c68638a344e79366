"""Where an emulated pilot flies to, `[[flight.legs]]`, and the mean wind on the way.

A heading is turned to with a bank of at most BANK, on the shorter way. The elevator is trimmed to the lift that the
bank takes; speed and height are held with thrust. What the wind changes by is not felt as a gust: it is slow.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from station.profile import Flight, Leg, Manoeuvre, Order

ORIGIN: Final = (math.radians(41.4), math.radians(-81.9))
"""Latitude and longitude where every simulated flight begins, rad."""
BANK: Final = math.radians(20.0)
"""Of a turn: rate one (3 deg/s) at 70 m/s."""
_STREAM: Final = 5
"""Of the random numbers, beside those of sensors and pilot."""
_MINUTE_S: Final = 60.0


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is held now: true airspeed, m/s, the heading turned since the start, rad, not wrapped; of a turn its bank,
    rad."""

    speed: float
    turn: float = 0.0
    bank: float | None = None


class Legs:
    """The legs of a flight and those asked for on the way."""

    def __init__(self, flight: Flight) -> None:
        self._heading = flight.heading
        self._coming = sorted(flight.legs, key=lambda leg: leg.start)
        self.wanted = Wanted(flight.speed)
        self.any = bool(flight.legs)

    def ask(self, orders: Iterable[Order]) -> None:
        """Take the legs among the orders."""
        more = [leg for leg in orders if isinstance(leg, Leg)]
        self.any = self.any or bool(more)
        self._coming = sorted([*self._coming, *more], key=lambda leg: leg.start)

    def at(self, time: float, turned: float) -> Wanted:
        """What is held from a time of flight on (s), with the heading turned so far (rad)."""
        while self._coming and self._coming[0].start <= time:
            self.wanted = self._heeded(self._coming.pop(0), turned)
        return self.wanted

    def _heeded(self, leg: Leg, turned: float) -> Wanted:
        made = self.wanted if leg.speed is None else replace(self.wanted, speed=leg.speed)
        if leg.bank is not None:
            return replace(made, bank=leg.bank)
        if leg.heading is None:
            return made
        further = math.remainder(leg.heading - self._heading - turned, 2 * math.pi)
        return replace(made, turn=turned + further, bank=None)


def without_legs(orders: Sequence[Order]) -> list[Manoeuvre]:
    """The test inputs among the orders."""
    return [order for order in orders if not isinstance(order, Leg)]


class WalkingWind:
    """The mean wind, whose components walk."""

    def __init__(self, flight: Flight, seed: int, every_s: float) -> None:
        """Renewed `every_s`; it depends on the `seed` only."""
        self.now = np.array([flight.wind_north, flight.wind_east])
        self.drifted = np.zeros(2)
        """How much less far north and east the air has come than it had with the wind of now all along, m."""
        self._kick = flight.wind_walk * math.sqrt(every_s / _MINUTE_S)
        self._rng = np.random.default_rng([seed, 0, _STREAM])

    def go_on(self, time: float) -> None:
        """To the wind from a time of flight on, s."""
        step = self._kick * self._rng.standard_normal(2)
        self.now = self.now + step
        self.drifted = self.drifted - step * time
