"""station export: a recording for other programs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Final, cast

import typer

from station.commands.common import LogPath, judged, profiles_of, there
from station.commands.long_work import shown
from station.console import say
from station.log import make_folder, metadata, read_rows
from station.rows import LogError, Rows

_EVERY: Final = 10_000
"""Rows: a twentieth of a second."""


class ExportFormat(StrEnum):
    csv = "csv"
    parquet = "parquet"
    mat = "mat"
    mdf4 = "mdf4"
    rrd = "rrd"
    ulog = "ulog"
    tlog = "tlog"
    mcap = "mcap"


def _packets() -> Callable[[bytes], list[bytes]]:
    """MAVLink packets out of what one device sends."""
    from drivers.mavlink_frame import Framer

    framer = Framer()
    return lambda data: [bytes(message.get_msgbuf()) for message in framer.feed(data)]


def telling(rows: Iterator[Rows], told: Callable[[int], None]) -> Iterator[Rows]:
    """The rows, telling now and then how far they have come."""
    for count, row in enumerate(rows):
        if not count % _EVERY:
            told(row.t_ns)
        yield row


def export(
    log: LogPath,
    to: Annotated[
        ExportFormat, typer.Option(help="mat: SIDPAC's fdata; ulog: PX4's; tlog: the raw MAVLink; mcap: for Foxglove")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="PATH", help="the file to make")],
) -> int:
    """Write the aligned table and the raw streams for other programs, units kept."""
    from station.convert import Format
    from station.convert import export as write_export
    from station.convert.new_file import new_file
    from station.screen.rerun_files import write_rrd

    about = metadata(there(log)).about
    if to is ExportFormat.rrd:
        make_folder(out.parent)
        try:
            with shown(f"exporting {log.name}", log) as told, new_file(out) as partial:
                title = f"{about.source} of {about.aircraft.name}"
                write_rrd(telling(read_rows(log), told), partial, profiles_of(about), title=title)
        except FileExistsError:
            raise LogError(f"{out}: exists already and is not overwritten") from None
        say(str(out))
    else:
        with shown(f"exporting {log.name}", log) as told:
            files = write_export(log, cast(Format, to.value), out, _packets, told)
        for made in files:
            say(str(made))
    return judged(log)
