"""station export: a recording for other programs."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, cast

import typer

from station.commands.common import LogPath, judged, profiles_of, there
from station.console import say
from station.log import make_folder, metadata, read_rows


class ExportFormat(StrEnum):
    csv = "csv"
    parquet = "parquet"
    mat = "mat"
    mdf4 = "mdf4"
    rrd = "rrd"


def export(
    log: LogPath,
    to: Annotated[ExportFormat, typer.Option(help="mat is the SIDPAC fdata layout")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="PATH", help="the file to make")],
) -> int:
    """Write the aligned table and the raw streams for other programs, units kept."""
    from station.convert import Format
    from station.convert import export as write_export
    from station.screen.rerun_page import write_rrd

    about = metadata(there(log)).about
    if to is ExportFormat.rrd:
        make_folder(out.parent)
        write_rrd(read_rows(log), out, profiles_of(about), title=f"{about.source} of {about.aircraft.name}")
        say(str(out))
    else:
        for made in write_export(log, cast(Format, to.value), out):
            say(str(made))
    return judged(log)
