"""station calibrate: a calibration flight's air data, vane and zeros, into a new aircraft profile."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from station.commands.common import completing, judged, there
from station.commands.printing import Pdf, check_pdf, told
from station.console import DEGRADED, DONE, check_json, say, write_json
from station.log import metadata
from station.profile import load_aircraft
from station.rows import UsageError


def calibrate(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="recordings (.mcap) of a calibration flight")],
    write_profile: Annotated[
        Path | None,
        typer.Option("-o", "--write-profile", metavar="PATH", help="write the calibrated aircraft, a new file"),
    ] = None,
    aircraft: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="instead of the first recording's", autocompletion=completing("aircraft")),
    ] = None,
    as_json: Annotated[str | None, typer.Option("--json", metavar="PATH|-", help="write the result as JSON")] = None,
    report: Annotated[Path | None, typer.Option(metavar="DIR", help="write a page with pictures")] = None,
    pdf: Pdf = False,
) -> int:
    """Position error, vane zero, upwash, place and lag, and zeros of attitude and accelerometers, pooled over runs.

    Fly reverse headings or full turns at two speeds or more, wings level for 40 s each, and a doublet, 3-2-1-1 or
    multisine of the elevator; the card `calibration` leads through it. The wind is solved along.
    """
    from station.profile.profile_text import write_profile as write_aircraft
    from station.programme.calibrated_profile import calibrated_aircraft, known_worse
    from station.programme.calibration import calibrate as calibrated
    from station.programme.calibration_json import as_json as to_json
    from station.programme.calibration_listing import print_calibration

    for path in logs:
        there(path)
    check_json(as_json)
    check_pdf(pdf, report)
    if write_profile is not None and write_profile.exists():
        raise UsageError(f"{write_profile}: is there already: a written profile never replaces a file; name another")
    subject = load_aircraft(aircraft) if aircraft else metadata(logs[0]).about.aircraft
    others = {metadata(path).about.aircraft.name for path in logs} - {subject.name}
    if others and aircraft is None:
        raise UsageError(
            f"recordings of several aircraft, {', '.join(sorted({subject.name, *others}))}: a calibration is one's"
        )
    made = calibrated(logs, subject, say)
    if report is not None:
        from station.programme.calibration_report import write_report  # and with it matplotlib

        told(write_report(made, report), pdf)
    if as_json is not None:
        write_json(to_json(made), as_json)
    if as_json != "-":
        print_calibration(made)
    if write_profile is not None:
        names = ", ".join(p.name for p in logs)
        heading = f"{subject.name} as calibrated by station calibrate, of {names}.\nSI; per radian."
        write_aircraft(calibrated_aircraft(made), write_profile, heading)
        say(f"written: {write_profile}")
        for words in known_worse(made):
            say(f"station: {words}")
    whole = max(judged(path) for path in logs)
    return max(whole, DONE if made.is_whole else DEGRADED)
