"""A board as the flight's loop fills it, for what shows it."""

from __future__ import annotations

from pathlib import Path

from station.clock import ManualClock
from station.conventions import LONGITUDINAL
from station.flight.board import Board
from station.rows import (
    AlphaEstimate,
    MethodEstimate,
    ParamEstimate,
    RawBlock,
    Rows,
    Status,
    StreamHealth,
    Tick,
)
from station.screen import terminal as panel

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
