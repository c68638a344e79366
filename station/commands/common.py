"""What several verbs take and check alike."""

from __future__ import annotations

import math
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from station.console import DEGRADED, DONE, say
from station.log import About, verdict
from station.profile import Profiles
from station.rows import LogError


class ViewMode(StrEnum):
    web = "web"
    native = "native"
    none = "none"


CardName = Annotated[str, typer.Argument(metavar="CARD", help="a name under profiles/cards, or a path")]
LogPath = Annotated[Path, typer.Argument(metavar="LOG", help="a recording (.mcap)")]


def finite(value: float | None) -> float | None:
    """For options: typer takes nan and inf for numbers."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"{value} is not a number of seconds")
    return value


def judged(log: Path) -> int:
    """DONE, or DEGRADED and a word on it where not all of the recording is there."""
    found = verdict(log)
    if found == "complete":
        return DONE
    say(f"station: {log} is {found}: station info tells what is missing")
    return DEGRADED


def there(log: Path) -> Path:
    if not log.is_file():
        raise LogError(f"{log}: no such file")
    return log


def profiles_of(about: About) -> Profiles | None:
    """What was flown, as a recording keeps it; None for an import."""
    if about.rig is None or about.card is None:
        return None
    return Profiles(aircraft=about.aircraft, rig=about.rig, card=about.card)
