"""Verbs on recordings: replay, info, recover, identify, simulate. No hardware in reach."""

from __future__ import annotations

import contextlib
import json
import math
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, cast

import msgspec
import numpy as np
import typer

from station.clock import SystemClock
from station.conventions import STREAMS, TICK_NS, Stream
from station.log import (
    About,
    describe,
    make_folder,
    metadata,
    points,
    read_rows,
    recover,
    summarise,
    table,
    verdict,
    write_log,
)
from station.profile import Profiles, load_aircraft, load_card
from station.rows import LogError, Rows, Sample, Truth, UsageError

app = typer.Typer()

DONE, ERROR, USAGE, DEGRADED = 0, 1, 2, 3
OUT_OF_HAND = 0.6
"""Angle of attack, rad, that no profile's derivatives describe."""


class ViewMode(StrEnum):
    web = "web"
    native = "native"
    none = "none"


def say(text: str) -> None:
    """Words for the user, on stderr; stdout is for what was asked for."""
    with contextlib.suppress(OSError):  # nobody there to hear it
        print(text, file=sys.stderr, flush=True)


def write_json(result: Mapping[str, Any], to: str) -> None:
    """The result of a verb to a file, or to stdout for "-". Raises LogError if the file cannot be written."""
    if to == "-":
        print(json.dumps(result, allow_nan=False))
        return
    try:
        Path(to).write_text(json.dumps(result, indent=1, allow_nan=False), encoding="utf-8")
    except OSError as error:
        raise LogError(f"{to}: cannot be written: {error.strerror}") from error


def check_json(to: str | None) -> None:
    """Before an hour of work whose result could not be written. Raises LogError."""
    if to not in (None, "-") and not Path(str(to)).absolute().parent.is_dir():
        raise LogError(f"{to}: cannot be written: no such folder")


def finite(value: float | None) -> float | None:
    """For options: typer takes nan and inf for numbers."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"{value} is not a number of seconds")
    return value


def judged(log: Path) -> int:
    """DONE, or DEGRADED and a word on it where not all of the recording is there."""
    found = verdict(log)
    if found == "complete":
        return DONE
    say(f"station: {log} is {found}: station info tells what is missing")
    return DEGRADED


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
    from station.comparing import Comparison
    from station.estimation.disagreement import Disagreement
    from station.estimation.instruments import corrector
    from station.estimation.methods import Estimator
    from station.view import View

    rate = None if speed == "max" else _positive(speed, "--speed")
    about = metadata(log).about
    if about.imported or about.rig is None or about.card is None:
        raise UsageError(f"{log}: an imported record has no ticks to replay\nuse: station identify {log}")
    clock = SystemClock()
    noise = about.rig.noise_si()
    estimator = Estimator(about.aircraft, about.card, about.rig.imu_position, about.rig.frame_noise_si())
    estimator.warm_up()
    watch = Disagreement(about.aircraft, about.rig.imu_position, about.rig.frame_noise_si())
    correct = corrector(about.aircraft, about.rig.frame_noise_si(), about.rig.imu_position)
    source: Iterator[live.Beat] = live.recorded_beats(read_rows(log))
    if rate is not None:
        source = live.paced(source, clock, rate)
    found = Comparison()
    with ExitStack() as stack:
        show = None
        if view is not ViewMode.none:
            viewer = View(view.value, f"replay of {log.name}", _profiles(about), on_event=lambda _: None)
            stack.callback(viewer.close)
            say(f"viewer: {viewer.start()}")

            def show(rows: Sequence[Rows]) -> None:
                viewer.show(rows)
                # Faster than it can be drawn: wait, or ticks would be dropped.
                if rate is None and found.beats % 200 == 0:
                    viewer.flush(10.0)

        live.run(source, Aligner(about.streams, noise), estimator, None, show, found.take, watch, correct)
    if found.beats == 0:
        raise UsageError(f"{log}: no ticks in it: nothing to replay")
    print(f"{found.beats} ticks, {found.rows} rows compared, {found.different} different")
    if verify and found.different:
        say(found.first)
        return ERROR
    whole = judged(log)
    return DONE if verify else whole


def _positive(text: str, option: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < math.inf:
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


class Axes(StrEnum):
    wind = "wind"
    body = "body"


@app.command()
def identify(
    log: LogPath,
    method: Annotated[list[str] | None, typer.Option(metavar="all|NAME", help="may be given several times")] = None,
    start: Annotated[float | None, typer.Option("--from", metavar="S", help="seconds on the log's time axis")] = None,
    end: Annotated[float | None, typer.Option("--to", metavar="S")] = None,
    point: Annotated[int | None, typer.Option(metavar="N", help="the interval of a test point")] = None,
    axes: Annotated[Axes, typer.Option(help="CL (wind) or CZ (body)")] = Axes.wind,
    sift: Annotated[bool, typer.Option("--sift", help="II and split from the lines that a multisine excites")] = False,
    aircraft: Annotated[str | None, typer.Option(metavar="NAME", help="instead of the recording's aircraft")] = None,
    as_json: Annotated[str | None, typer.Option("--json", metavar="PATH|-", help="write the result as JSON")] = None,
    report: Annotated[Path | None, typer.Option(metavar="DIR", help="write a page with pictures")] = None,
) -> int:
    """Identify the derivatives of a recording, by every method and with honest errors."""
    from station.identify import identify as solve
    from station.listing import print_estimates
    from station.report import write_report

    check_json(as_json)
    flown = table(_there(log))
    about = metadata(log).about
    if point is not None:
        if start is not None or end is not None:
            raise UsageError("--point and --from/--to both name an interval: give one")
        start, end = _interval(log, point)
    subject = load_aircraft(aircraft) if aircraft else flown.aircraft
    noise = None
    if about.rig is not None:
        noise = about.rig.noise_si() if about.imported else about.rig.frame_noise_si()
    rig_place = about.rig.imu_position if about.rig is not None else (0.0, 0.0, 0.0)
    names = [name for text in method or ["all"] for name in text.replace(",", " ").split()]
    result = solve(
        flown,
        subject,
        names,
        start,
        end,
        axes.value,
        log=str(log),
        card=about.card,
        imu_position=rig_place,
        noise=noise,
        sift=sift,
    )
    if result["hint"]:
        say(f"station: {result['hint']}")
    if report is not None:
        page = write_report(
            result, flown, report, card=about.card, imu_position=rig_place, noise=noise, aircraft=subject
        )
        say(str(page))
    if as_json is not None:
        write_json(result, as_json)
    if as_json != "-":
        print_estimates(result)
    whole = judged(log)
    return whole if result["recommended"] else DEGRADED


def _interval(log: Path, number: int) -> tuple[float, float]:
    known = points(log)
    for p in known:
        if p.n == number:
            return p.start_s, p.end_s
    numbers = ", ".join(str(p.n) for p in known) or "none"
    raise UsageError(f"{log}: no test point {number}\nmarked in it: {numbers}")


@app.command("export")
def export_(
    log: LogPath,
    to: Annotated[ExportFormat, typer.Option(help="mat is the SIDPAC fdata layout")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="PATH", help="the file to make")],
) -> int:
    """Write the aligned table and the raw streams for other programs, units kept."""
    from station.convert import Format, export
    from station.view import write_rrd

    about = metadata(_there(log)).about
    if to is ExportFormat.rrd:
        make_folder(out.parent)
        write_rrd(read_rows(log), out, _profiles(about), title=f"{about.source} of {about.aircraft.name}")
        say(str(out))
    else:
        for made in export(log, cast(Format, to.value), out):
            say(str(made))
    return judged(log)


def _profiles(about: About) -> Profiles | None:
    """What was flown, as a recording keeps it; None for an import."""
    if about.rig is None or about.card is None:
        return None
    return Profiles(aircraft=about.aircraft, rig=about.rig, card=about.card, rig_dir="")


@app.command()
def simulate(
    scenario: Annotated[str, typer.Argument(metavar="SCENARIO", help="a card's name or path")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="LOG", help="the recording to write")],
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="replace a card's value")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="replace the flight's seed", min=0)] = None,
    duration: Annotated[float, typer.Option(help="seconds", min=1.0, callback=finite)] = 120.0,
) -> int:
    """Fly the simulation with the rig's sensors, faster than real time; the truth is recorded beside."""
    from station.simulation.simulate import fly

    profiles = load_card(scenario, overrides=dict(_setting(s) for s in settings or ()))
    if out.exists():
        raise LogError(f"{out}: exists already, and a recording is never overwritten")
    shown, truth = fly(profiles.aircraft, profiles.rig, profiles.card, duration, seed)
    streams = tuple(s for s in _present(STREAMS.values(), shown))
    notes = {"scenario": scenario, "seed": str(profiles.card.flight.seed if seed is None else seed)}
    about = About(profiles.aircraft, streams, profiles.rig, profiles.card, "simulation", imported=True, notes=notes)
    count = write_log(out, about, _simulated_rows(streams, shown, truth))
    say(f"{out}: {count} rows, {duration:g} s of {profiles.aircraft.name}")
    beyond = np.flatnonzero(~(np.abs(truth["alpha"]) < OUT_OF_HAND))
    if len(beyond):
        angle, at = math.degrees(OUT_OF_HAND), truth["time"][beyond[0]]
        say(f"station: beyond {angle:.0f} deg of angle of attack from {at:.1f} s on: unstable, or too large an input")
        return DEGRADED
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
