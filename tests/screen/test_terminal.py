"""The operator's terminal: what is said, what is never said, and what the keys do."""

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
from station.conventions import LATERAL, LONGITUDINAL
from station.flight.board import Board
from station.rows import (
    AlphaEstimate,
    Code,
    Event,
    Health,
    MethodEstimate,
    ParamEstimate,
    RawBlock,
    Rows,
    Status,
    StreamHealth,
    Tick,
)
from station.screen import terminal as panel
from station.screen.terminal import Callbacks, json_lines, plain_lines, run_panel

START_NS = 7_000_000_000_000
DEG = 0.017453292519943295
ALPHA = AlphaEstimate(
    START_NS,
    alpha=4.21 * DEG,
    alpha_sd=0.12 * DEG,
    vane=5.02 * DEG,
    zero=0.0,
    upwash=-0.75 * DEG,
    rate=0.02 * DEG,
    lag=0.1 * DEG,
    gust=-0.18 * DEG,
    alpha_inertial=4.1 * DEG,
    alpha_gust=0.11 * DEG,
    gust_vertical=0.11,
    turbulence_level=0.123,
    turbulence="light",
    wind_north=3.0,
    wind_east=-2.0,
    wind_down=0.1,
    valid=True,
    why="",
)
LINK = StreamHealth("boom.vanes", "boom", 199.6, 0.004, "synced", -3600.0, 30.0, 1000, 0, 0, True)


def seconds(s: float) -> int:
    return START_NS + round(s * 1e9)


def estimate(
    method: str, value: float = 5.64, sd: float = 0.06, status: Status = Status.ESTIMATED, why: str = ""
) -> Rows:
    return MethodEstimate(START_NS, method, tuple(ParamEstimate(n, value, sd, status, why) for n in LONGITUDINAL))


def board_with(*rows: Rows, now_s: float = 12.0) -> Board:
    clock = ManualClock(seconds(now_s))
    board = Board(None, clock, address="http://127.0.0.1:9/")
    board.recording(Path("logs/flight.mcap"), 3 * 2**20, 0)
    board.update([Tick(START_NS, 0, START_NS), RawBlock(START_NS, "boom", b"x"), *rows])
    return board


def screen(board: Board, now_s: float = 12.0, width: int = 100, height: int = 40, note: str | None = None) -> list[str]:
    return [str(line) for line in panel.lines(board, seconds(now_s), width, height, note)]


def line_with(lines: list[str], word: str) -> str:
    found = [line for line in lines if word in line]
    assert found, f"no line with {word!r} in\n" + "\n".join(lines)
    return found[0]


def test_angle_of_attack_is_shown_in_degrees_with_two_sd() -> None:
    lines = screen(board_with(ALPHA))
    assert "+4.21 ± 0.24" in line_with(lines, "corrected")
    assert "-0.75" in line_with(lines, "upwash")
    assert "light" in line_with(lines, "turbulence")
    assert "00:00:12" in lines[0]


def test_an_invalid_angle_is_bracketed_dimmed_and_says_why() -> None:
    board = board_with(msgspec.structs.replace(ALPHA, valid=False, why="boom.vanes stale"))
    lines = panel.lines(board, seconds(12), 100, 40, None)
    shown = next(line for line in lines if "corrected" in line.plain)
    assert "( +4.21 ± 0.24)" in shown.plain
    assert any(span.style == "dim" and "4.21" in shown.plain[span.start : span.end] for span in shown.spans)
    assert "INVALID: boom.vanes stale" in line_with([line.plain for line in lines], "ANGLE OF ATTACK")


def test_the_numbers_fit_a_terminal_of_80_columns() -> None:
    wide = msgspec.structs.replace(ALPHA, wind_north=-23.0, wind_east=-12.5, turbulence="moderate", gust_vertical=-9.87)
    assert max(len(line.plain) for line in panel.alpha_lines(board_with(wide))) <= 80


def test_a_level_that_has_not_settled_is_a_dash() -> None:
    board = board_with(msgspec.structs.replace(ALPHA, turbulence="unknown"))
    assert "0.123" not in line_with(screen(board), "turbulence")


def test_derivatives_carry_status_and_the_other_methods_stand_beside() -> None:
    board = board_with(estimate("split"), estimate("II", 4.9))
    board.accuracy = 0.1
    row = line_with(screen(board), "CL_alpha")
    assert row.split() == ["CL_alpha", "5.64", "±", "0.12", "enough", "4.90"]
    board.accuracy = 0.01
    assert "estimated" in line_with(screen(board), "CL_alpha")


@pytest.mark.parametrize(("width", "shown"), [(110, 5), (84, 4), (80, 4), (64, 2), (40, 0)])
def test_a_narrow_terminal_drops_columns_whole(width: int, shown: int) -> None:
    board = board_with(*(estimate(m, 4.917) for m in ("II", "III", "V", "split+gust", "physical", "split")))
    row = next(line.plain for line in panel.lines(board, seconds(12), width, 30, None) if "CL_alpha" in line.plain)
    assert row.split() == ["CL_alpha", "4.92", "±", "0.12", "estimated", *["4.92"] * shown]


def test_the_column_in_front_is_the_method_to_believe_first() -> None:
    health = Health(START_NS, ())
    both = estimate("split"), estimate("physical")
    assert line_with(screen(board_with(ALPHA, *both, health)), "DERIVATIVES").split()[1] == "physical"
    # Where the data prefer split's model, physical is not applicable.
    refused = msgspec.structs.replace(estimate("physical"), applicable=False, why="the data prefer split")
    assert line_with(screen(board_with(ALPHA, estimate("split"), refused, health)), "DERIVATIVES").split()[1] == "split"


def lateral(method: str, status: Status = Status.ESTIMATED, why: str = "", applicable: bool = True) -> Rows:
    """CY_p is in doubt; all others have the status given."""
    doubt = {"CY_p": (0.1, 0.09, Status.UNESTIMATED, "not significant: 2 sigma > estimate and profile value")}
    of = [ParamEstimate(n, *doubt.get(n, (-0.822, 0.0038, status, why))) for n in LATERAL]
    return MethodEstimate(START_NS, method, (*estimate(method).parameters, *of), applicable, why)


def test_lateral_derivatives_stand_in_a_table_of_their_own_with_status_and_why() -> None:
    board = board_with(ALPHA, lateral("II"), lateral("split"), Health(START_NS, ()))
    board.accuracy = 0.1
    lines = screen(board)
    title = line_with(lines, "LATERAL")
    assert title.split()[1] == "split"
    assert "14 of 15 estimated, 14 enough" in title
    assert line_with(lines, " CY ").split() == ["CY", "-0.822±0.008", "–", *["-0.822±0.008"] * 3]
    assert "CY_p: not significant: 2 sigma > estimate and profile value" in line_with(lines, "CY_p")
    assert "LATERAL" not in "".join(screen(board_with(ALPHA, estimate("split"), Health(START_NS, ()))))


def test_lateral_derivatives_are_method_ii_s_where_split_is_not_applicable() -> None:
    refused = lateral("split", applicable=False, why="no inertial angle of attack")
    board = board_with(ALPHA, lateral("II"), refused, Health(START_NS, ()))
    assert line_with(screen(board), "LATERAL").split()[1] == "II"
    nothing = board_with(ALPHA, lateral("II", Status.INVALID, "too noisy"), refused, Health(START_NS, ()))
    assert "±" not in "".join(line for line in screen(nothing) if line.strip()[:3] in ("CY ", "Cl ", "Cn "))


def test_lateral_derivatives_do_not_decide_which_method_leads() -> None:
    few = msgspec.structs.replace(lateral("split"), parameters=lateral("split").parameters[2:])
    board = board_with(ALPHA, few, estimate("physical"), Health(START_NS, ()))
    assert board.recommended == "physical"


def test_an_unestimated_derivative_is_a_dash_with_why_and_no_number() -> None:
    board = board_with(estimate("split", status=Status.UNESTIMATED, why="not enough excitation"))
    lines = screen(board)
    assert "5.64" not in "".join(lines)
    assert "–" in line_with(lines, "CL_alpha")
    assert "all: not enough excitation" in "".join(lines)


@pytest.mark.parametrize("applicable", [True, False])
def test_an_invalid_derivative_is_bracketed(applicable: bool) -> None:
    status = Status.INVALID if applicable else Status.ESTIMATED
    row = msgspec.structs.replace(estimate("split", status=status, why="x"), applicable=applicable, why="stale vane")
    text = line_with(screen(board_with(row)), "CL_alpha")
    assert "(5.64)" in text
    assert "INVALID" in text


def test_links_show_rate_age_clock_and_what_is_the_matter() -> None:
    bad = msgspec.structs.replace(LINK, stream="can.gyro", device="can", alive=False, rate_hz=0.0, age_s=2.5)
    crc = Event(seconds(11), "boom", Code.CRC, 3, "unreadable messages")
    board = board_with(Health(START_NS, (LINK, bad)), crc, Event(seconds(10), "can.gyro", Code.STALE, 1, "nothing"))
    lines = screen(board)
    shown = " ".join(line_with(lines, "boom.vanes").split())
    assert shown == "● boom.vanes 200 Hz 4 ms synced -3600.00 +30 0/0 CRC"
    assert "✗ can.gyro" in line_with(lines, "Hz   2.5 s")
    assert line_with(lines, "2.5 s").endswith("STALE")
    assert "CRC" not in line_with(screen(board, now_s=20.0), "boom.vanes")


@pytest.mark.parametrize(
    ("begin", "end"),
    [
        ((Code.STALE, "nothing"), (Code.FRESH, "STALE over after 1 s")),
        ((Code.DISCONNECT, "gone"), (Code.RECONNECT, "")),
        ((Code.DISK, "no space left"), (Code.DISK, "recording again in b.mcap")),
    ],
)
def test_alarms_stand_in_a_red_banner_until_they_are_over(begin: tuple[Code, str], end: tuple[Code, str]) -> None:
    board = board_with(Event(seconds(1), "boom", begin[0], 1, begin[1]))
    banner = next(line for line in panel.lines(board, seconds(5), 80, 30, None) if "ALARM" in line.plain)
    assert f"boom {begin[0]}" in banner.plain
    assert begin[1] in banner.plain
    assert "white on red" in str(banner.style)
    assert len(banner.plain) == 80
    board.update([Event(seconds(2), "boom", end[0], 1, end[1])])
    assert not board.alarms
    assert not [line for line in screen(board) if line.startswith(" ALARM")]


def test_the_end_of_one_condition_leaves_another_of_the_same_source() -> None:
    board = board_with(
        Event(seconds(1), "boom.vanes", Code.STALE, 1, "nothing"),
        Event(seconds(1), "boom.vanes", Code.SLOW, 1, "slow"),
        Event(seconds(2), "boom.vanes", Code.FRESH, 1, "SLOW over after 1 s"),
    )
    assert [e.code for e in board.alarms] == [Code.STALE]


def test_a_flight_is_complete_once_all_streams_were_alive_together() -> None:
    dead = msgspec.structs.replace(LINK, stream="can.gyro", alive=False)
    board = board_with(Health(START_NS, (LINK, dead)))
    assert not board.ever_complete
    board.update([Health(START_NS, (LINK, LINK))])
    board.update([Health(START_NS, (LINK, dead))])
    assert board.ever_complete


@pytest.mark.parametrize("width", [40, 80, 120, 160, 220])
@pytest.mark.parametrize("height", [8, 16, 24, 30, 50])
def test_any_terminal_is_filled_and_never_overrun(width: int, height: int) -> None:
    links = tuple(msgspec.structs.replace(LINK, stream=f"device.stream{i}") for i in range(8))
    events = [Event(seconds(i), "boom", Code.CRC, i, "unreadable messages") for i in range(20)]
    board = board_with(ALPHA, estimate("split"), estimate("II"), Health(START_NS, links), *events)
    lines = panel.lines(board, seconds(12), width, height, None)
    assert len(lines) == height
    assert all(line.cell_len <= width for line in lines)
    assert "quit" in lines[-1].plain or width < 80


def test_events_are_seen_on_a_small_terminal_with_many_links() -> None:
    links = tuple(msgspec.structs.replace(LINK, stream=f"device.stream{i}") for i in range(8))
    board = board_with(
        ALPHA, estimate("split"), Health(START_NS, links), Event(seconds(1), "operator", Code.MARK, 1, "gear down")
    )
    assert line_with(screen(board, width=80, height=24), "gear down")


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
