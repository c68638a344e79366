"""station import: a recording of a record from elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from station.commands.common import completing
from station.commands.long_work import shares
from station.console import judge, say
from station.profile import load_aircraft, load_rig
from station.rows import UsageError


def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="fdata .mat, .csv, .asc, DataFlash .bin, .ulg, .ch10")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="LOG", help="the recording to make")],
    aircraft: Annotated[
        str, typer.Option(metavar="NAME", help="aircraft profile", autocompletion=completing("aircraft"))
    ],
    signal: Annotated[
        list[str] | None,
        typer.Option("--signal", metavar="SIGNAL=NAME", help="of .ch10: the measurement that is this signal; repeat"),
    ] = None,
    rig: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="rig that declares further columns of a CSV, [signals.NAME]"),
    ] = None,
) -> int:
    """Make a station recording of a record from elsewhere."""
    from station.api.flown_recording import write_import
    from station.log import metadata

    names = dict(_pair(text) for text in signal or ())
    with shares(f"importing {file.name}") as told:
        declaring = None if rig is None else load_rig(rig)
        rows = write_import(file, out, load_aircraft(aircraft), names, declaring, told)
    say(f"{out}: {rows} rows")
    notes = metadata(out).about.notes
    for about, words in notes.items():
        if words and about not in ("file", "lost"):
            say(f"  {about}: {words}")
    return judge([notes["lost"]] if "lost" in notes else [])


def _pair(text: str) -> tuple[str, str]:
    name, _, measurement = text.partition("=")
    if not name or not measurement:
        raise UsageError(f"--signal {text}: not SIGNAL=NAME, as in alpha_vane=AOA")
    return name.strip(), measurement.strip()
