"""station identify: derivatives of a recording, by every method."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from station.commands.common import LogPath, completing, completing_methods, judged, there
from station.commands.long_work import shown
from station.commands.printing import Pdf, check_pdf, told
from station.console import DEGRADED, check_json, say, write_json


class Axes(StrEnum):
    wind = "wind"
    body = "body"


def identify(
    log: LogPath,
    method: Annotated[
        list[str] | None,
        typer.Option(metavar="all|NAME", help="may be given several times", autocompletion=completing_methods),
    ] = None,
    start: Annotated[float | None, typer.Option("--from", metavar="S", help="seconds on the log's time axis")] = None,
    end: Annotated[float | None, typer.Option("--to", metavar="S")] = None,
    point: Annotated[int | None, typer.Option(metavar="N", help="the interval of a test point")] = None,
    axes: Annotated[Axes, typer.Option(help="CL (wind) or CZ (body)")] = Axes.wind,
    sift: Annotated[bool, typer.Option("--sift", help="II and split from the lines that multisines excite")] = False,
    aircraft: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="instead of the recording's aircraft", autocompletion=completing("aircraft")),
    ] = None,
    as_json: Annotated[str | None, typer.Option("--json", metavar="PATH|-", help="write the result as JSON")] = None,
    report: Annotated[Path | None, typer.Option(metavar="DIR", help="write a page with pictures")] = None,
    pdf: Pdf = False,
) -> int:
    """Identify the derivatives of a recording, by every method and with honest errors."""
    from station.api.identifying import identify as solve
    from station.identification.listing import print_estimates

    check_json(as_json)
    check_pdf(pdf, report)
    names = [name for text in method or ["all"] for name in text.replace(",", " ").split()]
    with shown(f"identifying {log.name}"):
        made = solve(
            there(log), names, start=start, end=end, point=point, axes=axes.value, sift=sift, aircraft=aircraft
        )
    found = made.found
    if found.hint:
        say(f"station: {found.hint}")
    if report is not None:
        told(made.report(report), pdf)
    if as_json is not None:
        write_json(made.json(), as_json)
    if as_json != "-":
        print_estimates(found)
    whole = judged(log)
    return whole if found.recommended else DEGRADED
