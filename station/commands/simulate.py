"""station simulate: a flight of the simulation as a recording, its truth beside."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from station.commands.common import finite
from station.console import DEGRADED, DONE, say
from station.conventions import STREAMS, TICK_HZ, TICK_NS, Stream
from station.log import About, write_log
from station.profile import TestPoint, load_card
from station.rows import Code, Event, LogError, Rows, Sample, Truth, UsageError

USUAL_S = 120.0
OUT_OF_HAND = 0.6
"""Angle of attack, rad, that no profile's derivatives describe."""


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
    from station.flight.step_plan import planned
    from station.simulation.sortie import fly

    profiles = load_card(scenario, overrides=dict(_setting(s) for s in settings or ()))
    if out.exists():
        raise LogError(f"{out}: exists already, and a recording is never overwritten")
    card, steps_s = planned(profiles.card)
    # A second more, for the last point to end in.
    duration = max(USUAL_S, math.ceil(steps_s) + 1.0) if duration is None else duration
    if card.steps and duration < steps_s:
        say(f"station: the card's steps take {steps_s:.0f} s: not all are flown")
    shown, truth = fly(profiles.aircraft, profiles.rig, card, duration, seed)
    streams = tuple(s for s in _present(STREAMS.values(), shown))
    notes = {"scenario": scenario, "seed": str(profiles.card.flight.seed if seed is None else seed)}
    about = About(profiles.aircraft, streams, profiles.rig, profiles.card, "simulation", imported=True, notes=notes)
    count = write_log(out, about, _simulated_rows(streams, shown, truth, card.points))
    say(f"{out}: {count} rows, {duration:g} s of {profiles.aircraft.name}{profiles.card.flown}")
    beyond = np.flatnonzero(~(np.abs(truth["alpha"]) < OUT_OF_HAND))
    if len(beyond):
        angle, at = math.degrees(OUT_OF_HAND), truth["time"][beyond[0]]
        say(f"station: beyond {angle:.0f} deg of angle of attack from {at:.1f} s on: unstable, or too large an input")
        return DEGRADED
    return DONE


def _setting(text: str) -> tuple[str, Any]:
    """`key=value` with the value as TOML, or as the text itself."""
    key, equals, value = text.partition("=")
    if not equals or not key:
        raise UsageError(f'--set {text}: write KEY=VALUE, for example --set "flight.gust_sigma=5 ft/s"')
    try:
        return key.strip(), tomllib.loads(f"v = {value}")["v"]
    except tomllib.TOMLDecodeError:
        return key.strip(), value.strip()


def _present(streams: Any, shown: Any) -> Iterator[Stream]:
    """The streams with the signals that the rig has, at 50 Hz."""
    for s in streams:
        names = tuple(n for n in s.signals if n in shown)
        if names:
            yield Stream(s.name, names, 50.0, 0.2)


def _simulated_rows(streams: Sequence[Stream], shown: Any, truth: Any, points: Sequence[TestPoint]) -> Iterator[Rows]:
    names = [n for n in truth if n != "time"]
    columns = [np.column_stack([shown[n] for n in s.signals]).tolist() for s in streams]
    exact = np.column_stack([truth[n] for n in names]).tolist()
    marks = _marks(points, len(exact))
    for k, values in enumerate(exact):
        t_ns = k * TICK_NS
        yield from (Event(t_ns, "card", code, number, note) for code, number, note in marks.get(k, ()))
        for s, rows in zip(streams, columns, strict=True):
            yield Sample(t_ns, s.name, t_ns, k, tuple(rows[k]))
        yield Truth(t_ns, dict(zip(names, values, strict=True)))


def _marks(points: Sequence[TestPoint], rows: int) -> dict[int, list[tuple[Code, int, str]]]:
    """Begin and end of the points by row, their numbers and notes; of those that the flight is long enough for."""
    found: dict[int, list[tuple[Code, int, str]]] = {}
    for number, point in enumerate(points, 1):
        if point.start is not None and point.end is not None and round(point.start * TICK_HZ) < rows:
            found.setdefault(round(point.start * TICK_HZ), []).append((Code.POINT_START, number, point.note))
            found.setdefault(round(point.end * TICK_HZ), []).insert(0, (Code.POINT_END, number, point.note))
    return found
