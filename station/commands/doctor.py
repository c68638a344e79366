"""station doctor: what of this machine matters to a flight, in one block to be pasted."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Final

import typer

from station.commands.machine import examine
from station.console import judge

MARKS: Final = {"ok": " ", "note": "-", "mend": "!"}


def doctor(
    log: Annotated[Path, typer.Option(metavar="DIR", help="where recordings are to be kept")] = Path("logs"),
    as_json: Annotated[bool, typer.Option("--json", help="JSON on stdout")] = False,
) -> int:
    """Look at the machine: versions, processor, clock, disk, ports, permissions, terminal, browser. Exit code 3 where
    something is to be mended, marked !."""
    found = list(examine(log))
    if as_json:
        print(json.dumps({"schema": "station.doctor/1", "findings": [asdict(f) for f in found]}))
    else:
        width = max(len(f.about) for f in found)
        for f in found:
            print(f"{MARKS[f.state]} {f.about:{width}}  {f.found}")
            if f.mend:
                print(f"  {'':{width}}  -> {f.mend}")
    return judge([f"{f.about}: {f.mend}" for f in found if f.state == "mend"])
