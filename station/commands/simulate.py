"""station simulate: a flight of the simulation as a recording, its truth beside."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any

import typer

from station.api.simulated_rows import write_simulated
from station.commands.common import finite
from station.console import DEGRADED, DONE, say
from station.rows import UsageError


def simulate(
    scenario: Annotated[str, typer.Argument(metavar="SCENARIO", help="a card's name or path")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="LOG", help="the recording to write")],
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="replace a card's value")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="replace the flight's seed", min=0)] = None,
    duration: Annotated[
        float | None, typer.Option(help="seconds; 120, or what the card's steps take", min=1.0, callback=finite)
    ] = None,
) -> int:
    """Fly the simulation with the rig's sensors, faster than real time; the truth is recorded beside."""
    made = write_simulated(scenario, out, dict(_setting(s) for s in settings or ()), seed, duration)
    flown = f"{made.profiles.aircraft.name}{made.profiles.emulated_words}{made.profiles.card.flown}"
    say(f"{out}: {made.rows} rows, {made.duration_s:g} s of {flown}")
    for remark in made.remarks:
        say(f"station: {remark}")
    return DONE if made.is_sound else DEGRADED


def _setting(text: str) -> tuple[str, Any]:
    """`key=value` with the value as TOML, or as the text itself."""
    key, equals, value = text.partition("=")
    if not equals or not key:
        raise UsageError(f'--set {text}: write KEY=VALUE, for example --set "flight.gust_sigma=5 ft/s"')
    try:
        return key.strip(), tomllib.loads(f"v = {value}")["v"]
    except tomllib.TOMLDecodeError:
        return key.strip(), value.strip()
