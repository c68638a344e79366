"""station import: a recording of a record from elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from station.commands.long_work import shown
from station.console import DONE, say
from station.profile import load_aircraft


def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="fdata .mat, .csv, HFB-320 .asc, DataFlash .bin, .ulg")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="LOG", help="the recording to make")],
    aircraft: Annotated[str, typer.Option(metavar="NAME", help="aircraft profile")],
) -> int:
    """Make a station recording of a record from elsewhere."""
    from station.api.flown_recording import write_import

    with shown(f"importing {file.name}", moving=False):
        rows = write_import(file, out, load_aircraft(aircraft))
    say(f"{out}: {rows} rows")
    return DONE
