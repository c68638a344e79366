"""station points: the test points of recordings, by every method, and what has changed against the baseline."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from station.commands.common import completing, completing_methods, judged, there
from station.commands.printing import Pdf, check_pdf, told
from station.console import DEGRADED, DONE, check_json, say, write_json
from station.log import metadata
from station.profile import load_aircraft


def points(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="recordings (.mcap) with test points")],
    baseline: Annotated[
        list[Path] | None,
        typer.Option("--baseline", metavar="LOG", help="recordings whose points are the baseline; repeatable"),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(metavar="all|NAME", help="may be given several times", autocompletion=completing_methods),
    ] = None,
    aircraft: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="instead of the first recording's", autocompletion=completing("aircraft")),
    ] = None,
    as_json: Annotated[str | None, typer.Option("--json", metavar="PATH|-", help="write the result as JSON")] = None,
    report: Annotated[Path | None, typer.Option(metavar="DIR", help="write a page with pictures")] = None,
    pdf: Pdf = False,
) -> int:
    """Every test point by every method, the baseline, and the change against it in per cent with intervals.

    The baseline is made of the points whose condition says "baseline", or of all those of --baseline; without either,
    of the aircraft's profile.
    """
    from station.estimation.method_table import METHODS
    from station.identification.request import Request
    from station.programme.points_json import as_json as to_json
    from station.programme.points_listing import print_programme
    from station.programme.programme import programme

    for path in (*logs, *(baseline or [])):
        there(path)
    check_json(as_json)
    check_pdf(pdf, report)
    subject = load_aircraft(aircraft) if aircraft else metadata(logs[0]).about.aircraft
    names = [name for text in method or ["all"] for name in text.replace(",", " ").split()]
    known = Request(names).names()
    methods = tuple(METHODS) if "all" in names else known
    made = programme(logs, baseline or [], subject, methods, say)
    if report is not None:
        from station.programme.points_report import write_report  # and with it matplotlib

        told(write_report(made, report), pdf)
    if as_json is not None:
        write_json(to_json(made), as_json)
    if as_json != "-":
        print_programme(made)
    whole = max(judged(f.path) for f in made.flights)
    unused = [p for p in made.points if p.why and p.drag is None]
    for p in unused:
        say(f"station: {p.title}: {p.why}")
    return max(whole, DEGRADED if unused else DONE)
