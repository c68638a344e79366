"""The station's end of the operator's page: feeds the process that draws it, and outlives it.

A bounded queue that drops its oldest, and a thread that feeds `python -m station.screen.rerun_page` through a pipe. The
pipe carries length-prefixed msgpack: one Setup, then Batches; the child answers a byte for each it has shown.
"""

from __future__ import annotations

import contextlib
import os
import selectors
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import IO, TYPE_CHECKING, Final
from urllib.parse import quote

import msgspec

from station.clock import Clock, SystemClock
from station.conventions import TICK_HZ
from station.estimation.method_table import LIVE_LATERAL
from station.rows import Code, Event, Row, Rows
from station.screen import plots
from station.screen.brief import Brief
from station.screen.plots import Batch, Setup
from station.screen.signal_plots import signals_of
from station.screen.simulation_beside import given

if TYPE_CHECKING:
    from station.profile import Profiles

QUEUE_TICKS: Final = 1000
"""20 s of ticks: the child needs about 4 s to start."""
BATCH_TICKS: Final = 50
BATCH_NS: Final = 1_000_000_000
MAX_BATCH_TICKS: Final = 100
UNANSWERED: Final = 2
"""Batches in flight before the queue waits: what is shown is never older than that."""
STALLED_NS: Final = 2_000_000_000
GIVE_UP_NS: Final = 30_000_000_000
START_NS: Final = 60_000_000_000
LENGTH: Final = struct.Struct("<I")


class View:
    """The station's end of the page; `mode` is "web", "native" or "none".

    No method but `flush` waits for the child; `close` gives it a second to end.

    `on_event` is called from the view's own thread with Event(Code.VIEW) when the child dies, restarts, stalls or goes
    on. A child that is dead, or silent for 30 s, is replaced after a backoff of 1 s to 30 s.
    """

    def __init__(
        self,
        mode: str,
        title: str,
        profiles: Profiles | None = None,
        on_event: Callable[[Event], None] = lambda _: None,
        clock: Clock | None = None,
    ) -> None:
        self.mode = mode
        self.address = ""
        self.dropped = 0
        """Ticks not shown because the child did not keep up."""
        self.behind_s = 0.0
        """Age of the oldest tick handed over that the child has not shown. What a browser is behind comes on top: Rerun
        tells it nobody but its own user, in its top bar."""
        self.brief: Callable[[], Brief] | None = None
        """What the station says of itself, asked with each batch from the view's thread; of a replay nothing."""
        self._title = title
        self._profiles = profiles
        self._on_event = on_event
        self._clock = clock or SystemClock()
        self._queue: deque[tuple[int, list[Row]]] = deque()
        """Ticks, each with when it was handed over."""
        self._flying: deque[int] = deque()
        """When the oldest ticks of the batches in flight were handed over."""
        self._start_ns: int | None = None
        self._stop = threading.Event()
        self._idle = threading.Event()
        self._thread: threading.Thread | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._ready = False
        self._stalled = False
        self._opened = False
        self._ports = (0, 0)

    @property
    def alive(self) -> bool:
        """Whether the page is up and keeps up."""
        return self._ready and not self._stalled

    @property
    def pid(self) -> int | None:
        """The child's process, None where there is none now."""
        process = self._process
        return None if process is None else process.pid

    def start(self) -> str:
        """Start the child and return the page's address at once ("" for mode "none"); the page answers in seconds."""
        if self.mode == "none" or self._thread is not None:
            return self.address
        self._choose_ports()
        self._thread = threading.Thread(target=self._run, name="view", daemon=True)
        self._thread.start()
        return self.address

    def show(self, rows: Sequence[Rows]) -> None:
        """Hand over the rows of a tick; the oldest are dropped when the child lags."""
        if self._thread is None:
            return
        if self._start_ns is None:
            self._start_ns = plots.start_of(rows)
        shown = plots.SHOWN
        kept: list[Row] = [row for row in rows if type(row) in shown]
        if not kept:
            return
        if len(self._queue) >= QUEUE_TICKS:
            with contextlib.suppress(IndexError):  # the sender may have emptied it meanwhile
                self._queue.popleft()
                self.dropped += 1
        self._queue.append((self._clock.now_ns(), kept))
        self._idle.clear()

    def flush(self, timeout_s: float) -> bool:
        """Wait until all that was handed over is shown; whether it is."""
        return self._thread is None or self._idle.wait(timeout_s)

    def close(self) -> None:
        """End the child and the thread."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _choose_ports(self) -> None:
        with socket.socket() as a, socket.socket() as b:
            for s in (a, b):
                s.bind(("127.0.0.1", 0))
            self._ports = (a.getsockname()[1], b.getsockname()[1])
        self.address = page_address(self.mode, *self._ports)

    def _report(self, detail: str) -> None:
        self._on_event(Event(self._clock.now_ns(), "view", Code.VIEW, 1, detail))

    def _setup(self) -> Setup:
        open_page = not self._opened and bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
        self._opened = True
        return setup_for(
            self._profiles,
            title=self._title,
            mode=self.mode,
            port=self._ports[0],
            web_port=self._ports[1],
            open_page=open_page and self.mode == "web",
            is_guided=self.brief is not None,
        )

    def _run(self) -> None:
        backoff_s = 1.0
        while True:
            started_ns = self._clock.now_ns()
            with tempfile.TemporaryFile() as errors:
                why = self._feed_new_child(errors)
            was_up, self._ready, self._stalled = self._ready, False, False
            if self._stop.is_set():
                return
            if self._clock.now_ns() - started_ns > GIVE_UP_NS:
                backoff_s = 1.0
            self._report(f"page lost ({why}); starting it again in {backoff_s:g} s")
            if self._stop.wait(backoff_s):
                return
            backoff_s = min(2 * backoff_s, 30.0)
            if not was_up:
                self._choose_ports()  # another program may have taken them

    def _feed_new_child(self, errors: IO[bytes]) -> str:
        """Run one child until it ends or `close`; why it ended."""
        try:
            process = subprocess.Popen(
                [sys.executable, "-m", "station.screen.rerun_page"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                start_new_session=True,  # Ctrl-C is the station's to handle; and the server can be ended with the child
                env={**os.environ, "CI": "1", "RUST_LOG": "error"},  # CI is Rerun's switch against analytics
            )
        except OSError as error:
            return str(error)
        self._process = process
        try:
            why = self._feed(process)
        finally:
            self._process = None
            if self._stop.is_set():
                with contextlib.suppress(OSError):
                    assert process.stdin is not None
                    process.stdin.close()  # the child's sign to end
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(1.0)
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            for pipe in (process.stdin, process.stdout):
                with contextlib.suppress(OSError):
                    assert pipe is not None
                    pipe.close()
        errors.seek(0)
        last = errors.read()[-2000:].decode(errors="replace").strip().rpartition("\n")[2]
        return f"{why}: {last[:200]}" if last else why

    def _feed(self, process: subprocess.Popen[bytes]) -> str:
        assert process.stdin is not None
        assert process.stdout is not None
        to_child, from_child = process.stdin.fileno(), process.stdout.fileno()
        os.set_blocking(to_child, False)
        os.set_blocking(from_child, False)
        encoder = msgspec.msgpack.Encoder()
        pending = _framed(encoder.encode(self._setup()))
        self._flying.clear()
        unanswered = 1
        moved_ns = sent_ns = self._clock.now_ns()
        with selectors.DefaultSelector() as selector:
            selector.register(from_child, selectors.EVENT_READ)
            while not self._stop.is_set():
                now_ns = self._clock.now_ns()
                limit_ns = GIVE_UP_NS if self._ready else START_NS
                if not unanswered and not pending:
                    moved_ns = now_ns
                elif now_ns - moved_ns > limit_ns:
                    return f"silent for {limit_ns // 10**9} s"
                elif self._ready and not self._stalled and now_ns - moved_ns > STALLED_NS:
                    self._stalled = True
                    self._report("page stalled; the station goes on")
                try:
                    if pending:
                        pending = pending[os.write(to_child, pending) :]
                except BlockingIOError:
                    pass
                except OSError:
                    return _ending(process)
                if selector.select(0.02 if pending else 0.1):
                    answered = len(os.read(from_child, 4096))
                    if not answered:
                        return _ending(process)
                    unanswered = max(0, unanswered - answered)
                    while len(self._flying) > unanswered:
                        self._flying.popleft()
                    moved_ns = self._clock.now_ns()
                    if self._stalled:
                        self._stalled = False
                        self._report("page goes on")
                    self._ready = True
                self.behind_s = self._behind_s(now_ns)
                if not self._queue and not unanswered:
                    self._idle.set()
                full = len(self._queue) >= BATCH_TICKS or (self._queue and now_ns - sent_ns >= BATCH_NS)
                if full and self._ready and not pending and unanswered < UNANSWERED:
                    pending = _framed(encoder.encode(self._take()))
                    unanswered += 1
                    sent_ns = now_ns
        return "closed"

    def _take(self) -> Batch:
        taken: list[Row] = []
        oldest_ns = 0
        for _ in range(min(len(self._queue), MAX_BATCH_TICKS)):
            with contextlib.suppress(IndexError):  # show() drops from the same end
                handed_ns, rows = self._queue.popleft()
                oldest_ns = oldest_ns or handed_ns
                taken.extend(rows)
        self._flying.append(oldest_ns)
        return plots.batch(taken, self._start_ns or 0, self.brief() if self.brief is not None else None, self.behind_s)

    def _behind_s(self, now_ns: int) -> float:
        oldest_ns = self._flying[0] if self._flying else 0
        with contextlib.suppress(IndexError):  # show() drops from the same end
            oldest_ns = oldest_ns or self._queue[0][0]
        # What was handed over since the clock was read is not late.
        return max(0, now_ns - oldest_ns) * 1e-9 if oldest_ns else 0.0


def page_address(mode: str, port: int, web_port: int) -> str:
    """What to open: the page, or what a native viewer connects to."""
    data = f"rerun+http://127.0.0.1:{port}/proxy"
    return f"http://127.0.0.1:{web_port}/?theme=dark&url={quote(data, safe=':/')}" if mode == "web" else data


def _framed(message: bytes) -> memoryview:
    return memoryview(LENGTH.pack(len(message)) + message)


def _ending(process: subprocess.Popen[bytes]) -> str:
    try:
        code = process.wait(1.0)
    except subprocess.TimeoutExpired:
        return "closed its pipe"
    return f"ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"


def setup_for(
    profiles: Profiles | None,
    *,
    title: str,
    mode: str = "none",
    port: int = 0,
    web_port: int = 0,
    open_page: bool = False,
    is_guided: bool = False,
) -> Setup:
    """What the page shows beside the rows, from the flight's profiles; a replay of a guided flight has no guide."""
    from station.numerics.turbulence import NOMINAL_SPEED, Thresholds  # brings numba: not for the child
    from station.profile import to_json

    speed = profiles.card.flight.speed if profiles else NOMINAL_SPEED
    noise = profiles.rig.frame_noise_si().get("alpha_vane", 0.0) if profiles else 0.0
    aircraft = profiles.aircraft.derivatives if profiles else {}
    known = profiles.aircraft.measured if profiles else None
    measured = {"CD_0": known.CD_0} if known is not None and known.CD_0 is not None else {}
    return Setup(
        title,
        mode,
        port,
        web_port,
        lateral_methods=LIVE_LATERAL if profiles and profiles.card.asks_lateral else (),
        references={name: d.value for name, d in aircraft.items()} | measured,
        nominal_hz={s.name: s.rate_hz for s in profiles.rig.streams()} if profiles else {},
        accuracy=profiles.card.accuracy if profiles else 0.0,
        has_steps=bool(is_guided and profiles and profiles.card.steps),
        class_limits=Thresholds().at(speed, noise, 1.0 / TICK_HZ),
        open_page=open_page,
        signals=signals_of(profiles.rig) if profiles else (),
        simulated=given(profiles) if profiles else b"",
        measured=to_json(profiles.aircraft) if profiles and profiles.aircraft.measured else "",
    )
