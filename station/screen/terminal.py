"""The operator's terminal: a screen drawn four times a second, or plain or JSON lines where there is no terminal.

A number without status is never shown as valid: what is not estimated is a dash, what is invalid is dimmed with why.
"""

from __future__ import annotations

import codecs
import contextlib
import json
import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from textwrap import wrap
from typing import Final

from rich.cells import set_cell_size
from rich.console import Console, ConsoleOptions, RenderResult
from rich.live import Live
from rich.text import Text

from station.clock import Clock
from station.flight.board import Board
from station.rows import AlphaEstimate, Code, Level
from station.screen.answers import (
    NO_ALPHA,
    SLOW_PAGE_S,
    alpha_answer,
    alpha_text,
    baseline_answer,
    degrees,
    derivatives,
    fixed,
    hms,
    losses_words,
)
from station.screen.derivative_tables import TITLE, derivative_lines, drag_lines, lateral_lines, lateral_summary, styled
from station.screen.event_groups import EventGate, grouped
from station.screen.guide_lines import guide_keys, guide_lines
from station.screen.link_lines import link_lines
from station.screen.plots import event_text, is_routine
from station.screen.point_table import point_lines
from station.screen.signal_lines import signal_lines, signal_words

__all__ = ["Board", "Callbacks", "json_lines", "plain_lines", "run_panel"]

REFRESH_S: Final = 0.25
SECOND_NS: Final = 1_000_000_000
TWO_COLUMNS: Final = 160
"""Terminals as wide as this get the links and events beside the numbers."""
LEFT: Final = 86
_LEVEL_STYLES: Final = {Level.INFO: "", Level.WARNING: "yellow", Level.ALARM: "bold red"}
_LEVEL_WORDS: Final = {Level.INFO: "info", Level.WARNING: "warn", Level.ALARM: "ALARM"}
BASELINE_STYLES: Final = {"good": "green", "doubt": "bold black on yellow", "none": "yellow"}
MOST_ALARMS: Final = 4
MOST_WARNINGS: Final = 3
LINES_OF_CHANGE: Final = 3
MOST_POINTS: Final = 9
"""Lines of the table of finished points, its title one of them; the page shows all."""
FEWEST_POINTS: Final = 3
FEWEST_EVENTS: Final = 4
"""Lines that the points leave to the events."""
LONGEST_NOTE: Final = 200
GUIDE_KEYS: Final = "nrsa"
MARK_DELAY_S: Final = 0.05
"""A mark typed this long after the key m says so."""


@dataclass(frozen=True, slots=True)
class Callbacks:
    """What the keys do. `on_point` starts or ends a test point: the number of the one now open, None if none is."""

    on_mark: Callable[[str], None]
    on_point: Callable[[], int | None]
    on_quit: Callable[[], None]
    on_step: Callable[[str], None] = lambda _: None
    """One of the guide's keys."""


def run_panel(
    board: Board, callbacks: Callbacks, stop: threading.Event, clock: Clock, console: Console | None = None
) -> None:
    """Draw the screen and obey the keys until q is pressed or `stop` is set. Blocks; the terminal is put right after.

    The keyboard is standard input, which must be a terminal.
    """
    keyboard = sys.stdin.fileno()
    before = termios.tcgetattr(keyboard)
    keys = _Keys(callbacks, clock)
    screen = _Screen(board, keys, clock)
    try:
        tty.setcbreak(keyboard)
        with Live(screen, console=console, screen=True, auto_refresh=False) as live:
            alarmed = 0
            while not stop.is_set() and not keys.quit:
                live.refresh()
                alarms = heard(board)
                if alarms > alarmed:
                    live.console.bell()
                alarmed = alarms
                if not select.select([keyboard], [], [], REFRESH_S)[0]:
                    continue
                pressed = os.read(keyboard, 1024)
                if not pressed:
                    raise OSError("end of input")
                keys.press(pressed)
    except OSError:  # the terminal is gone: the flight goes on until it is stopped
        stop.wait()
    finally:
        with contextlib.suppress(termios.error):
            termios.tcsetattr(keyboard, termios.TCSADRAIN, before)


def heard(board: Board) -> int:
    """For how much the terminal's bell rings, once each: alarms, and an aircraft that is not as its baseline."""
    return len(board.alarms) + sum(e.code is Code.CHANGED for e in board.disagreements)


class _Keys:
    """Turns key presses into callbacks; holds the note being typed."""

    def __init__(self, callbacks: Callbacks, clock: Clock) -> None:
        self.note: str | None = None
        self.quit = False
        self._callbacks = callbacks
        self._clock = clock
        self._marked_ns = 0
        self._decoder = codecs.getincrementaldecoder("utf-8")("ignore")

    def press(self, pressed: bytes) -> None:
        """Bytes from the terminal. Sequences of arrow and function keys are ignored."""
        if pressed.startswith(b"\x1b") and len(pressed) > 1:
            return
        for key in self._decoder.decode(pressed):
            if self.note is None:
                self._command(key)
            else:
                self._type(key, self.note)

    def _command(self, key: str) -> None:
        if key in "mM":
            self.note, self._marked_ns = "", self._clock.now_ns()
        elif key in "pP":
            self._callbacks.on_point()
        elif key in "qQ":
            self.quit = True
            self._callbacks.on_quit()
        elif key.lower() in GUIDE_KEYS:
            self._callbacks.on_step(key.lower())

    def _type(self, key: str, note: str) -> None:
        if key in "\r\n":
            late_s = (self._clock.now_ns() - self._marked_ns) * 1e-9
            self._callbacks.on_mark(
                f"{note} (m pressed {late_s:.1f} s before)".lstrip() if late_s >= MARK_DELAY_S else note
            )
            self.note = None
        elif key == "\x1b":
            self.note = None
        elif key in "\x7f\b":
            self.note = note[:-1]
        elif key.isprintable() and len(note) < LONGEST_NOTE:
            self.note = note + key


@dataclass(frozen=True, slots=True)
class _Screen:
    """The whole screen, drawn anew each time that rich asks."""

    board: Board
    keys: _Keys
    clock: Clock

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width, height = options.max_width, options.height or console.height
        yield Text("\n").join(lines(self.board, self.clock.now_ns(), width, height, self.keys.note))


def lines(board: Board, now_ns: int, width: int, height: int, note: str | None) -> list[Text]:
    """The screen's lines, no more than `height` of them and none wider than `width`."""
    top = [*_header(board, now_ns), *_banner(board, width)]
    wide = LEFT if width >= TWO_COLUMNS else width
    numbers = [*alpha_lines(board), Text(), *derivative_lines(board, wide), *drag_lines(board), *lateral_lines(board)]
    if board.guide is not None:
        kept = list(alpha_lines(board)) if width >= TWO_COLUMNS else list(alpha_lines(board))[:2]
        numbers = [*guide_lines(board.guide, wide), *kept]
        moved = board.guide.table.surfaces if board.guide.steps else {}
        # Of a step that leaves the elevator alone, and has little room, only the lateral ones.
        numbers += derivative_lines(board, wide) if "elevator" in moved or width >= TWO_COLUMNS else ()
        numbers += drag_lines(board)
        numbers += lateral_lines(board)
    numbers += signal_lines(board, wide)
    links = list(link_lines(board, now_ns))
    room = height - len(top) - 1
    if width >= TWO_COLUMNS:
        numbers += [Text(), *point_lines(board, LEFT, MOST_POINTS)]
        right = [*links, Text()]
        body = [Text(), *_side_by_side(numbers, [*right, *_event_lines(board, room - len(right) - 2)])]
    else:
        body = [Text(), *numbers, Text(), *links, Text()]
        fewest = FEWEST_EVENTS + (FEWEST_POINTS if board.points.ended else 0)
        if room < len(body) + fewest:
            body = [line for line in body if line]
        if room < len(body) + fewest:
            body = [line for line in (*numbers, *link_lines(board, now_ns, only_bad=True)) if line]
        body += point_lines(board, width, min(room - len(body) - FEWEST_EVENTS, MOST_POINTS))
        body += _event_lines(board, room - len(body) - 1)
    body = body[:room]
    body += [Text()] * (room - len(body))
    made = [*top, *body, _footer(note, guide_keys(board.guide) if board.guide else ())]
    for line in made:
        line.truncate(width)
        line.no_wrap = True
    return made


def _side_by_side(left: list[Text], right: list[Text]) -> Iterator[Text]:
    for i in range(max(len(left), len(right))):
        line = Text().append_text(left[i]) if i < len(left) else Text()
        line.truncate(LEFT, pad=True)
        yield line.append_text(right[i]) if i < len(right) else line


def _header(board: Board, now_ns: int) -> Iterator[Text]:
    line = Text(" ").append(hms(board.elapsed_s(now_ns)), "bold").append("  ")
    point = board.point
    if point is not None:
        since_s = max(0.0, (now_ns - point.t_ns) * 1e-9)
        line.append(f" TEST POINT {point.count}  {since_s:.0f} s ", "bold black on green").append("  ")
    yield line.append(board.title, "bold")
    line = styled(" log  ", "dim").append(f"{board.log_bytes / 2**20:.1f} MiB")
    line.append(f"  {losses}" if (losses := losses_words(board)) else "", "yellow")
    if (baseline := baseline_answer(board)) is not None:
        line.append("  baseline ", "dim").append(baseline.words, BASELINE_STYLES[baseline.state])
    if board.address:
        late = board.view_behind_s > SLOW_PAGE_S
        line.append("  page ", "dim").append(f"{board.view_behind_s:.1f} s behind", "yellow" if late else "dim")
    yield line.append(f"  {board.log_path}")
    if board.address:
        line = Text(f" {board.address}")
        if board.view_dropped:
            line.append(f"  {board.view_dropped} ticks not shown", "yellow")
        yield line
    if board.glance_address:
        yield Text(f" {board.glance_address}")


def _banner(board: Board, width: int) -> Iterator[Text]:
    for alarm in board.alarms[:MOST_ALARMS]:
        text = f" ALARM  {alarm.source} {alarm.code}  {hms(board.elapsed_s(alarm.t_ns))}  {alarm.detail}"
        yield Text(set_cell_size(text, width), "bold white on red")
    if len(board.alarms) > MOST_ALARMS:
        more = f" and {len(board.alarms) - MOST_ALARMS} more alarms"
        yield Text(set_cell_size(more, width), "bold white on red")
    disagreements = board.disagreements
    for warning in disagreements[-MOST_WARNINGS:]:
        is_change = warning.code is Code.CHANGED
        head = "AIRCRAFT CHANGED" if is_change else "CHECK"
        text = f" {head}  {hms(board.elapsed_s(warning.t_ns))}  {warning.detail}"
        for line in wrap(text, width, subsequent_indent=" ")[:LINES_OF_CHANGE] if is_change else [text]:
            yield Text(set_cell_size(line, width), "bold black on yellow")
    if len(disagreements) > MOST_WARNINGS:
        text = f" and {len(disagreements) - MOST_WARNINGS} more to check"
        yield Text(set_cell_size(text, width), "bold black on yellow")


def alpha_lines(board: Board) -> Iterator[Text]:
    a = board.alpha
    title = styled(" ANGLE OF ATTACK [deg]", TITLE)
    if a is None:
        yield title
        yield styled(f"   {NO_ALPHA[board.estimators]}", "dim")
        return
    answer = alpha_answer(board)
    if answer.state != "good":
        title.append(f"   {answer.words}: {answer.why}", "bold red" if answer.state == "bad" else "yellow")
    yield title
    main = "bold green" if a.valid else "dim"
    yield (
        Text("   corrected ")
        .append(alpha_text(a), main)
        .append("  vane ", "dim")
        .append(degrees(a.vane))
        .append("   inertial ", "dim")
        .append(degrees(a.alpha_inertial))
        .append("   gust part ", "dim")
        .append(degrees(a.alpha_gust), "" if a.valid else "dim")
    )
    line = styled("   corrections", "dim")
    own = ("instrument",) if a.instrument else ()
    for name in (*own, "zero", "upwash", "rate", "lag", "gust"):
        line.append(f"  {name} ", "dim").append(degrees(getattr(a, name)), "" if a.valid else "dim")
    yield line
    yield _air_line(a)


def _air_line(a: AlphaEstimate) -> Text:
    styles = {"calm": "green", "light": "green", "moderate": "yellow", "severe": "bold red"}
    line = styled("   turbulence ", "dim").append(f"{a.turbulence:<8}", styles.get(a.turbulence, "dim"))
    settled = a.turbulence != "unknown"
    line.append(f" {a.turbulence_level:5.3f} m/s" if settled else "    –    ", "" if settled else "dim")
    return (
        line.append("  w gust ", "dim")
        .append(fixed(a.gust_vertical, "+6.2f"), "" if a.valid else "dim")
        .append(" wind N E D ", "dim")
        .append(" ".join(fixed(w, "+5.1f") for w in (a.wind_north, a.wind_east, a.wind_down)))
        .append(" m/s", "dim")
    )


def _event_lines(board: Board, count: int) -> list[Text]:
    """The title and the last events, `count` of them; nothing if there is room for none."""
    if count < 1:
        return []
    lines = [styled(" EVENTS", TITLE)]
    for event in grouped(event for _, event in board.events_after(0) if not is_routine(event))[-count:]:
        style = _LEVEL_STYLES[event.level]
        lines.append(styled(f"   {hms(board.elapsed_s(event.t_ns))} ", "dim").append(event_text(event), style))
    return lines


def _footer(note: str | None, more: tuple[tuple[str, str], ...] = ()) -> Text:
    if note is not None:
        return (
            styled(" note: ", "bold black on yellow")
            .append(f" {note}█")
            .append("   Enter records  Esc drops it", "dim")
        )
    line = Text()
    usual = (("m", "mark an event"), ("p", "start/end test point"), ("q", "quit"))
    for key, what in (*more, ("m", "note"), usual[-1]) if more else usual:
        line.append(f" {key} ", "reverse").append(f" {what}   ")
    return line


def plain_lines(board: Board, stop: threading.Event, clock: Clock, write: Callable[[str], None]) -> None:
    """Without a terminal: events as they come, like ones together, and a status line a second, until `stop` is set."""
    told, due_ns, gate = 0, clock.now_ns(), EventGate()
    ended = False
    while not ended:
        ended = stop.wait(0.1)
        newest = board.events_after(told)
        told = newest[-1][0] if newest else told
        passed = gate.passed((e for _, e in newest if not is_routine(e)), clock.now_ns())
        for event in (*passed, *(gate.rest() if ended else ())):
            time = hms(board.elapsed_s(event.t_ns))
            write(f"{time} {_LEVEL_WORDS[event.level]:<5} {event_text(event)}")
        if clock.now_ns() >= due_ns or ended:
            due_ns += SECOND_NS
            write(_status_line(board))


def _status_line(board: Board) -> str:
    parts = [hms(board.elapsed_s())]
    a = board.alpha
    if a is None:
        parts.append(f"alpha – ({NO_ALPHA[board.estimators]})")
    else:
        alpha = f"alpha{alpha_text(a)}deg" if a.valid else f"alpha invalid: {a.why}"
        parts += [alpha, f"turbulence {a.turbulence}"]
    shown = [f"{d.name} {d.value} {d.bound}" for d in derivatives(board) if d.bound]
    parts.append(", ".join(shown) if shown else "derivatives unestimated")
    if board.lateral:
        parts.append(f"lateral {lateral_summary(board)}")
    if board.signals:
        parts.append(signal_words(board))
    if board.health is not None:
        streams = board.health.streams
        parts.append(f"links {sum(s.alive for s in streams)}/{len(streams)}")
    parts.append(f"log {board.log_bytes / 2**20:.1f} MiB")
    parts += [f"ALARM {e.source} {e.code}" for e in board.alarms]
    parts += [f"CHECK {e.detail}" for e in board.disagreements]
    return " | ".join(parts)


def json_lines(board: Board, stop: threading.Event, clock: Clock, write: Callable[[str], None]) -> None:
    """One JSON object a second, schema "station.run/1", each with the events since the one before, until `stop`."""
    told, due_ns = 0, clock.now_ns()
    ended = False
    while not ended:
        ended = stop.wait(0.1)
        if clock.now_ns() >= due_ns or ended:
            due_ns += SECOND_NS
            newest = board.events_after(told)
            write(json.dumps(board.snapshot(newest), allow_nan=False))
            told = newest[-1][0] if newest else told
