"""station identify: derivatives of a recording, by every method."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from station.commands.common import LogPath, judged, there
from station.console import DEGRADED, check_json, say, write_json
from station.log import metadata, points, table
from station.profile import load_aircraft
from station.rows import UsageError


class Axes(StrEnum):
    wind = "wind"
    body = "body"


def identify(
    log: LogPath,
    method: Annotated[list[str] | None, typer.Option(metavar="all|NAME", help="may be given several times")] = None,
    start: Annotated[float | None, typer.Option("--from", metavar="S", help="seconds on the log's time axis")] = None,
    end: Annotated[float | None, typer.Option("--to", metavar="S")] = None,
    point: Annotated[int | None, typer.Option(metavar="N", help="the interval of a test point")] = None,
    axes: Annotated[Axes, typer.Option(help="CL (wind) or CZ (body)")] = Axes.wind,
    sift: Annotated[bool, typer.Option("--sift", help="II and split from the lines that multisines excite")] = False,
    aircraft: Annotated[str | None, typer.Option(metavar="NAME", help="instead of the recording's aircraft")] = None,
    as_json: Annotated[str | None, typer.Option("--json", metavar="PATH|-", help="write the result as JSON")] = None,
    report: Annotated[Path | None, typer.Option(metavar="DIR", help="write a page with pictures")] = None,
) -> int:
    """Identify the derivatives of a recording, by every method and with honest errors."""
    from station.identification.analysis import identify as solve
    from station.identification.identification_json import as_json as to_json
    from station.identification.listing import print_estimates
    from station.identification.request import Request

    check_json(as_json)
    flown = table(there(log))
    about = metadata(log).about
    if point is not None:
        if start is not None or end is not None:
            raise UsageError("--point and --from/--to both name an interval: give one")
        start, end = _interval(log, point)
    subject = load_aircraft(aircraft) if aircraft else flown.aircraft
    noise, rig_place = about.noise_si(flown.aligned), about.imu_position
    names = [name for text in method or ["all"] for name in text.replace(",", " ").split()]
    request = Request(
        names, start, end, axes.value, card=about.card, imu_position=rig_place, noise=noise, sift=sift, log=str(log)
    )
    found = solve(flown, subject, request)
    if found.hint:
        say(f"station: {found.hint}")
    if report is not None:
        from station.identification.identification_report import write_report  # and with it matplotlib

        say(str(write_report(found, report)))
    if as_json is not None:
        write_json(to_json(found), as_json)
    if as_json != "-":
        print_estimates(found)
    whole = judged(log)
    return whole if found.recommended else DEGRADED


def _interval(log: Path, number: int) -> tuple[float, float]:
    known = points(log)
    for p in known:
        if p.n == number:
            return p.start_s, p.end_s
    numbers = ", ".join(str(p.n) for p in known) or "none"
    raise UsageError(f"{log}: no test point {number}\nmarked in it: {numbers}")
