"""The command line, and the only place that wires drivers, loop, log and screens together."""

from __future__ import annotations

import gc
import importlib.metadata
import json
import math
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from typer.exceptions import TyperException

from station import diagnosing, postflight
from station.bus import Bus
from station.campaign import verb as campaigns
from station.clock import Clock, SystemClock
from station.emulators import Emulated, emulators, streams_flown
from station.postflight import DEGRADED, DONE, ERROR, USAGE, ViewMode, finite, say
from station.process import discard_output, guarded, line_writer, spread, stop_on_signals, write_line
from station.profile import CanDevice, Profiles, Rig, load_aircraft, load_card
from station.remarks import about_air
from station.rows import Code, Event, ProfileError, Rows, StationError, UsageError

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
app.add_typer(postflight.app)
app.add_typer(diagnosing.app)
app.add_typer(campaigns.app)

TIMED_TICKS = 90_000
"""Half an hour of ticks, whose timing is told at the end."""


CardName = Annotated[str, typer.Argument(metavar="CARD", help="a name under profiles/cards, or a path")]


def _version(wanted: bool) -> None:
    if wanted:
        print(importlib.metadata.version("flight-test-station"))
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="print the version and leave")
    ] = False,
) -> None:
    """Flight test station: corrected angle of attack and live derivatives at 50 Hz. --debug shows tracebacks."""


# --- live


@app.command()
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
    from station import live
    from station.alignment import Aligner
    from station.estimation.instruments import corrector
    from station.log import About, LogWriter
    from station.panel import Board, Callbacks, json_lines, plain_lines, run_panel
    from station.preparing import compile_apart, estimators, told_of_instruments
    from station.view import View

    profiles = _load(card)
    check_devices(profiles.rig, Path(profiles.rig_dir))
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
        adapters = open_devices(rig, emulated.endpoints, Path(profiles.rig_dir), clock, bus.put)
        about = About(aircraft, streams, rig, flight_card, files=dbc_files(rig, Path(profiles.rig_dir)))
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


def _stop_at_end_of_input(stop: threading.Event) -> None:
    sys.stdin.read()
    stop.set()


@app.command()
def emulate(
    card: CardName = "bench",
    attached: Annotated[bool, typer.Option("--attached", hidden=True, help="end when standard input closes")] = False,
) -> int:
    """Serve the card's emulated devices alone; one JSON line per endpoint."""
    from drivers.emulate import serve

    profiles = _load(card)
    stop = threading.Event()
    stop_on_signals(stop)
    if attached:
        threading.Thread(target=_stop_at_end_of_input, args=(stop,), daemon=True).start()
    serve(profiles, lambda told: write_line(json.dumps(told)), stop, SystemClock(), _recorded_flight(profiles))
    return DONE


def _recorded_flight(profiles: Profiles) -> dict[str, NDArray[np.float64]] | None:
    """The signals of the recording that the card wants flown, with their times; None where it flies the simulation."""
    from station.log import table

    flight = profiles.card.flight
    if flight.source != "recording":
        return None
    flown = table(_recording(profiles))
    flown_s = flown.t_s - flown.t_s[0]
    held_s = np.arange(0.0, flight.lead_in, 1.0 / flown.rate_hz)
    time = np.concatenate([held_s, flown_s + flight.lead_in])
    return {"time": time, **{n: np.concatenate([np.full(len(held_s), c[0]), c]) for n, c in flown.columns.items()}}


def _recording(profiles: Profiles) -> Path:
    card = profiles.card
    if card.flight.recording is None:
        raise ProfileError(f'card {card.name}: flight.recording: missing, with flight.source = "recording"')
    return Path(card.flight.recording)


def _load(card: str) -> Profiles:
    """A card's profiles. A recording that is flown brings its own aircraft, the place of its IMU and its own noise."""
    from station.log import metadata

    profiles = load_card(card)
    if profiles.card.flight.source != "recording":
        return profiles
    about = metadata(_recording(profiles)).about
    place = about.rig.imu_position if about.rig else (0.0, 0.0, 0.0)
    rig = profiles.rig.model_copy(update={"imu_position": place}).without_noise()
    return profiles.model_copy(update={"aircraft": about.aircraft, "rig": rig})


@app.command()
def check(
    card: CardName = "bench",
    seconds: Annotated[float, typer.Option(help="how long to listen", min=0.5, callback=finite)] = 5.0,
) -> int:
    """Validate the profiles, listen to each device, print a go / no-go table."""
    from drivers.adapter import check_devices, open_devices
    from station import live
    from station.alignment import Aligner
    from station.board import Board
    from station.checklist import print_check

    profiles = _load(card)
    devices = {d.name for d in profiles.rig.devices}
    rig_dir = Path(profiles.rig_dir)
    check_devices(profiles.rig, rig_dir)
    for words in about_air(profiles.rig, profiles.aircraft):
        say(words)
    clock, bus, stop = SystemClock(), Bus(), threading.Event()
    board = Board(profiles, clock)
    told: list[Event] = []
    with ExitStack() as stack:
        emulated = stack.enter_context(emulators(card, devices, bus, clock)) if profiles.card.emulate else Emulated()
        streams = streams_flown(profiles.rig, emulated)
        aligner = Aligner(streams, profiles.rig.noise_si())
        for adapter in open_devices(profiles.rig, emulated.endpoints, rig_dir, clock, bus.put):
            adapter.start()
            stack.callback(adapter.stop)
        stop_on_signals(stop)
        # The last beat carries a health row: they come once a second.
        for tick, rows, _ in live.beats(bus, clock, profiles.card.lag, stop, math.ceil(seconds) + 0.02):
            for row in rows:
                aligner.accept(row)
            _, events, health = aligner.frame(tick.k, tick.t_ns, tick.frame_t_ns)
            told += [e for e in (*rows, *events) if isinstance(e, Event)]
            board.update([*rows, *events, *([health] if health else [])])
    return DONE if print_check(profiles.card.name, board, streams, told) else DEGRADED


# --- records from elsewhere


@app.command("import")
def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="fdata .mat, .csv, HFB-320 .asc, DataFlash .bin, .ulg")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="LOG", help="the recording to make")],
    aircraft: Annotated[str, typer.Option(metavar="NAME", help="aircraft profile")],
) -> int:
    """Make a station recording of a record from elsewhere."""
    from drivers.dataflash import read_dataflash
    from station.convert import import_file, reader_of

    count = import_file(file, out, load_aircraft(aircraft), {".bin": reader_of("dataflash", read_dataflash)})
    say(f"{out}: {count} rows")
    return DONE


# --- start


def main() -> None:
    """Run the command line; exit codes: 0 done, 1 error, 2 usage or invalid profile, 3 done but degraded.

    Ended by a signal: 128 and its number, as of any program.
    """
    debug = "--debug" in sys.argv
    words = spread([a for a in sys.argv[1:] if a != "--debug"]) or ["--help"]
    try:
        with guarded():
            code = app(words, prog_name="station", standalone_mode=False)
    except typer.Exit as leaving:
        code = leaving.exit_code
    except (typer.Abort, KeyboardInterrupt):
        code = 128 + signal.SIGINT
    except TyperException as error:
        told = getattr(error, "format_message", error.__str__)()
        say(f"station: {told}\nsee: station --help")
        code = USAGE
    except StationError as error:
        if debug:
            raise
        say(f"station: {error}")
        code = USAGE if isinstance(error, (ProfileError, UsageError)) else ERROR
    except BrokenPipeError:
        discard_output()
        code = ERROR
    except OSError as error:
        if debug:
            raise
        say(f"station: {error.filename or 'the system'}: {error.strerror or error}")
        code = ERROR
    except Exception as error:
        if debug:
            raise
        say(f"station: internal error: {type(error).__name__}: {error}\nrun again with --debug to see where")
        code = ERROR
    sys.exit(code or DONE)


if __name__ == "__main__":
    main()
