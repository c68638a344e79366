"""What comes from outside: taken, held, faded to trim, and not believed."""

from __future__ import annotations

import math

import pytest

from station.clock import ManualClock
from station.flight.board import Board
from station.rows import Code, Event
from station.simulation.outside import Outside

TRIM = -0.02


def outside() -> Outside:
    return Outside({"elevator": TRIM}, hold=0.5, fade=2.0, jump=math.radians(10), travel={"elevator": math.radians(25)})


def codes(flight: Outside) -> list[Code]:
    return [code for code, _ in flight.told()]


def test_before_anything_comes_it_is_in_trim_and_then_the_newest_is_flown() -> None:
    o = outside()
    assert o.at(0.0) == {"elevator": TRIM}
    assert math.isnan(o.newest_s())
    o.take(1.0, "elevator", 0.01)
    o.take(1.1, "elevator", 0.03)
    assert o.at(1.2) == {"elevator": 0.03}
    assert o.newest_s() == 1.1
    assert codes(o) == [Code.HEARD]


def test_silence_is_held_then_faded_to_trim_and_told_once() -> None:
    o = outside()
    o.take(0.0, "elevator", 0.08)
    assert o.at(0.5) == {"elevator": 0.08}
    assert codes(o) == [Code.HEARD]
    for t in (1.0, 2.5, 4.5):
        assert o.at(t)["elevator"] == pytest.approx(TRIM + 0.10 * math.exp(-(t - 0.5) / 2.0))
    assert codes(o) == [Code.STALE]
    o.take(5.0, "elevator", 0.05)
    assert o.at(5.0) == {"elevator": 0.05}
    assert codes(o) == [Code.FRESH]


def test_the_alarm_of_silence_is_over_when_nothing_is_silent_any_more() -> None:
    o, board = Outside(dict.fromkeys(("elevator", "aileron"), 0.0), hold=0.5, fade=2.0), Board(None, ManualClock())

    def alarm(t: float) -> str:
        o.at(t)
        board.update(Event(0, "loop", code, 1, words) for code, words in o.told())
        return "".join(event.detail for event in board.alarms)

    for name in ("elevator", "aileron"):
        o.take(0.0, name, 0.1)
    assert alarm(0.0) == ""
    assert alarm(1.0) == "elevator, aileron: nothing from outside for 0.5 s: fading to trim"
    o.take(1.1, "elevator", 0.1)
    assert alarm(1.1) == "aileron: still nothing from outside; elevator heard again"
    o.take(1.2, "aileron", 0.1)
    assert alarm(1.2) == ""
    assert alarm(3.0).startswith("elevator, aileron: nothing")
    o.still(3.1)  # who tells changes alone is back, and has none to tell
    assert alarm(3.1) == ""


def test_a_pot_that_jumps_is_held_until_it_stays_there() -> None:
    o = outside()
    o.take(0.0, "elevator", 0.0)
    for k in range(1, 10):  # a wire that chatters: up and back
        o.take(0.01 * k, "elevator", 0.4 if k % 2 else 0.001)
        assert abs(o.at(0.01 * k)["elevator"]) < 0.01
    assert codes(o).count(Code.JUMP) >= 1
    for k in range(10, 25):
        o.take(0.01 * k, "elevator", 0.3)
    assert o.at(0.25) == {"elevator": 0.3}


def test_impossible_values_are_told_once_a_run_before_the_first_good_one_too() -> None:
    o = outside()
    for k in range(3):
        o.take(0.1 * k, "elevator", 1.0)
    assert o.at(0.2) == {"elevator": TRIM}
    assert codes(o) == [Code.RANGE]
    o.take(0.3, "elevator", 0.01)
    o.take(0.4, "elevator", 1.0)
    assert codes(o) == [Code.HEARD, Code.RANGE]


def test_a_quick_hand_is_no_jump() -> None:
    o = outside()
    for k in range(20):
        o.take(0.005 * k, "elevator", 0.12 * math.sin(2 * math.pi * 5 * 0.005 * k))
        assert o.at(0.005 * k)["elevator"] == 0.12 * math.sin(2 * math.pi * 5 * 0.005 * k)
    assert codes(o) == [Code.HEARD]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1.0])
def test_what_is_no_position_of_the_surface_is_not_flown(value: float) -> None:
    o = outside()
    o.take(0.0, "elevator", 0.01)
    o.take(0.1, "elevator", value)
    o.take(0.2, "elevator", value)
    assert o.at(0.2) == {"elevator": 0.01}
    assert codes(o) == [Code.HEARD, Code.RANGE]
    # Nothing usable is silence: it fades like one.
    assert o.at(0.6)["elevator"] < 0.01
