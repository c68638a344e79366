"""A card's steps as a flight without a crew flies them: one after the other, each as often as it may be."""

from __future__ import annotations

import math
from typing import Final

from station.flight.guide import COUNTDOWN_S, SETTLE_S
from station.profile import Card, Leg, Manoeuvre, Step, TestPoint
from station.simulation.manoeuvres import duration

TURN_RATE: Final = math.radians(3.0)
"""At which headings are taken to change, and"""
ACCELERATION: Final = 0.4
"""m/s2, speeds: less than an emulated pilot's."""
ROLL_OUT_S: Final = 25.0
"""For a turn's end or a new speed to settle."""


def length(step: Step) -> float:
    """Of one run, s."""
    if step.steady is not None:
        return step.steady
    return max(m.start + duration(m) for m in step.inputs) - min(m.start for m in step.inputs)


def planned(card: Card) -> tuple[Card, float]:
    """The card with its steps as manoeuvres and test points, s of flight, and when the last of them is over; the first
    begins when the filters have run for `warm_up`."""
    manoeuvres: list[Manoeuvre] = [*card.manoeuvres]
    points: list[TestPoint] = [*card.points]
    legs: list[Leg] = [*card.flight.legs]
    now, speed, heading = card.warm_up, card.flight.speed, card.flight.heading
    for step in card.steps:
        leg = step.leg(now) if card.goes_places else None
        if leg is not None:
            legs.append(leg)
            now += _way(leg, speed, heading)
            speed, heading = leg.speed or speed, heading if leg.heading is None else leg.heading
        begin, first = now, min((m.start for m in step.inputs), default=0.0)
        for _ in range(step.repeats):
            now += COUNTDOWN_S
            manoeuvres += [m.model_copy(update={"start": now + m.start - first}) for m in step.inputs]
            now += length(step) + SETTLE_S
        known = TestPoint(name=step.name, condition=step.condition.configuration)
        points.append(known.model_copy(update={"start": begin, "end": now}))
    flight = card.flight.model_copy(update={"legs": tuple(legs)})
    return card.model_copy(update={"manoeuvres": tuple(manoeuvres), "points": tuple(points), "flight": flight}), now


def _way(leg: Leg, speed: float, heading: float) -> float:
    """Time that a leg takes to fly to, s; after a turn the longest that a heading may be away."""
    turn = math.pi if leg.heading is not None and math.remainder(leg.heading - heading, 2 * math.pi) else 0.0
    change = abs((leg.speed or speed) - speed)
    if leg.bank is not None:
        return ROLL_OUT_S
    return turn / TURN_RATE + change / ACCELERATION + (ROLL_OUT_S if turn or change else 0.0)
