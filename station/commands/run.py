"""station run: the live station. The only place that wires drivers, loop, log and screens together."""

from __future__ import annotations

import gc
import os
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from station.clock import SystemClock, asleep_ns
from station.commands.cards import about_air, load, recorded_flight
from station.commands.common import CardName, FlownAircraft, ViewMode, finite, page_words
from station.commands.process import line_writer, stop_on_signals
from station.console import judge, say
from station.conventions import LONGITUDINAL
from station.flight import loop as live
from station.flight.alignment import Aligner
from station.flight.board import Board
from station.flight.bus import Bus
from station.flight.emulators import Emulated, emulators, loop_words, streams_flown
from station.flight.guide import Guide, table_of
from station.flight.point_marks import Points
from station.flight.preparing import Preparation
from station.flight.reach import travel_remarks, without_effect
from station.flight.tick_times import TickTimes
from station.flight.verdict import Option
from station.log import About, WriterThread
from station.profile import CanDevice, Order, Profiles, Rig, Step
from station.rows import MISSED_SHARE, Code, Event, Rows, UsageError
from station.screen.brief import brief
from station.screen.glance_feed import GlanceFeed
from station.screen.rerun_feed import View

if TYPE_CHECKING:
    from drivers.surface_tap import SurfaceTap

FIRST_WITHIN_S = 1.0
"""A screen waits no longer for devices."""


def run(
    card: CardName = "bench",
    aircraft: FlownAircraft = None,
    duration: Annotated[
        float | None, typer.Option(help="seconds to run; until stopped if left out", min=0.02, callback=finite)
    ] = None,
    log: Annotated[Path, typer.Option(metavar="DIR", help="folder for the recording")] = Path("logs"),
    view: Annotated[ViewMode, typer.Option(help="Rerun viewer")] = ViewMode.web,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON line a second on stdout")] = False,
    auto: Annotated[bool, typer.Option("--auto", help="the card's steps one by one without keys, then end")] = False,
    forgetting: Annotated[
        float | None,
        typer.Option(
            metavar="S", help="in place of the card's: live estimates forget in so long", min=20, callback=finite
        ),
    ] = None,
    glance: Annotated[bool, typer.Option("--glance", help="a page for a second screen, on loopback")] = False,
    serve: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS[:PORT]", help="the glance page for other machines too, read-only, with a token"),
    ] = None,
    token: Annotated[
        str | None, typer.Option(envvar="STATION_TOKEN", help="of --serve; one is made and printed if left out")
    ] = None,
) -> int:
    """Fly: read the rig's devices, estimate at 50 Hz, record and show."""
    profiles = load(card, aircraft)
    if forgetting is not None:  # in the recorded card too: a replay forgets alike
        own = profiles.card.model_copy(update={"forgetting": forgetting})
        profiles = profiles.model_copy(update={"card": own})
    emulated = profiles.emulated_words if profiles.card.emulate else ""
    say(
        f"card {profiles.card.name}: {profiles.aircraft.name}{emulated} on rig {profiles.rig.name}{profiles.card.flown}"
    )
    # Unlike collecting it, freezing what the imports leave costs nothing; and a collection would stop the loop.
    gc.disable()
    with ExitStack() as stack:
        if auto and not profiles.card.steps:
            raise UsageError(
                f"--auto: card {profiles.card.name} has no steps\nadd [[steps]], as in profiles/cards/guided.toml"
            )
        page = GlanceFeed(serve, token) if glance or serve is not None else None
        if page is not None:
            stack.callback(page.close)
        flight = _Flight(stack, profiles, card, log, view, page, auto=auto)
        for words in (
            *about_air(profiles.rig, profiles.aircraft),
            *travel_remarks(profiles.card, profiles.aircraft),
            *without_effect(profiles, profiles.card.emulate),
        ):
            say(words)
        flight.fly(duration, as_json)
    return flight.verdict()


class _Flight:
    """A flight's parts: devices, loop, recording, estimators and screens; what opens them ends them with `stack`."""

    def __init__(
        self,
        stack: ExitStack,
        profiles: Profiles,
        card: str,
        log: Path,
        view: ViewMode,
        glance: GlanceFeed | None,
        *,
        auto: bool = False,
    ) -> None:
        """Raises StationError for what keeps the flight from beginning."""
        from drivers.adapter import check_devices, open_devices

        rig, rig_dir = profiles.rig, profiles.rig_dir
        self.clock, self.bus, self.stop = SystemClock(), Bus(), threading.Event()
        self.profiles = profiles
        check_devices(rig, profiles.rig_file)
        tap = surface_tap(stack, profiles)
        self.emulated = emulated = emulated_flight(stack, profiles, self.bus, self.clock, tap)
        streams = streams_flown(rig, emulated)
        self.aligner = Aligner(streams, rig.noise_si(), further=rig.further)
        self.preparation = Preparation(card, profiles, streams, self.clock, self.bus.put)
        put = tap.putting(self.bus.put) if tap is not None else self.bus.put
        self.adapters = open_devices(rig, emulated.endpoints, rig_dir, self.clock, put)
        # Ended last: compiling may take long to end, the recording is to be closed by then.
        stack.callback(self.preparation.stop, say)
        about = About(profiles.aircraft, streams, rig, profiles.card, files=dbc_files(rig, rig_dir))
        self.writer = WriterThread(log, about, self.clock, self.bus.put)
        stack.callback(self.writer.close)
        say(f"recording: {self.writer.path}")
        self.viewer = View(view.value, f"{profiles.card.name}: {profiles.aircraft.name}", profiles, self.bus.put)
        stack.callback(self.viewer.close)
        self.board = Board(profiles, self.clock)
        self.points = Points(self.bus.put, self.clock, [p.note for p in profiles.card.points])
        self.guide = guide_of(profiles, self.board, self.points, self.bus.put, emulated.ask, auto=auto)
        self.board.guide = self.guide if profiles.card.steps else None
        self._glance, self._auto = glance, auto
        self.viewer.brief = lambda: brief(self.board, self.clock.now_ns())
        self.failure: list[BaseException] = []
        self.times = TickTimes()
        self.slots = 0
        """How many ticks there should have been."""
        for adapter in self.adapters:
            adapter.start()
            stack.callback(adapter.stop)
        self.bus.put(Event(self.clock.now_ns(), "station", Code.START, 1, profiles.card.name))

    def fly(self, duration: float | None, as_json: bool) -> None:
        """Loop and screen until stopped or `duration` is over; the page and the estimators join when they are ready."""
        # The loop shares the interpreter with readers and the screen: give way quickly, and keep collections short.
        sys.setswitchinterval(0.0005)
        gc.freeze()
        stop_on_signals(self.stop)
        write = line_writer()
        thread = threading.Thread(target=self._loop, args=(duration,), name="loop")
        thread.start()
        try:
            self.board.wait_for_first(FIRST_WITHIN_S)
            self.board.address = self.viewer.start()
            if self.board.address:
                say(page_words(self.board.address))
            if self._glance is not None:
                self.board.glance_address = self._glance.address
                self._glance.start(self.board, self.clock, self.bus.put)
                say(page_words(self._glance.address, "glance"))
            self._show(as_json, write)
        finally:
            self.stop.set()
            thread.join()
        if self.failure:
            raise self.failure[0]

    def _show(self, as_json: bool, write: Callable[[str], None]) -> None:
        """The operator's screen, or lines, until the flight ends."""
        from station.screen.terminal import Callbacks, json_lines, plain_lines, run_panel

        self.preparation.start()
        if as_json:
            json_lines(self.board, self.stop, self.clock, write)
        elif sys.stdout.isatty() and sys.stdin.isatty() and os.environ.get("TERM") != "dumb":
            callbacks = Callbacks(self._mark, self.points.toggle, self.stop.set, self.guide.press)
            run_panel(self.board, callbacks, self.stop, self.clock)
        else:
            plain_lines(self.board, self.stop, self.clock, write)

    def _loop(self, duration: float | None) -> None:
        try:
            lag, preparation = self.profiles.card.lag, self.preparation
            source = live.beats(self.bus, self.clock, lag, self.stop, duration, preparation.is_under_way, asleep_ns)
            live.run(source, self.aligner, preparation.chain, self.writer, self._take, self._note_time)
        except BaseException as error:
            self.failure.append(error)
        finally:
            self.stop.set()

    def _take(self, rows: Sequence[Rows]) -> None:
        self.viewer.show(rows)
        self.board.update(rows)
        self.guide.update(rows)
        if self._auto and self.guide.is_over:
            self.stop.set()
        self.board.recording(self.writer.path, self.writer.bytes_written, self.viewer.dropped, self.viewer.behind_s)

    def _note_time(self, beat: live.Beat, _: Sequence[Rows]) -> None:
        self.times.note(self.clock.now_ns() - beat.tick.t_ns)
        self.slots = beat.tick.k + 1

    def _mark(self, note: str) -> None:
        self.bus.put(Event(self.clock.now_ns(), "operator", Code.MARK, 1, note))

    def verdict(self) -> int:
        """Say how the flight went; the exit code."""
        if timing := self.times.words():
            say(f"{timing}; {self.slots - self.times.ticks} missed")
        for words in loop_words(self.emulated.loop):
            say(words)
        say(f"recorded {self.writer.bytes_written / 2**20:.1f} MiB in {self.writer.recording}")
        if count := len(self.board.points.ended):
            say(f"{count} test point{'s' if count > 1 else ''}: station points {self.writer.recording} --report report")
        if self.preparation.is_under_way():
            say("no live estimates: the estimators were not ready (what is compiled is kept for the next flight);")
            say(f"after the flight: station identify {self.writer.recording}")
        return judge(self._shortcomings())

    def _shortcomings(self) -> list[str]:
        missed, lost = self.slots - self.times.ticks, self.writer.rows_lost + self.bus.dropped
        lost += sum(adapter.blocks_lost for adapter in self.adapters)
        found = []
        if self.writer.failed:
            found.append(f"the recording is not whole: {self.writer.failed}")
        if lost:
            found.append(f"{lost} rows lost")
        if missed > MISSED_SHARE * self.slots:
            found.append(f"{missed} of {self.slots} ticks missed")
        if not self.board.ever_complete:
            found.append(f"never all streams at once: {self.board.absent or 'none was waited for'}")
        return found


def guide_of(
    profiles: Profiles,
    board: Board,
    points: Points,
    put: Callable[[Event], None],
    ask: Callable[[Sequence[Order]], None],
    *,
    auto: bool,
) -> Guide:
    """Who leads through the card's steps, with a better input at hand where one can be predicted."""
    options = [better_inputs(profiles, step) for step in profiles.card.steps]
    return Guide(profiles.card, profiles.aircraft, board, points, put, ask, options, auto=auto)


def better_inputs(profiles: Profiles, step: Step) -> dict[str, Option]:
    """For each derivative that the step is judged by, an input that tells more of it, where one can be predicted."""
    # Here: their imports take longer than a station without steps needs for its first bytes.
    from station.identification.input_ranking import better_input
    from station.numerics.atmosphere import atmosphere
    from station.numerics.regression import NotIdentifiable

    flight, aircraft = profiles.card.flight, profiles.aircraft
    height = flight.altitude if step.condition.altitude is None else step.condition.altitude
    density = aircraft.air_density or atmosphere(height)[2]
    own = table_of(step).surfaces.get("elevator", np.empty(0))
    found = {}
    for name in (n for n in step.accept if n in LONGITUDINAL):
        with suppress(NotIdentifiable):
            speed = step.condition.speed or flight.speed
            found[name] = Option(*better_input(aircraft, speed, density, name, own))
    return found


def surface_tap(stack: ExitStack, profiles: Profiles) -> SurfaceTap | None:
    """What brings the surfaces that the rig measures into the loop; none where nothing is in it."""
    if not profiles.card.emulate or not profiles.rig.measured_surfaces:
        return None
    from drivers.surface_tap import SurfaceTap

    tap = SurfaceTap(profiles.rig)
    stack.callback(tap.close)
    return tap


def emulated_flight(
    stack: ExitStack, profiles: Profiles, bus: Bus, clock: SystemClock, tap: SurfaceTap | None = None
) -> Emulated:
    """The card's emulated devices, flying until `stack` ends; none where it emulates none."""
    if not profiles.card.emulate:
        return Emulated()
    from drivers.emulation import serve

    flown = recorded_flight(profiles)
    return stack.enter_context(
        emulators(
            lambda announce, stop, orders: serve(
                profiles, announce, stop, SystemClock(), flown, orders=orders, tap=tap
            ),
            bus,
            clock,
        )
    )


def dbc_files(rig: Rig, folder: Path) -> dict[str, bytes]:
    """The rig's DBC files, to be kept in the recording."""
    return {d.dbc: (folder / d.dbc).read_bytes() for d in rig.devices if isinstance(d, CanDevice)}
