"""station run: the live station. The only place that wires drivers, loop, log and screens together."""

from __future__ import annotations

import gc
import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from station.clock import Clock, SystemClock
from station.commands.cards import about_air, load
from station.commands.common import CardName, ViewMode, finite
from station.commands.process import line_writer, stop_on_signals
from station.console import DEGRADED, DONE, say
from station.flight.bus import Bus
from station.flight.emulators import Emulated, emulators, streams_flown
from station.profile import CanDevice, Rig
from station.rows import Code, Event, Rows

TIMED_TICKS = 90_000
"""Half an hour of ticks, whose timing is told at the end."""


def run(
    card: CardName = "bench",
    duration: Annotated[
        float | None, typer.Option(help="seconds to run; until stopped if left out", min=0.02, callback=finite)
    ] = None,
    log: Annotated[Path, typer.Option(metavar="DIR", help="folder for the recording")] = Path("logs"),
    view: Annotated[ViewMode, typer.Option(help="Rerun viewer")] = ViewMode.web,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON line a second on stdout")] = False,
) -> int:
    """Fly: read the rig's devices, estimate at 50 Hz, record and show."""
    from drivers.adapter import check_devices, open_devices
    from station.estimation.instrument_errors import corrector
    from station.flight import loop as live
    from station.flight.alignment import Aligner
    from station.flight.chain import compile_apart, estimators, told_of_instruments
    from station.log import About, LogWriter
    from station.screen.rerun_page import View
    from station.screen.terminal import Board, Callbacks, json_lines, plain_lines, run_panel

    profiles = load(card)
    check_devices(profiles.rig, profiles.rig_file)
    aircraft, rig, flight_card = profiles.aircraft, profiles.rig, profiles.card
    devices = {d.name for d in rig.devices}
    clock, bus, stop = SystemClock(), Bus(), threading.Event()
    screen = sys.stdout.isatty() and sys.stdin.isatty() and os.environ.get("TERM") != "dumb" and not as_json

    say(f"card {flight_card.name}: {aircraft.name} on rig {rig.name}; preparing the estimators")
    compile_apart(card)
    estimator, watch = estimators(profiles)
    correct = corrector(aircraft, rig.frame_noise_si(), rig.imu_position)
    for words in (*about_air(rig, aircraft), *told_of_instruments(aircraft, correct)):
        say(words)

    with ExitStack() as stack:
        emulated = stack.enter_context(emulators(card, devices, bus, clock)) if flight_card.emulate else Emulated()
        streams = streams_flown(rig, emulated)
        aligner = Aligner(streams, rig.noise_si())
        adapters = open_devices(rig, emulated.endpoints, profiles.rig_dir, clock, bus.put)
        about = About(aircraft, streams, rig, flight_card, files=dbc_files(rig, profiles.rig_dir))
        writer = LogWriter(log, about, clock, bus.put)
        stack.callback(writer.close)
        viewer = View(view.value, f"{flight_card.name}: {aircraft.name}", profiles, on_event=bus.put)
        stack.callback(viewer.close)
        address = viewer.start()
        if address:
            say(f"viewer: {address}")
        say(f"recording: {writer.path}")
        board = Board(profiles, clock, address=address)
        for adapter in adapters:
            adapter.start()
            stack.callback(adapter.stop)
        bus.put(Event(clock.now_ns(), "station", Code.START, 1, flight_card.name))

        def show(rows: Sequence[Rows]) -> None:
            viewer.show(rows)
            board.update(rows)
            board.recording(writer.path, writer.bytes_written, viewer.dropped)

        failure: list[BaseException] = []
        done_after_ns: deque[int] = deque(maxlen=TIMED_TICKS)

        def note_time(beat: live.Beat, _: Sequence[Rows]) -> None:
            done_after_ns.append(clock.now_ns() - beat.tick.t_ns)

        def loop() -> None:
            try:
                source = live.beats(bus, clock, flight_card.lag, stop, duration)
                live.run(source, aligner, estimator, writer, show, note_time, watch, correct)
            except BaseException as error:
                failure.append(error)
            finally:
                stop.set()

        callbacks = Callbacks(
            on_mark=lambda note: bus.put(Event(clock.now_ns(), "operator", Code.MARK, 1, note)),
            on_point=_points(bus, clock),
            on_quit=stop.set,
        )
        # The loop shares the interpreter with readers and the screen: give way quickly, and keep collections short.
        sys.setswitchinterval(0.0005)
        gc.collect()
        gc.freeze()
        stop_on_signals(stop)
        write = line_writer()
        thread = threading.Thread(target=loop, name="loop")
        thread.start()
        try:
            if screen:
                run_panel(board, callbacks, stop, clock)
            elif as_json:
                json_lines(board, stop, clock, write)
            else:
                plain_lines(board, stop, clock, write)
        finally:
            stop.set()
            thread.join()
        if failure:
            raise failure[0]
    if done_after_ns:
        middle, late, worst = np.percentile(np.array(done_after_ns) * 1e-6, [50, 99, 100])
        overruns = board.health.overruns if board.health else 0
        say(
            f"ticks done after {middle:.2f} ms (median), {late:.2f} ms (p99), {worst:.1f} ms (worst); {overruns} missed"
        )
    say(f"recorded {writer.bytes_written / 2**20:.1f} MiB in {writer.path}")
    if writer.failed:
        say(f"station: the recording is not whole: {writer.failed}")
        return DEGRADED
    return DONE if board.ever_complete else DEGRADED


def dbc_files(rig: Rig, folder: Path) -> dict[str, bytes]:
    """The rig's DBC files, to be kept in the recording."""
    return {d.dbc: (folder / d.dbc).read_bytes() for d in rig.devices if isinstance(d, CanDevice)}


def _points(bus: Bus, clock: Clock) -> Callable[[], int | None]:
    """Starts and ends numbered test points in turn; returns the number of the open one, None when it was closed."""
    state = {"number": 0, "open": False}

    def toggle() -> int | None:
        state["open"] = not state["open"]
        if state["open"]:
            state["number"] += 1
        code = Code.POINT_START if state["open"] else Code.POINT_END
        bus.put(Event(clock.now_ns(), "operator", code, state["number"], f"test point {state['number']}"))
        return state["number"] if state["open"] else None

    return toggle
