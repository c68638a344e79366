"""Simulated programmes for tests: a recording with marked points, made once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from station.commands.simulate import simulate

HEAD = """
name = "test"
aircraft = "twin_otter"
rig = "boom_thrust"
[flight]
speed = "110 kt"
altitude = "2500 ft"
"""
INPUTS = """
[[manoeuvres]]
kind = "doublet"
start = "8 s"
repeat = "30 s"
amplitude = "3.5 deg"
width = "0.6 s"
[[manoeuvres]]
kind = "3-2-1-1"
start = "16 s"
repeat = "30 s"
amplitude = "-2.5 deg"
unit = "0.5 s"
"""


def flown(
    folder: Path, points: Sequence[Mapping[str, str]], seconds: float, flight: str = "", inputs: str = INPUTS
) -> Path:
    """A recording of the simulation with these points; `flight`: more lines of the card's [flight]."""
    card = folder / "card.toml"
    marks = "".join("[[points]]\n" + "".join(f'{k} = "{v}"\n' for k, v in p.items()) for p in points)
    card.write_text(HEAD + flight + inputs + marks)
    log = folder / "flight.mcap"
    simulate(str(card), log, None, 1, seconds)
    return log
