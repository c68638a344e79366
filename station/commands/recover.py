"""station recover: what can be read of a broken recording, as a new one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from station.commands.common import LogPath, completing, there
from station.console import DONE, say
from station.log import in_words
from station.log import recover as write_recovered
from station.profile import load_aircraft


def recover(
    log: LogPath,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="OUT", help="new file")],
    aircraft: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="what flew, where the recording can no longer say it",
            autocompletion=completing("aircraft"),
        ),
    ] = None,
) -> int:
    """Write every readable row of a broken recording into a new, complete file."""
    summary = write_recovered(there(log), out, None if aircraft is None else load_aircraft(aircraft))
    say(f"{out}: {summary.rows} rows; the original is {in_words(summary)}")
    return DONE
