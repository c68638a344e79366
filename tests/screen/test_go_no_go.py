"""The go / no-go table: what is heard, what is wrong, and the verdict of both."""

import pytest
from rich.console import Console as Terminal

from station.clock import ManualClock
from station.conventions import Stream
from station.flight.board import Board
from station.rows import Code, Event, Health, StreamHealth
from station.screen import go_no_go as checklist

STREAMS = [Stream(f"can.{name}", ("q",), 200.0, 0.1, device="can") for name in ("gyro", "accel")]
SOUND = {"device": "can", "rate_hz": 199.0, "age_s": 0.003, "clock": "synced", "offset_s": 1.0, "drift_ppm": 3.0}

RATES = {s.name: 199.0 for s in STREAMS}


def heard(*events, **gyro):
    rows = [
        StreamHealth(stream=s.name, samples=900, gaps=0, bad=0, **{"alive": True, **SOUND, **(gyro if not i else {})})
        for i, s in enumerate(STREAMS)
    ]
    board = Board(None, ManualClock(0))
    board.update([Health(0, tuple(rows)), *events])
    return board, events


@pytest.mark.parametrize(
    ("events", "gyro", "verdict", "row", "below"),
    [
        ((), {}, True, "can.gyro yes 199 of 200 synced ok GO", ""),
        ((), {"rate_hz": 170.0}, False, "can.gyro yes 170 of 200 synced ok NO-GO", ""),
        ((), {"clock": "rejected"}, False, "can.gyro yes 199 of 200 rejected ok NO-GO", ""),
        ((), {"clock": "none"}, True, "can.gyro yes 199 of 200 none ok GO", ""),
        (
            (
                Event(0, "can", Code.DISCONNECT, 1, "cannot open [/dev/ttyACM0]: no such port"),
                Event(0, "can.gyro", Code.STALE, 1, "nothing for 2 s"),
            ),
            {"alive": False, "rate_hz": 0.0},
            False,
            "can.gyro no 0 of 200 synced - NO-GO",
            "can DISCONNECT: cannot open [/dev/ttyACM0]: no such port",
        ),
        (
            (Event(0, "can.gyro", Code.RANGE, 3, "q = 12 cannot be true"),),
            {},
            False,
            "can.gyro yes 199 of 200 synced q = 12 cannot be true NO-GO",
            "can.gyro RANGE 3",
        ),
        (
            (Event(0, "can.gyro", Code.STUCK, 1, "again"),),
            {},
            False,
            "can.gyro yes 199 of 200 synced ok NO-GO",
            "can.gyro STUCK: again",
        ),
        (
            (Event(0, "can.gyro", Code.CRC, 2), Event(0, "can.gyro", Code.CRC, 1)),
            {},
            True,
            "can.gyro yes 199 of 200 synced ok GO",
            "can.gyro CRC 3",
        ),
        (
            (Event(0, "can.gyro", Code.STALE, 1, "nothing"), Event(1, "can.gyro", Code.FRESH, 1, "STALE over")),
            {},
            True,
            "can.gyro yes 199 of 200 synced ok GO",
            "",
        ),
    ],
)
def test_verdict_and_words(capsys, events, gyro, verdict, row, below):
    board, told = heard(*events, **gyro)
    rates = {s.stream: s.rate_hz for s in board.health.streams}
    assert checklist.print_check("mine", board, STREAMS, told, {}, rates, 5.0) is verdict
    table, _, remarks = capsys.readouterr().out.partition("\u2514")
    assert row in [" ".join(line.replace("\u2502", " ").split()) for line in table.splitlines()]
    assert remarks.partition("\n")[2].strip() == below


def test_who_is_in_the_loop_and_is_not_there_is_no_go(capsys):
    board, told = heard(Event(0, "autopilot in the loop", Code.DISCONNECT, 1, "/dev/ttyACM9: no such port"))
    assert not checklist.print_check("mine", board, STREAMS, told, {}, RATES, 5.0)
    shown = capsys.readouterr().out
    assert row_of(shown, "autopilot in the loop") == "autopilot in the loop no - - - NO-GO"
    assert row_of(shown, "can.gyro").endswith(" GO")
    board.update([Event(1, "autopilot in the loop", Code.CONNECT, 1, "/dev/ttyACM9")])
    assert checklist.print_check("mine", board, STREAMS, told, {}, RATES, 5.0)


def test_nothing_heard_is_no_go(capsys):
    assert not checklist.print_check("mine", Board(None, ManualClock(0)), STREAMS, [], {"can": "nothing"}, {}, 5.0)
    assert capsys.readouterr().out.endswith("sent to can: nothing\n")


def row_of(shown: str, stream: str) -> str:
    return next(" ".join(line.replace("\u2502", " ").split()) for line in shown.splitlines() if stream in line)


def test_a_rate_is_that_of_the_whole_time(capsys):
    """One message late at the end takes the last half second's rate below what is asked, and not that of 5 s."""
    board, told = heard(rate_hz=170.0)
    assert checklist.print_check("mine", board, STREAMS, told, {}, RATES, 5.0)
    assert row_of(capsys.readouterr().out, "can.gyro") == "can.gyro yes 199 of 200 synced ok GO"


@pytest.mark.parametrize(("late", "verdict"), [(12, "NO-GO"), (13, "busy")])
def test_a_machine_that_is_too_busy_judges_no_rate(capsys, late, verdict):
    board, told = heard(Event(0, "loop", Code.OVERRUN, late, "the machine was busy"), alive=False)
    assert not checklist.print_check("mine", board, STREAMS, told, {}, {"can.accel": 199.0, "can.gyro": 60.0}, 5.0)
    shown = capsys.readouterr().out
    assert row_of(shown, "can.gyro") == f"can.gyro no 60 of 200 synced - {verdict}"
    assert row_of(shown, "can.accel").endswith(" GO")
    assert (f"too busy to judge rates: {late} of 250 ticks" in shown) == (verdict == "busy")


def test_what_is_out_of_range_stands_below_a_narrow_table(monkeypatch, capsys):
    monkeypatch.setattr(checklist, "Console", lambda **_: Terminal(width=80, force_terminal=True, color_system=None))
    board, told = heard(Event(0, "can.gyro", Code.RANGE, 3, "q = 12 cannot be true"))
    assert not checklist.print_check("card", board, STREAMS, told, {}, RATES, 5.0)
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= 80
    assert "outside" in shown
    assert "can.gyro: q = 12 cannot be true" in shown
