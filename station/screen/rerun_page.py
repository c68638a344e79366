"""The operator's page: rows -> Rerun, in a process of its own that may stall or die without costing the loop a tick.

`python -m station.screen.rerun_page` runs Rerun's server on loopback and sends it a batch a second of what `View`
(rerun_feed.py) hands it. Rerun takes a second and 100 MB to import, so only that process and Rerun's own files do.
"""

from __future__ import annotations

import contextlib
import operator
import os
import socket
import subprocess
import sys
import webbrowser
from collections.abc import Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final

import msgspec
import numpy as np

from station.clock import Clock, SystemClock, utc_now_ns, utc_time
from station.flight.board import Board
from station.rows import Event, Level
from station.screen import drag_plot, plots, signal_plots
from station.screen import rerun_layout as layout
from station.screen.answer_tiles import PALETTE, tiles
from station.screen.answers import hms
from station.screen.attitude import airframe, attitude
from station.screen.brief import Brief, brief
from station.screen.drawings import HIGH, WIDE, Drawing, Label, key_drawing, step_drawing
from station.screen.event_groups import EventGate
from station.screen.ground_track import GroundTrack
from station.screen.live_spectra import LiveSpectra
from station.screen.page_words import first_words
from station.screen.plots import Batch, Plot, Points, Setup
from station.screen.point_table import point_markdown
from station.screen.rerun_feed import LENGTH, START_NS, page_address
from station.screen.rerun_layout import TIMELINE, Shown, entity
from station.screen.simulation_beside import SimulationBeside

if TYPE_CHECKING:
    import rerun as rr

SHORT_HOLD_NS: Final = 3_500_000_000
LONG_HOLD_NS: Final = 8_000_000_000
"""Plots of other tabs than the first wait this long for more points, those of the whole flight longer. A piece costs a
browser the same whatever its length: one that draws without a graphics processor on a busy machine takes some 10 a
second, and falls ever further behind with more."""
ATTITUDE_TICKS: Final = 10
"""Five attitudes a second."""
SERVER_MEMORY: Final = "256MB"
_t_ns: Final = operator.attrgetter("t_ns")


class Page:
    """Rows as Rerun sees them: one entity a plot, on the timeline "station_time".

    The lines of a plot are instances of one entity: a page of fifty entities fell half a minute behind in the browser.
    """

    def __init__(self, recording: rr.RecordingStream, setup: Setup, *, is_live: bool = True) -> None:
        """Of a file, the tiles, which do not go back in time, tell the end alone."""
        self._is_live = is_live
        self._last: Batch | None = None
        self._recording = recording
        self._setup = setup
        self._states: dict[str, str] = {}
        self._board = Board(None, SystemClock())
        self._board.accuracy, self._board.derivatives = setup.accuracy, setup.derivatives
        self._board.against = drag_plot.against(setup)
        self._drag, self._drag_sent = drag_plot.drawn(self._board.against), 0
        self._bold = self._board.recommended
        self._gate, self._track, self._spectra = EventGate(), GroundTrack(), LiveSpectra()
        self._simulation = SimulationBeside(setup.simulated, waits=not is_live)
        self._derivatives = self._of_derivatives()
        self._links = plots.link_plots(setup)
        self._held: dict[plots.Path, list[Points]] = {}
        self._told: dict[str, object] = {}
        self._seconds = 0.0
        drawn = (*plots.FIXED, *self._derivatives, *self._drag, *self._links, *signal_plots.further(setup))
        self._hold_ns = {plot.path: SHORT_HOLD_NS if plot.window_s is not None else LONG_HOLD_NS for plot in drawn}
        self._hold_ns[plots.ALPHA.path] = 0
        if not setup.has_steps:
            self._hold_ns[plots.CONTROLS.path] = 0
        for plot in drawn:
            self._style(plot)
        self._begin()

    @property
    def shown(self) -> Shown:
        """What its layout is made of."""
        return Shown(self._setup, self._derivatives, self._links, self._drag)

    def _begin(self) -> None:
        """What does not change."""
        import rerun as rr

        self._at(0)

        for what, known in plots.STATES.items():
            if known:
                labels = rr.StateConfiguration(
                    values=list(known), colors=np.array(list(known.values()), dtype=np.uint32)
                )
                self._recording.log(f"state/{what}", labels, static=True)
        palette = [rr.AnnotationInfo(id=i, color=colour) for i, colour in enumerate(PALETTE)]
        self._recording.log(layout.ANSWERS, rr.AnnotationContext(palette), static=True)
        self._log_key()
        self._words(layout.POINTS, point_markdown((), (), 0))
        for where, words in layout.AWAITED.items():
            self._draw(
                where, Drawing((), (Label(WIDE / 2, HIGH / 2, words),)), static=self._is_live and where == layout.MODEL
            )
        self._recording.log(layout.ATTITUDE, rr.ViewCoordinates.FRD, static=True)
        wings, colours = airframe()
        self._recording.log(
            f"{layout.ATTITUDE}/aircraft",
            rr.LineStrips3D(wings, colors=colours, radii=rr.Radius.ui_points(1.5)),
            static=True,
        )

    def _of_derivatives(self) -> tuple[Plot, ...]:
        return tuple(plots.derivative_plot(name, self._setup, self._bold) for name in self._setup.derivatives)

    def _style(self, plot: Plot) -> None:
        """Colours, widths and names of a plot's lines; of derivatives only the bold method's bounds are visible."""
        import rerun as rr

        is_derivative = plot in self._derivatives
        style = rr.SeriesLines(
            colors=np.array([line.colour for line in plot.lines], dtype=np.uint32),
            widths=[line.width for line in plot.lines],
            names=[line.name for line in plot.lines],
            visible_series=plots.without_other_bounds(self._setup, self._bold) if is_derivative else None,
        )
        self._recording.log(entity(plot.path), style, static=True)

    def _log_key(self) -> None:
        own = {line.name: line for line in self._derivatives[0].lines if "sd" not in line.name}
        lines = [
            (f"{name}, recommended, ±2 sd" if name == self._bold else name, x.colour, x.width)
            for name, x in own.items()
        ]
        self._draw(layout.KEY, key_drawing(lines), static=True)

    def _digest(self, rows: Batch) -> None:
        """Know what the operator should; draw the method to believe first bold, which follows the data."""
        board = self._board
        board.start_ns = rows.start_ns
        board.view_behind_s = rows.behind_s
        board.update(sorted((*rows.frames, *rows.alphas, *rows.methods, *rows.healths, *rows.events), key=_t_ns))
        if board.recommended != self._bold:
            self._bold = board.recommended
            self._derivatives = self._of_derivatives()
            for plot in self._derivatives:
                self._style(plot)
            self._log_key()

    def show(self, rows: Batch) -> None:
        """Send the new points of every line, the answers, the events and the changes of state."""
        self._digest(rows)
        self._last = rows
        for points in (*signal_plots.every_point(rows, self._setup), *self._drag_points(rows.start_ns)):
            held = self._held.setdefault(points.path, [])
            held.append(points)
            if points.t_ns[-1] - held[0].t_ns[0] >= self._hold_ns[points.path]:
                self._send(points.path)
        newest_ns = max((row.t_ns for kind in (rows.frames, rows.healths, rows.events) for row in kind[-1:]), default=0)
        for event in self._gate.passed((e for e in rows.events if not plots.is_routine(e)), newest_ns):
            self._tell(event, rows.start_ns)
        self._at(newest_ns - rows.start_ns)
        self._answer(rows, rows.brief or brief(self._board, newest_ns))
        self._draw_flight(rows, newest_ns)
        for what, t_ns, state in plots.states(rows, self._setup, self._bold):
            if self._states.get(what) != state:
                self._states[what] = state
                self._at(t_ns)
                self._log_state(what, state)

    def _drag_points(self, start_ns: int) -> Iterator[Points]:
        """Means of drag that have not been drawn."""
        known = self._board.against
        if known is not None and known.CD_0 is not None:
            new, self._drag_sent = known.history[self._drag_sent :], len(known.history)
            yield from drag_plot.points(known.CD_0, new, start_ns)

    def _answer(self, rows: Batch, said: Brief) -> None:
        """The first screen: answers, words, the step's input; each only where it has changed."""
        import rerun as rr

        board, step = self._board, said.step
        three = (said.alpha, said.alpha_text, said.point, said.wrong)
        sent = "" if rows.brief is None else f"   sent at {utc_time(utc_now_ns())} UTC, {rows.behind_s:.1f} s late"
        foot = f"flight time {hms(self._seconds)}{sent}"
        if self._is_live and self._changed(layout.ANSWERS, (three, round(self._seconds))):
            # Static: the newest alone is kept, or a browser would hold hundreds of megabytes of them in an hour.
            self._recording.log(layout.ANSWERS, rr.SegmentationImage(tiles(said, foot)), static=True)
        self._words(layout.WORDS, first_words(said, self._setup.references))
        self._words(layout.POINTS, point_markdown(board.points.ended, board.derivatives, rows.start_ns))
        if step is not None and self._changed(
            layout.STEP, (step.pictures, step.phase, step.since_s > 0 and step.since_s)
        ):
            self._draw(layout.STEP, step_drawing(step))

    def _draw_flight(self, rows: Batch, newest_ns: int) -> None:
        """Track, attitude, spectra and simulation."""
        import rerun as rr

        self._simulation.take(rows.frames, rows.start_ns)
        beside = self._simulation.drawing()
        if beside is not None:
            # As with the tiles, a browser keeps the newest alone.
            self._draw(layout.MODEL, beside[0], static=self._is_live)
            if self._changed("state/model", beside[1]):
                self._log_state("model", beside[1])
        self._spectra.take(rows.alphas)
        spectra = self._spectra.drawing(newest_ns)
        if spectra is not None:
            self._draw(layout.SPECTRA, spectra)
        self._track.take(rows.frames, rows.alphas, rows.events)
        track = self._track.drawing(newest_ns)
        if track is not None:
            self._draw(layout.TRACK, track)
        turned = [frame for frame in rows.frames if frame.k % ATTITUDE_TICKS == 0]
        attitudes = [attitude(frame) for frame in turned]
        known = [(frame.t_ns - rows.start_ns, q) for frame, q in zip(turned, attitudes, strict=True) if q is not None]
        if known:
            times = np.array([t for t, _ in known], dtype="timedelta64[ns]")
            self._recording.send_columns(
                f"{layout.ATTITUDE}/aircraft",
                indexes=[rr.TimeColumn(TIMELINE, duration=times)],
                columns=rr.Transform3D.columns(quaternion=[q for _, q in known]),
            )

    def _changed(self, what: str, value: object) -> bool:
        """Whether it is not what was sent last."""
        if self._told.get(what) == value:
            return False
        self._told[what] = value
        return True

    def _words(self, where: str, text: str) -> None:
        import rerun as rr

        if self._changed(where, text):
            self._recording.log(where, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))

    def _draw(self, where: str, drawing: Drawing, *, static: bool = False) -> None:
        import rerun as rr

        strips, labels = drawing.strips, drawing.labels
        lines = rr.LineStrips2D(
            [strip.points for strip in strips],
            colors=np.array([strip.colour for strip in strips], dtype=np.uint32),
            radii=rr.Radius.ui_points([strip.width / 2 for strip in strips]),
        )
        self._recording.log(f"{where}/lines", lines, static=static)  # no lines take away those that were there
        if labels:
            words = rr.Points2D(
                [(label.x, label.y) for label in labels],
                labels=[label.words for label in labels],
                colors=np.array([label.colour for label in labels], dtype=np.uint32),
                radii=rr.Radius.ui_points(0.1),
                show_labels=True,
            )
            self._recording.log(f"{where}/labels", words, static=static)

    def _tell(self, event: Event, start_ns: int) -> None:
        import rerun as rr

        self._recording.set_time(TIMELINE, duration=np.timedelta64((event.t_ns - start_ns) // 1_000_000, "ms"))
        where = layout.INFORMATIONS if event.level is Level.INFO else layout.ALARMS
        level, colour = plots.LEVEL_NAMES[event.level], plots.LEVEL_COLOURS[event.level]
        self._recording.log(where, rr.TextLog(plots.event_text(event), level=level, color=colour))

    def _at(self, t_ns: int) -> None:
        """What is logged next is seen from then on, ns since the start."""
        self._seconds = t_ns * 1e-9
        self._recording.set_time(TIMELINE, duration=np.timedelta64(t_ns, "ns"))

    def _log_state(self, what: str, state: str) -> None:
        import rerun as rr

        self._recording.log(f"state/{what}", rr.StateChange(state=state))

    def flush(self) -> None:
        """Send what was held back to go in fewer, longer pieces."""
        if not self._is_live and self._last is not None:
            self._is_live = True
            self._answer(self._last, brief(self._board, self._last.start_ns + round(1e9 * self._seconds)))
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
            entity(path),
            indexes=[rr.TimeColumn(TIMELINE, duration=t)],
            columns=rr.Scalars.columns(scalars=values if values.shape[1] > 1 else values[:, 0]),
        )


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
        recording.send_blueprint(layout.layout(page.shown))
        recording.flush(timeout_sec=10.0)
        os.write(answer, b".")
        if setup.open_page:
            webbrowser.open(page_address("web", setup.port, setup.web_port))
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
    head = pipe.read(LENGTH.size)
    return pipe.read(LENGTH.unpack(head)[0]) if len(head) == LENGTH.size else b""


if __name__ == "__main__":
    _child()
