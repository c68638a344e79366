"""A flight of the simulation as the rows of a recording."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from station.conventions import STREAMS, TICK_HZ, TICK_NS, Stream
from station.log import About, write_log
from station.profile import Profiles, TestPoint, load_card
from station.rows import Code, Event, LogError, Rows, Sample, Truth, UsageError

USUAL_S = 120.0
OUT_OF_HAND = 0.6
"""Angle of attack, rad, that no profile's derivatives describe."""


@dataclass(frozen=True, slots=True)
class Simulated:
    """A flight that was written."""

    profiles: Profiles
    duration_s: float
    rows: int
    remarks: tuple[str, ...]
    """What is not as one would expect, in sentences."""
    is_sound: bool
    """Whether derivatives describe all of it."""


def write_simulated(
    scenario: str, out: Path, settings: Mapping[str, Any], seed: int | None, duration: float | None
) -> Simulated:
    """Fly a card, `settings` replacing its values and `seed` its flight's, for `duration` s: 120, or what its steps
    take. Raises ProfileError, UsageError and LogError."""
    from station.flight.reach import travel_remarks, without_effect
    from station.flight.step_plan import planned
    from station.simulation.sortie import fly

    if duration is not None and not duration >= 1.0:
        raise UsageError(f"duration {duration:g}: a flight takes a second or more")
    profiles = load_card(scenario, overrides=settings)
    if out.exists():
        raise LogError(f"{out}: exists already, and a recording is never overwritten")
    card, steps_s = planned(profiles.card)
    remarks = [*travel_remarks(profiles.card, profiles.flown), *without_effect(profiles, emulated=True)]
    if profiles.rig.loop is not None:
        remarks.append(f"the rig's loop ({profiles.rig.loop.kind}) is left out: nothing from outside moves a surface")
    # A second more, for the last point to end in.
    seconds = max(USUAL_S, math.ceil(steps_s) + 1.0) if duration is None else duration
    if card.steps and seconds < steps_s:
        remarks.append(f"the card's steps take {steps_s:.0f} s: not all are flown")
    shown, truth = fly(profiles.flown, profiles.rig, card, seconds, seed)
    declared = tuple(s.name for s in profiles.rig.further.measured)
    groups = (*STREAMS.values(), *([Stream("declared", declared, 50.0, 0.2)] if declared else []))
    streams = tuple(_present(groups, shown))
    notes = {"scenario": scenario, "seed": str(profiles.card.flight.seed if seed is None else seed)}
    about = About(profiles.aircraft, streams, profiles.rig, profiles.card, "simulation", imported=True, notes=notes)
    count = write_log(out, about, _rows(streams, shown, truth, card.points))
    beyond = np.flatnonzero(~(np.abs(truth["alpha"]) < OUT_OF_HAND))
    if len(beyond):
        angle, at = math.degrees(OUT_OF_HAND), truth["time"][beyond[0]]
        remarks.append(f"beyond {angle:.0f} deg of angle of attack from {at:.1f} s on: unstable, or too large an input")
    return Simulated(profiles, seconds, count, tuple(remarks), not len(beyond))


def _present(streams: Any, shown: Any) -> Iterator[Stream]:
    """The streams with the signals that the rig has, at 50 Hz."""
    for s in streams:
        names = tuple(n for n in s.signals if n in shown)
        if names:
            yield Stream(s.name, names, 50.0, 0.2)


def _rows(streams: Sequence[Stream], shown: Any, truth: Any, points: Sequence[TestPoint]) -> Iterator[Rows]:
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
