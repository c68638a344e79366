"""The terminal screen in a terminal, and the lines that stand in for it."""

from __future__ import annotations

import errno
import io
import json
import os
import pty
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest
from rich.console import Console

from station.clock import ManualClock
from station.conventions import LONGITUDINAL
from station.flight.board import Board
from station.rows import (
    Code,
    Event,
    Health,
    MethodEstimate,
    ParamEstimate,
    Status,
    Tick,
)
from station.screen import terminal as panel
from station.screen.terminal import Callbacks, json_lines, plain_lines, run_panel
from tests.screen.a_board import ALPHA, DEG, LINK, START_NS, board_with, screen, seconds


class Operator:
    def __init__(self) -> None:
        self.done: list[str] = []
        self.clock = ManualClock(START_NS)
        self.callbacks = Callbacks(
            on_mark=lambda note: self.done.append(f"mark {note}"),
            on_point=lambda: self.done.append("point"),
            on_quit=lambda: self.done.append("quit"),
        )
        self.keys = panel._Keys(self.callbacks, self.clock)


def test_clocks_on_their_way_to_synced_do_not_crowd_the_events_but_a_rejected_one_is_told() -> None:
    states = [Event(seconds(i), f"can.s{i}", Code.CLOCK_STATE, 1, "synced") for i in range(20)]
    mark = Event(seconds(0), "operator", Code.MARK, 1, "gear down")
    rejected = Event(seconds(30), "can.s3", Code.CLOCK_STATE, 1, "rejected")
    text = "\n".join(screen(board_with(ALPHA, mark, *states, rejected)))
    assert "gear down" in text
    assert "rejected" in text
    assert "synced" not in text


def test_keys_start_points_and_quit() -> None:
    operator = Operator()
    operator.keys.press(b"p\x1b[Axq")
    assert operator.done == ["point", "quit"]
    assert operator.keys.quit


def test_a_note_is_typed_corrected_and_recorded_with_the_time_m_was_pressed() -> None:
    operator = Operator()
    operator.keys.press(b"m")
    operator.clock.advance_s(2.5)
    for pressed in (b"gear", b"s\x7f", b"\x1b[D", " qp \u00e9".encode()[:-1], "\u00e9".encode()[-1:], b"\r"):
        operator.keys.press(pressed)
    assert operator.done == ["mark gear qp é (m pressed 2.5 s before)"]
    assert operator.keys.note is None


def test_escape_drops_a_note() -> None:
    operator = Operator()
    for pressed in (b"m", b"oops", b"\x1b", b"m", b"\n"):
        operator.keys.press(pressed)
    assert operator.done == ["mark "]


@contextmanager
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A pseudo-terminal as standard input; yields the operator's end of it."""
    operator, keyboard = pty.openpty()
    try:
        with os.fdopen(keyboard, "r") as stdin:
            monkeypatch.setattr("sys.stdin", stdin)
            yield operator
    finally:
        os.close(operator)


def test_screen_runs_in_a_terminal_until_q(monkeypatch: pytest.MonkeyPatch) -> None:
    operator = Operator()

    class Eyes(io.StringIO):
        """Presses the keys on seeing the screen: what was typed before it is thrown away."""

        seen = False

        def write(self, text: str) -> int:
            if "corrected" in text and not self.seen:
                self.seen = True
                os.write(keyboard, b"pmflaps\rq")
            return super().write(text)

    out = Eyes()
    console = Console(file=out, force_terminal=True, width=100, height=30, legacy_windows=False, _environ={})
    with terminal(monkeypatch) as keyboard:
        run_panel(board_with(ALPHA), operator.callbacks, threading.Event(), operator.clock, console)
    assert operator.done == ["point", "mark flaps", "quit"]
    assert "+4.21 ± 0.24" in out.getvalue()
    assert out.getvalue().endswith("\x1b[?25h\x1b[?1049l")  # the cursor and the terminal's own screen are back


def test_screen_ends_when_the_flight_does(monkeypatch: pytest.MonkeyPatch) -> None:
    operator, stop = Operator(), threading.Event()
    stop.set()
    with terminal(monkeypatch):
        run_panel(board_with(ALPHA), operator.callbacks, stop, operator.clock, Console(file=io.StringIO()))
    assert operator.done == []


@pytest.mark.parametrize("screen_fails", [False, True])
def test_a_terminal_that_goes_away_does_not_end_the_flight(monkeypatch: pytest.MonkeyPatch, screen_fails: bool) -> None:
    operator = Operator()
    theirs, keyboard = pty.openpty()

    class Stop(threading.Event):
        """Stopped by somebody else, once it is waited for."""

        waited = False

        def wait(self, timeout: float | None = None) -> bool:
            self.waited = True
            self.set()
            return True

    class Eyes(io.StringIO):
        def write(self, text: str) -> int:
            if "corrected" in text:
                if screen_fails:
                    raise OSError(errno.EIO, "Input/output error")
                os.close(theirs)
            return super().write(text)

    stop = Stop()
    with os.fdopen(keyboard, "r") as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        console = Console(file=Eyes(), force_terminal=True, width=100, height=30, legacy_windows=False, _environ={})
        run_panel(board_with(ALPHA), operator.callbacks, stop, operator.clock, console)
    if screen_fails:
        os.close(theirs)
    assert stop.waited
    assert operator.done == []


def lines_while(board: Board, clock: ManualClock, kind: str) -> list[str]:
    """Two seconds of lines; the last event comes in the second one."""
    written: list[str] = []
    stop = threading.Event()
    target = {"plain": plain_lines, "json": json_lines}[kind]
    thread = threading.Thread(target=target, args=(board, stop, clock, written.append))
    thread.start()
    is_status = (lambda line: "|" in line) if kind == "plain" else (lambda line: True)
    for second in (1, 2):
        time.sleep(0.01)
        clock.advance_s(1.0)
        until = time.monotonic() + 20
        while sum(map(is_status, written)) < second and time.monotonic() < until:
            time.sleep(0.01)
        if second == 1:
            board.update([Event(seconds(13), "operator", Code.MARK, 1, "flaps")])
    stop.set()
    thread.join()
    return written


@pytest.fixture
def flying() -> tuple[Board, ManualClock]:
    clock = ManualClock(seconds(12))
    board = Board(None, clock, address="http://127.0.0.1:9/")
    board.recording(Path("logs/flight.mcap"), 3 * 2**20, 5)
    unsure = (*(ParamEstimate(n, float("nan"), float("nan"), Status.UNESTIMATED, "why") for n in LONGITUDINAL[1:]),)
    known = ParamEstimate("CL_alpha", 5.64, 0.06, Status.ESTIMATED)
    board.update(
        [
            Tick(START_NS, 0, START_NS),
            ALPHA,
            MethodEstimate(START_NS, "split", (known, *unsure)),
            Health(START_NS, (LINK, msgspec.structs.replace(LINK, stream="can.gyro", alive=False, age_s=float("nan")))),
            Event(seconds(3), "can.gyro", Code.STALE, 1, "nothing for 2.00 s"),
        ]
    )
    return board, clock


def test_plain_lines_tell_each_event_once_and_the_state_each_second(flying: tuple[Board, ManualClock]) -> None:
    written = lines_while(*flying, "plain")
    assert written.count("00:00:03 ALARM can.gyro STALE: nothing for 2.00 s") == 1
    assert written.count("00:00:13 info  operator MARK: flaps") == 1
    status = next(line for line in written if "|" in line)
    assert "alpha  +4.21 ± 0.24 deg" in status
    assert "CL_alpha 5.64 ± 0.12" in status
    assert "CL_q" not in status
    assert "links 1/2" in status
    assert "ALARM can.gyro STALE" in status


def test_json_lines_are_strict_json_in_si(flying: tuple[Board, ManualClock]) -> None:
    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is not JSON")

    made = [json.loads(line, parse_constant=refuse) for line in lines_while(*flying, "json")]
    first = made[0]
    assert first["schema"] == "station.run/1"
    assert first["alpha"]["alpha"] == pytest.approx(4.21 * DEG)
    assert first["turbulence"] == {"level": "light", "w_std_2_7hz_mps": 0.123}
    split = first["derivatives"]["split"]
    assert split["CL_alpha"] == {"estimate": 5.64, "std_error": 0.06, "status": "estimated", "why": ""}
    assert split["Cm_q"] == {"estimate": None, "std_error": None, "status": "unestimated", "why": "why"}
    assert first["links"]["can.gyro"]["age_s"] is None
    assert first["links"]["can.gyro"]["alive"] is False
    assert first["log"]["bytes"] == 3 * 2**20
    assert [e["code"] for e in first["alarms"]] == ["STALE"]
    told = [e["code"] for line in made for e in line["events"]]
    assert told == ["STALE", "MARK"]
