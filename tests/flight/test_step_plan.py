"""A card's steps as a simulation flies them."""

from cockpit import STEP

from station.flight.guide import COUNTDOWN_S, SETTLE_S
from station.flight.step_plan import planned
from station.profile import Card, load_card


def test_every_run_has_its_countdown_and_its_time_to_settle() -> None:
    """Two steps of three runs of a doublet of 2 s, from 10 s on."""
    steps = [STEP, {**STEP, "name": "again"}]
    card = Card.model_validate({"name": "x", "aircraft": "", "rig": "", "warm_up": "10 s", "steps": steps})
    made, end = planned(card)
    each = COUNTDOWN_S + 2.0 + SETTLE_S
    assert [m.start for m in made.manoeuvres] == [10 + COUNTDOWN_S + each * k for k in range(6)]
    assert [(p.note, p.start, p.end) for p in made.points] == [
        ("short period; flaps up", 10, 10 + 3 * each),
        ("again; flaps up", 10 + 3 * each, 10 + 6 * each),
    ]
    assert end == 10 + 6 * each
    bench = load_card("bench").card
    assert planned(bench)[0] == bench
