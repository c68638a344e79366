"""station baseline: derivatives and drag pooled over test points, as a new aircraft profile."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from station.commands.common import completing, judged, there
from station.console import DEGRADED, DONE, say
from station.log import metadata
from station.profile import load_aircraft
from station.rows import UsageError


def baseline(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="recordings (.mcap) with test points")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="PROFILE", help="the aircraft profile to write")],
    aircraft: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="instead of the first recording's", autocompletion=completing("aircraft")),
    ] = None,
) -> int:
    """Pool test points into measured derivatives and drag with sd, and write them as a new aircraft profile.

    Of the points whose condition says "baseline", of all where none does. A card that names the profile has the flight
    held against it, and `points --aircraft PROFILE` the points.
    """
    from station.profile.profile_text import write_profile
    from station.programme.baseline_listing import print_baseline
    from station.programme.measured_baseline import baseline_points, measured_baseline
    from station.programme.programme import programme

    for path in logs:
        there(path)
    if out.exists():
        raise UsageError(f"{out}: is there already: a written profile never replaces a file; name another")
    subject = load_aircraft(aircraft) if aircraft else metadata(logs[0]).about.aircraft
    flown = programme(logs, [], subject, ("split", "split+gust", "physical"), say, baseline_points)
    made = measured_baseline(flown.flights, flown.points, subject)
    names = ", ".join(f.path.name for f in flown.flights)
    write_profile(made.aircraft, out, f"{subject.name} as measured by station baseline, of {names}.\nSI; per radian.")
    print_baseline(made)
    print(f"written: {out}")
    whole = max(judged(f.path) for f in flown.flights)
    return max(whole, DEGRADED if len(made.points) == 1 else DONE)
