"""The operator's page: rows -> Rerun, in a process of its own that may stall or die without costing the loop a tick.

`View` is the station's end: a bounded queue that drops its oldest and a thread that feeds the child through a pipe.
`python -m station.view` is the child: it runs Rerun's server on loopback and sends it a batch a second.
The pipe carries length-prefixed msgpack: one Setup, then Batches; the child answers a byte for each it has shown.
Rerun takes a second and 100 MB to import, so only the child and `write_rrd` do.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import selectors
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import webbrowser
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final
from urllib.parse import quote

import msgspec
import numpy as np

from station import plots
from station.clock import Clock, SystemClock
from station.plots import Batch, Plot, Points, Setup
from station.rows import Code, Event, LogError, Row, Rows

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from station.profile import Profiles

TIMELINE: Final = "station_time"
QUEUE_TICKS: Final = 1000
"""20 s of ticks: the child needs about 4 s to start."""
BATCH_TICKS: Final = 50
BATCH_NS: Final = 1_000_000_000
HOLD_NS: Final = 3_500_000_000
"""Plots of a long past wait this long for more points. A piece costs a browser the same whatever its length: one that
draws without a graphics processor on a busy machine takes some 10 a second, and falls ever further behind with more."""
MAX_BATCH_TICKS: Final = 100
UNANSWERED: Final = 2
"""Batches in flight before the queue waits: what is shown is never older than that."""
STALLED_NS: Final = 2_000_000_000
GIVE_UP_NS: Final = 30_000_000_000
START_NS: Final = 60_000_000_000
SERVER_MEMORY: Final = "256MB"
_LENGTH: Final = struct.Struct("<I")


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
        self._title = title
        self._profiles = profiles
        self._on_event = on_event
        self._clock = clock or SystemClock()
        self._queue: deque[list[Row]] = deque()
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
        self._queue.append(kept)
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
        self.address = _address(self.mode, *self._ports)

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
                [sys.executable, "-m", "station.view"],
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
                    moved_ns = self._clock.now_ns()
                    if self._stalled:
                        self._stalled = False
                        self._report("page goes on")
                    self._ready = True
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
        for _ in range(min(len(self._queue), MAX_BATCH_TICKS)):
            with contextlib.suppress(IndexError):  # show() drops from the same end
                taken.extend(self._queue.popleft())
        return plots.batch(taken, self._start_ns or 0)


def _address(mode: str, port: int, web_port: int) -> str:
    """What to open: the page, or what a native viewer connects to."""
    data = f"rerun+http://127.0.0.1:{port}/proxy"
    return f"http://127.0.0.1:{web_port}/?theme=dark&url={quote(data, safe=':/')}" if mode == "web" else data


def _framed(message: bytes) -> memoryview:
    return memoryview(_LENGTH.pack(len(message)) + message)


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
) -> Setup:
    """What the page shows beside the rows, from the flight's profiles."""
    from station.estimation.turbulence import Thresholds  # brings numba: not for the child

    classes = Thresholds()
    aircraft = profiles.aircraft.derivatives if profiles else {}
    return Setup(
        title,
        mode,
        port,
        web_port,
        references={name: d.value for name, d in aircraft.items()},
        nominal_hz={s.name: s.rate_hz for s in profiles.rig.streams()} if profiles else {},
        class_limits=(classes.calm, classes.light, classes.moderate),
        open_page=open_page,
    )


class Page:
    """Rows as Rerun sees them: one entity a plot, on the timeline "station_time".

    The lines of a plot are instances of one entity: a page of fifty entities fell half a minute behind in the browser.
    """

    def __init__(self, recording: rr.RecordingStream, setup: Setup) -> None:
        import rerun as rr

        self._recording = recording
        self._setup = setup
        self._states: dict[str, str] = {}
        self._derivatives = tuple(plots.derivative_plot(name, setup) for name in setup.derivatives)
        self._links = plots.link_plots(setup)
        self._held: dict[plots.Path, list[Points]] = {}
        drawn = (*plots.FIXED, *self._derivatives, *self._links)
        self._prompt = {plot.path for plot in drawn if plot.window_s is not None and plot.window_s < 60}
        for plot in drawn:
            style = rr.SeriesLines(
                colors=np.array([line.colour for line in plot.lines], dtype=np.uint32),
                widths=[line.width for line in plot.lines],
                names=[line.name for line in plot.lines],
            )
            recording.log(_path(plot.path), style, static=True)
        for what, known in plots.STATES.items():
            if known:
                labels = rr.StateConfiguration(
                    values=list(known), colors=np.array(list(known.values()), dtype=np.uint32)
                )
                recording.log(f"state/{what}", labels, static=True)

    def show(self, rows: Batch) -> None:
        """Send the new points of every line, the events and the changes of state."""
        import rerun as rr

        for points in plots.points(rows, self._setup):
            held = self._held.setdefault(points.path, [])
            held.append(points)
            if points.path in self._prompt or points.t_ns[-1] - held[0].t_ns[0] >= HOLD_NS:
                self._send(points.path)
        for event in rows.events:
            t_ms = (event.t_ns - rows.start_ns) // 1_000_000  # more digits do not fit in the log's column
            self._recording.set_time(TIMELINE, duration=np.timedelta64(t_ms, "ms"))
            level = plots.LEVEL_NAMES[event.level]
            colour = plots.LEVEL_COLOURS[event.level]
            self._recording.log(plots.EVENTS, rr.TextLog(plots.event_text(event), level=level, color=colour))
        for what, t_ns, state in plots.states(rows, self._setup):
            if self._states.get(what) != state:
                self._states[what] = state
                self._recording.set_time(TIMELINE, duration=np.timedelta64(t_ns, "ns"))
                self._recording.log(f"state/{what}", rr.StateChange(state=state))

    def flush(self) -> None:
        """Send what was held back to go in fewer, longer pieces."""
        for path in self._held:
            self._send(path)

    def _send(self, path: plots.Path) -> None:
        import rerun as rr

        held = self._held[path]
        if not held:
            return
        t = np.concatenate([points.t_ns for points in held]).astype("timedelta64[ns]")
        values = np.concatenate([points.values for points in held])
        held.clear()
        self._recording.send_columns(
            _path(path),
            indexes=[rr.TimeColumn(TIMELINE, duration=t)],
            columns=rr.Scalars.columns(scalars=values if values.shape[1] > 1 else values[:, 0]),
        )

    def blueprint(self) -> rrb.Blueprint:
        """Flight on the left, answers on the right; every method's bounds, links and air on tabs of their own."""
        import rerun.blueprint as rrb

        view, shown = self._view, plots.without_rival_bounds(self._setup)
        key = self._derivatives[0]
        flight = rrb.Horizontal(
            rrb.Vertical(
                view(plots.ALPHA),
                view(plots.CORRECTIONS),
                view(plots.GUST),
                view(plots.CONTROLS),
                view(plots.AIRSPEED),
                row_shares=[3.2, 1.6, 1.4, 1.6, 1.2],
            ),
            rrb.Vertical(
                rrb.Grid(*(view(plot, only=shown, legend=plot is key) for plot in self._derivatives), grid_columns=3),
                rrb.Horizontal(view(plots.TURBULENCE), view(self._links[0])),
                rrb.Horizontal(
                    _event_log(),
                    rrb.StateTimelineView(origin="state", name="State"),
                    column_shares=[3, 2],
                ),
                row_shares=[5, 2, 2],
            ),
            column_shares=[2, 3],
            name="Flight",
        )
        return rrb.Blueprint(
            rrb.Tabs(
                flight,
                rrb.Grid(*(view(plot, legend=True) for plot in self._derivatives), grid_columns=2, name="Derivatives"),
                rrb.Grid(*(view(plot) for plot in self._links), grid_columns=2, name="Links"),
                rrb.Vertical(view(plots.GUST_SPEED), view(plots.WIND), view(plots.TURBULENCE), name="Air"),
                active_tab=0,
            ),
            rrb.BlueprintPanel(state="collapsed"),
            rrb.SelectionPanel(state="collapsed"),
            rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
            auto_views=False,
            auto_layout=False,
        )

    def _view(self, plot: Plot, *, only: list[bool] | None = None, legend: bool | None = None) -> rrb.TimeSeriesView:
        import rerun as rr
        import rerun.blueprint as rrb

        now = rrb.TimeRangeBoundary.cursor_relative(seconds=0)
        begin = rrb.TimeRangeBoundary.infinite()
        axis = None
        if plot.window_s is not None:
            begin = rrb.TimeRangeBoundary.cursor_relative(seconds=-plot.window_s)
            axis = rrb.TimeAxis(view_range=rr.TimeRange(start=begin, end=now))
        fixed = None if plot.low is None or plot.high is None else rr.encodings.Range1D([plot.low, plot.high])
        return rrb.TimeSeriesView(
            origin=_path(plot.path),
            overrides={_path(plot.path): rr.SeriesLines(visible_series=only)} if only else None,
            name=plot.name,
            axis_x=axis,
            axis_y=rrb.ScalarAxis(range=fixed) if fixed else None,
            plot_legend=rrb.PlotLegend("LeftTop", visible=plot.legend if legend is None else legend),
            time_ranges=[rrb.VisibleTimeRange(TIMELINE, start=begin, end=now)],
        )


def _event_log() -> rrb.TextLogView:
    import rerun.blueprint as rrb
    from rerun.blueprint.encodings import TextLogColumn

    kept = [TextLogColumn(kind, visible=True) for kind in ("loglevel", "body")]
    return rrb.TextLogView(origin=plots.EVENTS, name="Events", columns=rrb.TextLogColumns(text_log_columns=kept))


def _path(parts: plots.Path) -> str:
    import rerun as rr

    return rr.new_entity_path(list(parts))


def write_rrd(rows: Iterable[Rows], path: Path | str, profiles: Profiles | None = None, title: str = "station") -> None:
    """Write rows, in time order, as a Rerun recording with the page's layout. Raises LogError.

    Derivatives are thinned to five points a second; the recording proper is the MCAP log.
    """
    import rerun as rr

    setup = setup_for(profiles, title=title)
    recording = rr.RecordingStream("station")
    page = Page(recording, setup)
    try:
        recording.save(path, default_blueprint=page.blueprint())
    except (OSError, RuntimeError) as error:
        raise LogError(f"{path}: cannot be written: {error}") from error
    start_ns: int | None = None
    left = iter(rows)
    while taken := list(itertools.islice(left, 65536)):
        if start_ns is None:
            start_ns = plots.start_of(taken)
        page.show(plots.batch(taken, start_ns or 0))
    page.flush()
    recording.flush()
    recording.disconnect()


def _server(setup: Setup) -> subprocess.Popen[bytes]:
    """Rerun's own program, bound to loopback: the libraries' servers listen on every interface."""
    import rerun_cli  # type: ignore[import-untyped]

    program = Path(rerun_cli.__file__).with_name("rerun.exe" if sys.platform == "win32" else "rerun")
    where = ["--bind", "127.0.0.1", "--port", str(setup.port)]
    if setup.mode == "web":
        where += ["--serve-web", "--web-viewer-port", str(setup.web_port)]
    quiet = subprocess.DEVNULL
    return subprocess.Popen(
        [str(program), *where, "--server-memory-limit", SERVER_MEMORY, "--memory-limit", "1GB"],
        stdin=quiet,
        stdout=quiet,
        stderr=quiet,
    )


def _wait_for(port: int, server: subprocess.Popen[bytes], clock: Clock) -> None:
    """Connecting Rerun before its server listens would block five seconds and then lose everything."""
    until_ns = clock.now_ns() + START_NS // 2
    while clock.now_ns() < until_ns:
        if server.poll() is not None:
            raise SystemExit(f"Rerun's server ended with code {server.returncode}")
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
            return
        clock.sleep_until_ns(clock.now_ns() + 50_000_000)
    raise SystemExit(f"Rerun's server does not listen on port {port}")


def _child() -> None:
    """Show what comes through the pipe until it closes."""
    import rerun as rr

    clock = SystemClock()
    pipe, answer = sys.stdin.buffer, os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # nothing but answers on the answer pipe
    setup = msgspec.msgpack.decode(_read(pipe), type=Setup)
    decoder = msgspec.msgpack.Decoder(Batch)
    server = _server(setup)
    try:
        for port in (setup.port, setup.web_port)[: 2 if setup.mode == "web" else 1]:
            _wait_for(port, server, clock)
        recording = rr.RecordingStream("station", recording_id=None)
        recording.set_sinks(rr.GrpcSink(f"rerun+http://127.0.0.1:{setup.port}/proxy"))
        recording.send_recording_name(setup.title)
        page = Page(recording, setup)
        recording.send_blueprint(page.blueprint())
        recording.flush(timeout_sec=10.0)
        os.write(answer, b".")
        if setup.open_page:
            data = quote(f"rerun+http://127.0.0.1:{setup.port}/proxy", safe="")
            webbrowser.open(f"http://127.0.0.1:{setup.web_port}?theme=dark&hide_welcome_screen&url={data}")
        while message := _read(pipe):
            page.show(decoder.decode(message))
            recording.flush(timeout_sec=5.0)  # a server that does not keep up holds the answer back
            if server.poll() is not None:
                raise SystemExit("Rerun's server ended" if setup.mode == "web" else "the viewer was closed")
            os.write(answer, b".")
    except (BrokenPipeError, KeyboardInterrupt):
        pass
    finally:
        server.kill()
        server.wait()
    os._exit(0)  # Rerun would wait for a server that is gone


def _read(pipe: IO[bytes]) -> bytes:
    head = pipe.read(_LENGTH.size)
    return pipe.read(_LENGTH.unpack(head)[0]) if len(head) == _LENGTH.size else b""


if __name__ == "__main__":
    _child()
