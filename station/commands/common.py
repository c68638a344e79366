"""What several verbs take and check alike."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Final

import typer

from station.console import DEGRADED, DONE, say
from station.log import About, metadata, verdict
from station.profile import Profiles
from station.profile.files import Kind, named

_OF_SSH: Final = 4
"""Words of SSH_CONNECTION: address and port of the client, then of this machine."""


class ViewMode(StrEnum):
    web = "web"
    native = "native"
    none = "none"


def completing(kind: Kind) -> Callable[[str], list[str]]:
    """What a shell offers for a profile's name; the shell itself offers files beside."""

    def names(incomplete: str) -> list[str]:
        return [name for name in named(kind) if name.startswith(incomplete)]

    return names


def completing_methods(incomplete: str) -> list[str]:
    """What a shell offers for a method's name."""
    from station.estimation.method_table import METHODS

    return [name for name in ("all", *METHODS) if name.startswith(incomplete)]


CardName = Annotated[
    str,
    typer.Argument(metavar="CARD", help="a name under profiles/cards, or a path", autocompletion=completing("cards")),
]
FlownAircraft = Annotated[
    str | None,
    typer.Option(
        "--aircraft",
        metavar="NAME",
        help="instead of the card's: a name, or a path",
        autocompletion=completing("aircraft"),
    ),
]
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
        metadata(log)  # raises, and names later files of it that are there
    return log


def profiles_of(about: About) -> Profiles | None:
    """What was flown, as a recording keeps it; None for an import."""
    if about.rig is None or about.card is None:
        return None
    return Profiles(aircraft=about.aircraft, rig=about.rig, card=about.card)


def page_words(address: str, name: str = "viewer") -> str:
    """Where a page is; for who is logged in over ssh, with the command that brings its ports to them: it is
    on this machine's loopback."""
    here = os.environ.get("SSH_CONNECTION", "").split()
    ports = dict.fromkeys(re.findall(r"127\.0\.0\.1:(\d+)", address))
    if len(here) != _OF_SSH or not ports:
        return f"{name}: {address}"
    forwards = " ".join(f"-L {port}:127.0.0.1:{port}" for port in ports)
    return f"{name}: {address}\nyou are here over ssh: first, on your machine: ssh -N {forwards} {here[2]}"
