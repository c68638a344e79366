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
    assert checklist.print_check("mine", board, STREAMS, told, {}) is verdict
    table, _, remarks = capsys.readouterr().out.partition("\u2514")
    assert row in [" ".join(line.replace("\u2502", " ").split()) for line in table.splitlines()]
    assert remarks.partition("\n")[2].strip() == below


def test_nothing_heard_is_no_go(capsys):
    assert not checklist.print_check("mine", Board(None, ManualClock(0)), STREAMS, [], {"can": "nothing"})
    assert capsys.readouterr().out.endswith("sent to can: nothing\n")


def test_what_is_out_of_range_stands_below_a_narrow_table(monkeypatch, capsys):
    monkeypatch.setattr(checklist, "Console", lambda **_: Terminal(width=80, force_terminal=True, color_system=None))
    board, told = heard(Event(0, "can.gyro", Code.RANGE, 3, "q = 12 cannot be true"))
    assert not checklist.print_check("card", board, STREAMS, told, {})
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= 80
    assert "outside" in shown
    assert "can.gyro: q = 12 cannot be true" in shown
