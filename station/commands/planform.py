"""station planform: unsteady lift, upwash, downwash and sidewash of an aircraft's outline."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Final

import typer

from station.commands.common import completing
from station.commands.printing import Pdf, check_pdf, told
from station.console import DONE, check_json, say, write_json
from station.profile import Aircraft, load_aircraft
from station.rows import UsageError

_CRUISE: Final = 0.5
"""Lift coefficient of the speed that is taken where neither --speed nor the profile says one, at sea level."""


def planform(
    aircraft: Annotated[
        str,
        typer.Argument(
            metavar="AIRCRAFT", help="a name under profiles/aircraft, or a path", autocompletion=completing("aircraft")
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="PROFILE", help="write the aircraft with it, a new file")
    ] = None,
    speed: Annotated[
        float | None, typer.Option(metavar="M/S", help="at which the downwash's delay is given in seconds")
    ] = None,
    as_json: Annotated[str | None, typer.Option("--json", metavar="PATH|-", help="write the result as JSON")] = None,
    report: Annotated[Path | None, typer.Option(metavar="DIR", help="write a page with pictures")] = None,
    pdf: Pdf = False,
) -> int:
    """Indicial lift, upwash at the vane, downwash at the tail and its delay by an unsteady vortex lattice of the wing.

    Of [geometry], [boom], [unsteady] (tail_arm, tail_span) and [planform]; the sidewash at the fin by DATCOM. Beside it
    stands what the profile has.
    """
    from station.model.outline_responses import planform_answer, with_planform
    from station.profile.profile_text import write_profile
    from station.programme.planform_words import as_json as to_json
    from station.programme.planform_words import print_planform

    check_json(as_json)
    check_pdf(pdf, report)
    if out is not None and out.exists():
        raise UsageError(f"{out}: is there already: a written profile never replaces a file; name another")
    if speed is not None and not 0 < speed < math.inf:
        raise UsageError(f"--speed {speed:g}: a true airspeed above 0, in m/s")
    subject = load_aircraft(aircraft)
    made = planform_answer(subject, speed or subject.reference_speed or _cruise(subject))
    if report is not None:
        from station.programme.planform_report import write_report  # and with it matplotlib

        told(write_report(made, report), pdf)
    if as_json is not None:
        write_json(to_json(made), as_json)
    if as_json != "-":
        print_planform(made)
    if out is not None:
        write_profile(with_planform(made), out, f"{subject.name} with what station planform made of its outline.\nSI.")
        say(f"written: {out}")
    return DONE


def _cruise(aircraft: Aircraft) -> float:
    """m/s."""
    weight = 9.80665 * aircraft.inertia.mass
    return math.sqrt(2 * weight / (1.225 * aircraft.geometry.wing_area * _CRUISE))
