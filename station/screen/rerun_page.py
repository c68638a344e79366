"""The operator's page: rows -> Rerun, in a process of its own that may stall or die without costing the loop a tick.

`python -m station.screen.rerun_page` runs Rerun's server on loopback and sends it a batch a second of what `View`
(rerun_feed.py) hands it. Rerun takes a second and 100 MB to import, so only that process and `write_rrd` do.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
import subprocess
import sys
import webbrowser
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from station.clock import Clock, SystemClock
from station.flight.board import Recommendation
from station.rows import LogError, Rows
from station.screen import lateral_plots, plots, signal_plots
from station.screen.plots import Batch, Plot, Points, Setup
from station.screen.rerun_feed import LENGTH, START_NS, View, page_address, setup_for

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from station.profile import Profiles

__all__ = ["Page", "View", "write_report_rrd", "write_rrd"]

FloatArray = NDArray[np.float64]

TIMELINE: Final = "station_time"
PROMPT_WINDOW_S: Final = 60
"""Plots of a shorter past are drawn with every batch."""
HOLD_NS: Final = 3_500_000_000
"""Plots of a long past wait this long for more points. A piece costs a browser the same whatever its length: one that
draws without a graphics processor on a busy machine takes some 10 a second, and falls ever further behind with more."""
SERVER_MEMORY: Final = "256MB"


class Page:
    """Rows as Rerun sees them: one entity a plot, on the timeline "station_time".

    The lines of a plot are instances of one entity: a page of fifty entities fell half a minute behind in the browser.
    """

    def __init__(self, recording: rr.RecordingStream, setup: Setup) -> None:
        import rerun as rr

        self._recording = recording
        self._setup = setup
        self._states: dict[str, str] = {}
        self._recommendation = Recommendation(setup.derivatives)
        self._bold = self._recommendation.method
        self._derivatives = self._of_derivatives()
        self._links = plots.link_plots(setup)
        self._held: dict[plots.Path, list[Points]] = {}
        drawn = (*plots.FIXED, *self._derivatives, *self._links, *signal_plots.further(setup))
        self._prompt = {plot.path for plot in drawn if plot.window_s is not None and plot.window_s < PROMPT_WINDOW_S}
        for plot in drawn:
            self._style(plot)
        for what, known in plots.STATES.items():
            if known:
                labels = rr.StateConfiguration(
                    values=list(known), colors=np.array(list(known.values()), dtype=np.uint32)
                )
                recording.log(f"state/{what}", labels, static=True)

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
        self._recording.log(_path(plot.path), style, static=True)

    def _recommend(self, rows: Batch) -> None:
        """Draw the method to believe first bold, once a second that of the data."""
        for row in (*rows.alphas[-1:], *rows.methods, *rows.healths[-1:]):
            self._recommendation.update(row)
        if self._recommendation.method != self._bold:
            self._bold = self._recommendation.method
            self._derivatives = self._of_derivatives()
            for plot in self._derivatives:
                self._style(plot)

    def show(self, rows: Batch) -> None:
        """Send the new points of every line, the events and the changes of state."""
        import rerun as rr

        self._recommend(rows)
        for points in signal_plots.every_point(rows, self._setup):
            held = self._held.setdefault(points.path, [])
            held.append(points)
            if points.path in self._prompt or points.t_ns[-1] - held[0].t_ns[0] >= HOLD_NS:
                self._send(points.path)
        for event in rows.events:
            if plots.is_routine(event):
                continue
            t_ms = (event.t_ns - rows.start_ns) // 1_000_000  # more digits do not fit in the log's column
            self._recording.set_time(TIMELINE, duration=np.timedelta64(t_ms, "ms"))
            level = plots.LEVEL_NAMES[event.level]
            colour = plots.LEVEL_COLOURS[event.level]
            self._recording.log(plots.EVENTS, rr.TextLog(plots.event_text(event), level=level, color=colour))
        for what, t_ns, state in plots.states(rows, self._setup, self._bold):
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

        view, key = self._view, self._derivatives[0]
        every, signals = [True] * len(key.lines), signal_plots.drawn(self._setup)
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
                rrb.Grid(*(view(plot, legend=plot is key) for plot in self._derivatives), grid_columns=3),
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
                rrb.Grid(
                    *(view(plot, only=every, legend=True) for plot in self._derivatives),
                    grid_columns=2,
                    name="Derivatives",
                ),
                *self._lateral_tab(),
                *([rrb.Grid(*map(view, signals), grid_columns=2, name="Signals")] if signals else []),
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

    def _lateral_tab(self) -> list[rrb.Vertical]:
        """What was flown above, the derivatives below; nothing where the card does not ask for them."""
        import rerun.blueprint as rrb

        if not self._setup.lateral_methods:
            return []
        motion = (lateral_plots.SURFACES, lateral_plots.RATES, lateral_plots.SIDESLIP)
        # No legend: it would show and hide lines of one name together, those of the other derivatives too.
        views = [
            self._view(plot, only=shown, legend=False, name=name)
            for name, plot, shown in lateral_plots.views(self._setup)
        ]
        *others, believed = self._setup.lateral_methods
        return [
            rrb.Vertical(
                rrb.Horizontal(*(self._view(plot) for plot in motion)),
                rrb.Grid(*views, grid_columns=5),
                row_shares=[1, 3],
                name=f"Lateral ({believed} bold, {', '.join(others)} thin, profile grey)",
            )
        ]

    def _view(
        self, plot: Plot, *, only: list[bool] | None = None, legend: bool | None = None, name: str | None = None
    ) -> rrb.TimeSeriesView:
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
            name=name or plot.name,
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

    Derivatives are thinned to five points a second; the recording proper is the MCAP log. Nothing is overwritten.
    """
    import rerun as rr

    try:
        Path(path).touch(exist_ok=False)
    except FileExistsError:
        raise LogError(f"{path}: exists already and is not overwritten") from None
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error.strerror}") from error
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


_OF_REPORT: Final = {"before": (0, 114, 178), "after": (213, 94, 0), "measured": (128, 134, 148)}
"""Colours of lines, as on the report's page."""


def write_report_rrd(
    page: str, series: Mapping[str, Mapping[str, tuple[FloatArray, FloatArray]]], path: Path | str, title: str
) -> None:
    """Write a report's words (Markdown) and its series over time as a Rerun recording. Raises LogError.

    `series`: by plot, by line: times (s) and values (n,).
    """
    import rerun as rr
    import rerun.blueprint as rrb

    plots_shown = [rrb.TimeSeriesView(origin=_path(("plots", plot)), name=plot) for plot in series]
    recording = rr.RecordingStream("station report")
    layout = rrb.Blueprint(
        rrb.Horizontal(
            rrb.TextDocumentView(origin="words", name=title), rrb.Grid(*plots_shown, grid_columns=1),
            column_shares=[2, 3],
        ),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        collapse_panels=True,
    )  # fmt: skip
    try:
        recording.save(path, default_blueprint=layout)
    except (OSError, RuntimeError) as error:
        raise LogError(f"{path}: cannot be written: {error}") from error
    recording.send_recording_name(title)
    recording.log("words", rr.TextDocument(page, media_type=rr.MediaType.MARKDOWN), static=True)
    for plot, lines in series.items():
        for name, (t_s, values) in lines.items():
            where = _path(("plots", plot, name))
            colour = _OF_REPORT.get(name)
            recording.log(where, rr.SeriesLines(names=name, colors=None if colour is None else [colour]), static=True)
            times = rr.TimeColumn(TIMELINE, duration=(np.asarray(t_s) * 1e9).astype("timedelta64[ns]"))
            recording.send_columns(where, indexes=[times], columns=rr.Scalars.columns(scalars=values))
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
