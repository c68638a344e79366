"""The station's end of the glance page: a second screen's content, ten times a second, to the process that serves it.

The content goes as a line of JSON through a pipe that is never waited for: a server that stalls, dies or is flooded
from the network costs the loop nothing. The socket is opened here, so that an address that cannot be is an error before
the flight, and a server that died comes back at the same address.
"""

from __future__ import annotations

import contextlib
import ipaddress
import os
import secrets
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from typing import IO, Any, Final

import msgspec

from station.clock import Clock
from station.conventions import from_si
from station.flight.board import Board
from station.flight.guide import Guide, Phase
from station.rows import Code, Event, Level, UsageError
from station.screen.answers import (
    alpha_answer,
    alpha_text,
    derivatives,
    every_derivative,
    hms,
    is_alive,
    losses_words,
    phase_words,
    point_answer,
    wrong_answer,
)
from station.screen.plots import event_text, is_routine

PERIOD_NS: Final = 100_000_000
LOOPBACK: Final = "127.0.0.1"
LAST_EVENTS: Final = 30
POINTS_DRAWN: Final = 150
"""Of a step's input: a tablet has not many more pixels for it."""
START_NS: Final = 10_000_000_000
LEAST_TOKEN: Final = 12
LETTERS: Final = "abcdefghjkmnpqrstuvwxyz23456789"
"""Of a token: none that is taken for another when it is typed."""
MOST_PORT: Final = 65535


def content(board: Board, now_ns: int) -> dict[str, Any]:
    """All that the page shows now, as words and numbers: schema "station.glance/1"; angles in degrees."""
    a, point = board.alpha, board.point
    health = board.health
    streams = () if health is None else health.streams
    asked = () if board.guide is None else tuple(board.guide.step.accept)
    told = [e for _, e in board.events_after(0) if e.level is not Level.INFO and not is_routine(e)]
    return {
        "schema": "station.glance/1",
        "title": board.title,
        "elapsed": hms(board.elapsed_s(now_ns)),
        "sent_s": round(now_ns * 1e-9, 3),
        "flight": board.start_ns or 0,
        "age_s": round(max(0.0, (now_ns - board.tick_ns) * 1e-9), 2) if board.tick_ns else None,
        "answers": {
            "alpha": alpha_answer(board),
            "point": point_answer(board),
            "wrong": wrong_answer(board, now_ns),
        },
        "alpha": None
        if a is None
        else {
            "text": alpha_text(a).strip(),
            "valid": a.valid,
            "value": from_si(a.alpha, "deg"),
            "bound": from_si(2 * a.alpha_sd, "deg"),
            "vane": from_si(a.vane, "deg"),
            "air": a.turbulence,
        },
        "method": board.recommended,
        "derivatives": every_derivative(board, [*asked, *(n for n in board.derivatives if n not in asked)]),
        "lateral_method": board.lateral_method,
        "lateral": derivatives(board, [n for n in board.lateral if n not in asked]),
        "step": None if board.guide is None else _step(board.guide),
        "test_point": None if point is None else {"number": point.count, "since_s": (now_ns - point.t_ns) * 1e-9},
        "alarms": [_told(e, board) for e in reversed(board.alarms)],
        "checks": [_told(e, board) for e in reversed(board.disagreements)],
        "events": [_told(e, board) for e in reversed(told[-LAST_EVENTS:])],
        "links": {
            "of": len(streams),
            "alive": sum(is_alive(board, s, now_ns) for s in streams),
            "poor": [s.stream for s in streams if not is_alive(board, s, now_ns)],
        },
        "losses": losses_words(board),
    }


def _told(event: Event, board: Board) -> dict[str, str]:
    return {
        "at": hms(board.elapsed_s(event.t_ns)),
        "level": event.level.name.lower(),
        "source": event.source,
        "text": event_text(event),
    }


def _step(guide: Guide) -> dict[str, Any]:
    shown = guide.shown
    is_over = shown.phase is Phase.DONE
    return {
        "name": guide.step.name,
        "number": shown.number,
        "of": len(guide.steps),
        "run": shown.run,
        "runs": guide.step.repeats,
        "phase": shown.phase,
        "words": phase_words(guide),
        "configuration": guide.step.condition.configuration,
        "checks": [] if is_over else [{"words": c.words, "good": c.good} for c in shown.checks],
        "since_s": shown.since_s,
        "inputs": [] if is_over else _inputs(guide),
        "verdict": None if shown.verdict is None else {"kind": shown.verdict.kind, "words": shown.verdict.words},
        "results": [{"name": name, "ended": how} for name, how in shown.results],
    }


def _inputs(guide: Guide) -> list[dict[str, Any]]:
    """What each surface shall do, and what it has done, in degrees about its trim; null for what is to come."""
    made = []
    for name, drawn in guide.table.surfaces.items():
        flown = guide.flown.get(name, drawn[:0])
        every = max(1, -(-len(drawn) // POINTS_DRAWN))
        made.append(
            {
                "surface": name,
                "duration_s": float(guide.table.t_s[-1]),
                "drawn": [round(from_si(x, "deg"), 2) for x in drawn[::every].tolist()],
                # Of another step while the loop goes on.
                "flown": [round(from_si(x, "deg"), 2) for x in flown[::every].tolist()]
                if len(flown) == len(drawn)
                else [],
            }
        )
    return made


def new_token() -> str:
    """60 bits and short enough to be typed on a tablet: k7qm-3xtp-9wz2."""
    return "-".join("".join(secrets.choice(LETTERS) for _ in range(4)) for _ in range(3))


class GlanceFeed:
    """Serves what a board says from `start` to `close`; nothing but `close` waits for the server.

    `serve`: ADDRESS[:PORT] to listen on, with a token; loopback and without one if None.
    """

    def __init__(self, serve: str | None = None, token: str | None = None) -> None:
        """Raises UsageError for an address that this machine does not have, or that is taken."""
        self.token = "" if serve is None else checked_token(token) if token is not None else new_token()
        self._socket = listening(*(address_of(serve) if serve is not None else (LOOPBACK, 0)))
        host, port = self._socket.getsockname()[:2]
        self.origin = f"http://{f'[{host}]' if ':' in host else host}:{port}/"
        self.address = self.origin + (f"?token={self.token}" if self.token else "")
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._encoder = msgspec.json.Encoder()

    def start(self, board: Board, clock: Clock, put: Callable[[Event], None]) -> None:
        """`put` is told when the server dies and is started again."""
        self._thread = threading.Thread(target=self._run, args=(board, clock, put), name="glance", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the server and the thread."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        self._socket.close()

    def _run(self, board: Board, clock: Clock, put: Callable[[Event], None]) -> None:
        told = set[str]()

        def shown() -> dict[str, Any] | None:
            try:
                return content(board, clock.now_ns())
            except Exception as error:  # the board changes while it is read, and no page ends a flight
                why = f"{type(error).__name__}: {error}"
                if why not in told:
                    told.add(why)
                    put(Event(clock.now_ns(), "glance", Code.VIEW, 1, f"glance page: not shown for a moment ({why})"))
                return None

        backoff_s = 1.0
        while True:
            began_ns = clock.now_ns()
            with tempfile.TemporaryFile() as errors:
                why = self._serve(shown, errors)
            if self._stop.is_set():
                return
            backoff_s = 1.0 if clock.now_ns() - began_ns > START_NS else min(2 * backoff_s, 30.0)
            words = f"glance page lost ({why}); starting it again in {backoff_s:g} s"
            put(Event(clock.now_ns(), "glance", Code.VIEW, 1, words))
            if self._stop.wait(backoff_s):
                return

    def _serve(self, shown: Callable[[], dict[str, Any] | None], errors: IO[bytes]) -> str:
        """Feed one server until it ends or `close`; why it ended."""
        try:
            process = subprocess.Popen(
                [sys.executable, "-m", "station.screen.glance_server", str(self._socket.fileno())],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                pass_fds=[self._socket.fileno()],
                start_new_session=True,  # Ctrl-C is the station's to handle
                env={**os.environ, "STATION_TOKEN": self.token},
            )
        except OSError as error:
            return str(error)
        assert process.stdin is not None
        pipe = process.stdin
        try:
            os.set_blocking(pipe.fileno(), False)
            pending = b""
            while process.poll() is None:
                if self._stop.wait(PERIOD_NS * 1e-9):
                    break
                if not pending and (now := shown()) is not None:
                    pending = self._encoder.encode(now) + b"\n"
                with contextlib.suppress(BlockingIOError):  # what it has not read grows old there: it is skipped here
                    pending = pending[os.write(pipe.fileno(), pending) :]
        except OSError:
            process.wait(1.0)
        finally:
            with contextlib.suppress(OSError):
                pipe.close()  # the server's sign to end
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(1.0)
            process.kill()
            code = process.wait()
        errors.seek(0)
        last = errors.read()[-2000:].decode(errors="replace").strip().rpartition("\n")[2]
        return f"ended with code {code}" + (f": {last[:200]}" if last else "")


def address_of(text: str) -> tuple[str, int]:
    """ADDRESS[:PORT] as an IP address and a port, 0 for any. Raises UsageError."""
    host, colon, port = text.rpartition(":") if text.startswith("[") or text.count(":") == 1 else (text, "", "")
    if text.endswith("]"):
        host, colon, port = text, "", ""
    host = host.removeprefix("[").removesuffix("]")
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        raise UsageError(
            f"--serve: {text!r} is not ADDRESS[:PORT]\n"
            "give the IP address of this machine that the other screen can reach, e.g. 192.168.1.20:8080"
        ) from None
    if colon and not (port.isascii() and port.isdigit() and 0 < int(port) <= MOST_PORT):
        raise UsageError(f"--serve: {port!r} is not a port: 1 to {MOST_PORT}, above 1023 without special rights")
    return str(address), int(port or 0)


def listening(host: str, port: int) -> socket.socket:
    """A socket that listens there. Raises UsageError."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    made = socket.socket(family, socket.SOCK_STREAM)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            made.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        made.bind((host, port))
        made.listen(16)
        made.setblocking(False)
    except OSError as error:
        made.close()
        raise UsageError(
            f"--serve {host}:{port}: cannot be served there: {error.strerror}\n"
            "give an address of this machine (ip address lists them) and a port that is free, or none"
        ) from None
    return made


def checked_token(token: str) -> str:
    """A token that whoever reads the network's addresses cannot guess. Raises UsageError."""
    if len(token) < LEAST_TOKEN or not all(c.isascii() and (c.isalnum() or c in "-_.~") for c in token):
        raise UsageError(
            f"--token: at least {LEAST_TOKEN} letters and figures, and - _ . ~\nleft out, one is made and printed"
        )
    return token
