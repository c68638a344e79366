"""Verbs on recordings: replay, info, recover, identify, simulate. No hardware in reach."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, cast

import msgspec
import numpy as np
import typer

from station.clock import SystemClock
from station.conventions import STREAMS, TICK_NS, Stream
from station.log import About, describe, metadata, read_rows, recover, summarise, write_log
from station.profile import load_card
from station.rows import LogError, Rows, Sample, Truth, UsageError

app = typer.Typer()

DONE, ERROR, USAGE, DEGRADED = 0, 1, 2, 3


class ViewMode(StrEnum):
    web = "web"
    native = "native"
    none = "none"


def say(text: str) -> None:
    """Words for the user, on stderr; stdout is for what was asked for."""
    print(text, file=sys.stderr, flush=True)


LogPath = Annotated[Path, typer.Argument(metavar="LOG", help="a recording (.mcap)")]


@app.command()
def replay(
    log: LogPath,
    speed: Annotated[str, typer.Option(metavar="X|max", help="times real time")] = "max",
    view: Annotated[ViewMode, typer.Option(help="Rerun viewer")] = ViewMode.none,
    verify: Annotated[bool, typer.Option("--verify", help="compare with the recorded estimates bit for bit")] = False,
) -> int:
    """Run the same estimators over a recording."""
    from station import live
    from station.alignment import Aligner
    from station.estimation.methods import Estimator
    from station.view import View

    about = metadata(log).about
    if about.imported or about.rig is None or about.card is None:
        raise UsageError(f"{log}: an imported record has no ticks to replay\nuse: station identify {log}")
    rate = None if speed == "max" else _positive(speed, "--speed")
    clock = SystemClock()
    noise = about.rig.noise_si()
    estimator = Estimator(about.aircraft, about.card, about.rig.imu_position, about.rig.frame_noise_si())
    estimator.warm_up()
    source: Iterator[live.Beat] = live.recorded_beats(read_rows(log))
    if rate is not None:
        source = live.paced(source, clock, rate)
    counts = {"beats": 0, "rows": 0, "different": 0}
    first: list[str] = []

    def compare(beat: live.Beat, made: Sequence[Rows]) -> None:
        counts["beats"] += 1
        if not beat.recorded:
            return  # the station died between the tick and its estimates
        counts["rows"] += len(beat.recorded)
        # A crash may have cut the last beat's rows short: what was recorded must match.
        for was, now in zip(beat.recorded, made, strict=False):
            if not same_bits(was, now):
                counts["different"] += 1
                if not first:
                    first.append(f"first difference at tick {beat.tick.k}: {type(was).__name__}\n{was}\n{now}")

    with ExitStack() as stack:
        show = None
        if view is not ViewMode.none:
            viewer = View(view.value, f"replay of {log.name}", None, on_event=lambda _: None)
            stack.callback(viewer.close)
            say(f"viewer: {viewer.start()}")
            show = viewer.show
        live.run(source, Aligner(about.streams, noise), estimator, None, show, compare)
    if counts["beats"] == 0:
        raise UsageError(f"{log}: no ticks in it: nothing to replay")
    print(f"{counts['beats']} ticks, {counts['rows']} rows compared, {counts['different']} different")
    if verify and counts["different"]:
        say("\n".join(line[:300] for line in first[0].splitlines()))
        return ERROR
    return DONE


def same_bits(one: Rows, other: Rows) -> bool:
    """Whether two rows are equal to the last bit (NaN equals NaN, -0.0 differs from 0.0)."""
    return msgspec.msgpack.encode(one) == msgspec.msgpack.encode(other)


def _positive(text: str, option: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if value <= 0:
        raise UsageError(f"{option}: {text!r} is not a number above 0")
    return value


@app.command()
def info(log: LogPath, as_json: Annotated[bool, typer.Option("--json", help="JSON on stdout")] = False) -> int:
    """What is in a recording, and whether all of it is there."""
    summary = summarise(_there(log))
    print(msgspec.json.encode(summary).decode() if as_json else describe(summary))
    return DONE if summary.verdict == "complete" else DEGRADED


@app.command("recover")
def recover_(log: LogPath, out: Annotated[Path, typer.Option("-o", "--out", metavar="OUT", help="new file")]) -> int:
    """Write every readable row of a broken recording into a new, complete file."""
    summary = recover(_there(log), out)
    say(f"{out}: {summary.rows} rows; the original is {summary.verdict}")
    return DONE


class ExportFormat(StrEnum):
    csv = "csv"
    parquet = "parquet"
    mat = "mat"
    mdf4 = "mdf4"
    rrd = "rrd"


@app.command("export")
def export_(
    log: LogPath,
    to: Annotated[ExportFormat, typer.Option(help="mat is the SIDPAC fdata layout")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="PATH", help="the file to make")],
) -> int:
    """Write the aligned table and the raw streams for other programs, units kept."""
    from station.convert import Format, export
    from station.view import write_rrd

    _there(log)
    if to is ExportFormat.rrd:
        about = metadata(log).about
        write_rrd(read_rows(log), out, title=f"{about.source} of {about.aircraft.name}")
        say(str(out))
    else:
        for made in export(log, cast(Format, to.value), out):
            say(str(made))
    return DONE


@app.command()
def simulate(
    scenario: Annotated[str, typer.Argument(metavar="SCENARIO", help="a card's name or path")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="LOG", help="the recording to write")],
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="replace a card's value")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="replace the flight's seed")] = None,
    duration: Annotated[float, typer.Option(help="seconds", min=1.0)] = 120.0,
) -> int:
    """Fly the simulation with the rig's sensors, faster than real time; the truth is recorded beside."""
    from station.simulation.simulate import fly

    profiles = load_card(scenario, overrides=dict(_setting(s) for s in settings or ()))
    shown, truth = fly(profiles.aircraft, profiles.rig, profiles.card, duration, seed)
    streams = tuple(s for s in _present(STREAMS.values(), shown))
    notes = {"scenario": scenario, "seed": str(profiles.card.flight.seed if seed is None else seed)}
    about = About(profiles.aircraft, streams, profiles.rig, profiles.card, "simulation", imported=True, notes=notes)
    count = write_log(out, about, _simulated_rows(streams, shown, truth))
    say(f"{out}: {count} rows, {duration:g} s of {profiles.aircraft.name}")
    return DONE


def _setting(text: str) -> tuple[str, Any]:
    """`key=value` with the value as TOML, or as the text itself."""
    key, equals, value = text.partition("=")
    if not equals or not key:
        raise UsageError(f'--set {text}: write KEY=VALUE, for example --set "flight.gust_sigma=5 ft/s"')
    try:
        return key.strip(), tomllib.loads(f"v = {value}")["v"]
    except tomllib.TOMLDecodeError:
        return key.strip(), value.strip()


def _present(streams: Any, shown: Any) -> Iterator[Stream]:
    """The streams with the signals that the rig has, at 50 Hz."""
    for s in streams:
        names = tuple(n for n in s.signals if n in shown)
        if names:
            yield Stream(s.name, names, 50.0, 0.2)


def _simulated_rows(streams: Sequence[Stream], shown: Any, truth: Any) -> Iterator[Rows]:
    names = [n for n in truth if n != "time"]
    columns = [np.column_stack([shown[n] for n in s.signals]).tolist() for s in streams]
    exact = np.column_stack([truth[n] for n in names]).tolist()
    for k, values in enumerate(exact):
        t_ns = k * TICK_NS
        for s, rows in zip(streams, columns, strict=True):
            yield Sample(t_ns, s.name, t_ns, k, tuple(rows[k]))
        yield Truth(t_ns, dict(zip(names, values, strict=True)))


def _there(log: Path) -> Path:
    if not log.is_file():
        raise LogError(f"{log}: no such file")
    return log
