"""A card's steps led through: countdown, input, verdict, and what the keys do."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cockpit import STEP, Cockpit

from station.flight.guide import COUNTDOWN_S, SETTLE_S, Phase
from station.rows import Code

DURATION_S = COUNTDOWN_S + 2.0 + SETTLE_S + 0.2


def test_a_step_from_countdown_to_enough() -> None:
    cockpit = Cockpit(STEP)
    cockpit.fly(0.5)
    assert cockpit.guide.shown.phase is Phase.READY
    assert all(check.good for check in cockpit.guide.shown.checks)
    cockpit.press("n")
    assert cockpit.guide.shown.phase is Phase.COUNTDOWN
    assert cockpit.words(Code.POINT_START) == ["short period; flaps up"]
    cockpit.fly(COUNTDOWN_S + 1.0)
    assert cockpit.guide.shown.phase is Phase.FLYING
    drawn, flown = cockpit.guide.table.surfaces["elevator"], cockpit.guide.flown["elevator"]
    seen = np.isfinite(flown)
    assert 45 < seen.sum() < 55
    assert np.abs(flown[seen] - drawn[seen]).max() < 1e-9
    cockpit.fly(DURATION_S - COUNTDOWN_S - 1.0)
    verdict = cockpit.guide.shown.verdict
    assert verdict is not None
    assert verdict.kind == "enough"
    assert verdict.known[0].have == pytest.approx(4 / 35)
    cockpit.press("n")
    assert cockpit.guide.shown.phase is Phase.DONE
    assert np.isfinite(cockpit.guide.flown["elevator"]).all()  # as the screens show it on
    assert cockpit.guide.shown.results == (("short period", "enough"),)
    assert len(cockpit.words(Code.POINT_END)) == 1
    assert cockpit.words(Code.STEP)[-1] == "the card is flown: 1 of 1 steps enough"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"sd": 5.0}, "Cm_q is known to 29 %, 20 % wanted"),
        ({"share": 0.3}, "the elevator moved 30% of what is drawn"),
        ({"air": "moderate"}, "the air was moderate, light is wanted"),
        ({"changed": {"airspeed": 60.0}}, "speed 117 kt (110±5) when it began"),
        ({"changed": {"phi": 0.9}}, "bank +51.6 deg: the limit is +45"),
    ],
)
def test_why_it_is_to_be_flown_again(change: dict, words: str) -> None:
    cockpit = Cockpit(STEP)
    cockpit.fly(0.2)
    cockpit.press("n")
    late = "changed" in change and "phi" in change["changed"]
    cockpit.fly(COUNTDOWN_S + 0.2 if late else 0.0)
    for name, value in change.items():
        setattr(cockpit, name, value)
    cockpit.fly(DURATION_S, until=lambda: cockpit.guide.shown.phase is Phase.VERDICT)
    verdict = cockpit.guide.shown.verdict
    assert verdict is not None
    assert verdict.kind == "repeat"
    assert words in verdict.words
    cockpit.press("r")
    assert cockpit.guide.shown.phase is Phase.COUNTDOWN
    assert cockpit.guide.shown.run == 2
    assert len(cockpit.words(Code.POINT_START)) == 1  # runs of a step add up in one test point


@pytest.mark.parametrize(
    ("strayed_s", "kind", "words"),
    [(0.5, "enough", "next step"), (3.0, "repeat", "bank and speed out of tolerance for 3 of 10 s")],
)
def test_a_steady_condition_is_judged_by_how_long_it_was_held(strayed_s: float, kind: str, words: str) -> None:
    hold = {"name": "north", "repeats": 2, "steady": "10 s", "condition": {**STEP["condition"], "bank": "0 deg"}}
    cockpit = Cockpit(hold)
    cockpit.fly(0.2)
    cockpit.press("n")
    cockpit.fly(COUNTDOWN_S + 4.0)
    cockpit.changed = {"phi": 0.3}
    cockpit.fly(0.4 * strayed_s)
    cockpit.changed = {"phi": 0.3, "airspeed": 60.0}
    cockpit.fly(0.6 * strayed_s)
    cockpit.changed = {}
    cockpit.fly(20.0, until=lambda: cockpit.guide.shown.phase is Phase.VERDICT)
    verdict = cockpit.guide.shown.verdict
    assert verdict is not None
    assert verdict.kind == kind
    assert words in verdict.words


@pytest.mark.parametrize(("rate", "phase"), [(0.0500, Phase.COUNTDOWN), (0.0, Phase.READY)])
def test_a_level_turn_has_a_pitch_rate_of_its_own(rate: float, phase: Phase) -> None:
    """g tan 30 sin 30/56.6 m/s = 0.0500 rad/s, beyond the tolerance of 0.03 about none."""
    turn = {"name": "turn", "steady": "10 s", "condition": {"bank": "30 deg"}}
    cockpit = Cockpit(turn, auto=True)
    cockpit.changed = {"phi": math.radians(30.0), "q": rate}
    cockpit.fly(3.0)
    assert cockpit.guide.shown.phase is phase


def test_a_signal_that_falls_silent_is_waited_for_and_one_that_never_came_is_not() -> None:
    cockpit = Cockpit(STEP)
    cockpit.fly(0.2)
    good = {check.words: check.good for check in cockpit.guide.shown.checks}
    cockpit.changed = {"airspeed": math.nan}
    cockpit.fly(0.2)
    lost = {check.words: check.good for check in cockpit.guide.shown.checks}
    never = Cockpit(STEP)
    never.changed = {"airspeed": math.nan}
    never.fly(0.2)
    unheard = {check.words: check.good for check in never.guide.shown.checks}
    assert good["speed 110 kt (110±5)"]
    assert not lost["speed unknown"]
    assert unheard["speed unknown"]


def test_abort_takes_the_input_back_and_skip_leaves_the_step() -> None:
    cockpit = Cockpit(STEP, {**STEP, "name": "again"})
    cockpit.fly(0.2)
    cockpit.press("n")
    cockpit.fly(COUNTDOWN_S + 0.5)
    cockpit.press("a")
    assert cockpit.asked == ()
    assert (cockpit.guide.shown.phase, cockpit.guide.shown.run) == (Phase.READY, 0)
    cockpit.press("n")
    cockpit.fly(COUNTDOWN_S + 0.5)
    assert cockpit.guide.shown.run == 1
    assert cockpit.words(Code.POINT_START) == ["short period; flaps up"], "an aborted run makes no second point"
    cockpit.press("s")
    assert len(cockpit.words(Code.POINT_END)) == 1
    assert cockpit.guide.shown.number == 2
    assert cockpit.guide.shown.results == (("short period", "skipped"),)
    cockpit.press("r")  # nothing to repeat
    assert cockpit.guide.shown.phase is Phase.READY


def test_without_keys_the_card_is_flown_and_ends() -> None:
    cockpit = Cockpit(STEP, {**STEP, "name": "again", "repeats": 2}, auto=True)
    cockpit.sd = 5.0
    cockpit.fly(200.0, until=lambda: cockpit.guide.is_over)
    assert cockpit.guide.is_over
    assert cockpit.guide.shown.results == (("short period", "spent"), ("again", "spent"))
    assert len(cockpit.words(Code.VERDICT)) == 3 + 2
    assert cockpit.guide.snapshot()["phase"] == "done"
