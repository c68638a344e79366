"""station info: what is in a recording, and whether all of it is there."""

from __future__ import annotations

from typing import Annotated

import msgspec
import typer

from station.commands.common import LogPath, there
from station.console import judge
from station.log import describe, summarise


def info(log: LogPath, as_json: Annotated[bool, typer.Option("--json", help="JSON on stdout")] = False) -> int:
    """What is in a recording, and whether all of it is there."""
    summary = summarise(there(log))
    print(msgspec.json.encode(summary).decode() if as_json else describe(summary))
    return judge(summary.degraded)
