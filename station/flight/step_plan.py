"""A card's steps as a flight without a crew flies them: one after the other, each as often as it may be."""

from __future__ import annotations

from station.flight.guide import COUNTDOWN_S, SETTLE_S
from station.profile import Card, Manoeuvre, TestPoint
from station.simulation.manoeuvres import duration


def planned(card: Card) -> tuple[Card, float]:
    """The card with its steps as manoeuvres and test points, s of flight, and when the last of them is over; the first
    begins when the filters have run for `warm_up`."""
    manoeuvres: list[Manoeuvre] = [*card.manoeuvres]
    points: list[TestPoint] = [*card.points]
    now = card.warm_up
    for step in card.steps:
        begin, first = now, min(m.start for m in step.inputs)
        for _ in range(step.repeats):
            now += COUNTDOWN_S
            manoeuvres += [m.model_copy(update={"start": now + m.start - first}) for m in step.inputs]
            now += max(m.start + duration(m) for m in step.inputs) - first + SETTLE_S
        known = TestPoint(name=step.name, condition=step.condition.configuration)
        points.append(known.model_copy(update={"start": begin, "end": now}))
    return card.model_copy(update={"manoeuvres": tuple(manoeuvres), "points": tuple(points)}), now
