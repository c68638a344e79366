"""All test points of some recordings, their baseline and the changes against it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from scipy.stats import norm

from station.log import Point, Table, metadata, points, table
from station.model.change_patterns import NAMES, in_words, matches, patterns
from station.numerics.random_effects import NORMAL_95
from station.profile import Aircraft, other_sizes, otherwise, unlike_recorded
from station.programme.changes import (
    Baseline,
    Change,
    baseline_of,
    changes_of,
    drag_change,
    lift_change,
    recommended,
    scatter_of,
)
from station.programme.flown_points import FlownPoint, flown_point, marked, named
from station.rows import UsageError


@dataclass(frozen=True, slots=True)
class Flight:
    """A recording: its table, and its points as they were marked."""

    path: Path
    table: Table
    points: tuple[Point, ...]
    are_marked: bool


@dataclass(frozen=True, slots=True)
class Programme:
    """The result: points in the order flown, those of the baseline's recordings first."""

    aircraft: Aircraft
    flights: tuple[Flight, ...]
    points: tuple[FlownPoint, ...]
    baseline: Baseline
    remarks: tuple[str, ...] = ()
    changes: Mapping[int, Mapping[str, Mapping[str, Change]]] = field(default_factory=dict)
    """By the point's place, by method, by derivative."""

    def change(self, place: int) -> Mapping[str, Change]:
        """A point's changes by its recommended method, where it has one, and those of drag and lift."""
        point = self.points[place]
        best = recommended(point)
        level = {"CD_0": drag_change(point, self.baseline), "CL_0": lift_change(point, self.baseline, self.aircraft)}
        return {**(self.changes[place][best] if best else {}), **level}

    def likeness(self, place: int) -> str:
        """What a point's changes look like, in words; "" where nothing has changed."""
        drag = self.points[place].drag
        lift = drag.lift.lift if drag is not None and drag.lift is not None else math.nan
        return likeness(self.change(place), self.aircraft, lift)


def flights_of(logs: Sequence[Path]) -> tuple[Flight, ...]:
    """The recordings, read. Raises LogError."""
    made = []
    for log in logs:
        flown = table(log)
        known = points(log)
        made.append(Flight(log, flown, tuple(marked(flown, known, log)), bool(known)))
    return tuple(made)


def _of_one_aircraft(flights: Sequence[Flight]) -> None:
    """Raises UsageError where recordings are of aircraft of another size: neither's derivatives say a thing of the
    other's. What a profile is called does not matter: a calibrated one is the same aircraft's."""
    sizes: dict[tuple[str, ...], Flight] = {}
    for flight in flights:
        g = flight.table.aircraft.geometry
        if not flight.table.aircraft.kinematics_only:
            sizes.setdefault(tuple(f"{x:.4g}" for x in (g.wing_area, g.span, g.chord)), flight)
    if len(sizes) > 1:
        named = ", ".join(f"{f.table.aircraft.name} in {f.path.name}" for f in sizes.values())
        raise UsageError(f"recordings of several aircraft: {named}\nhold each against a baseline of its own")


def _of_the_profile_s(flights: Sequence[Flight], aircraft: Aircraft) -> None:
    """Raises UsageError where a recording is not of the aircraft whose instruments or derivatives this profile has from
    flights: they say nothing of another's."""
    if aircraft.measured is None and aircraft.calibrated is None:
        return
    how = "calibrated" if aircraft.measured is None else "measured"
    for flight in flights:
        found = other_sizes(aircraft, flight.table.aircraft)
        if found:
            raise UsageError(
                f"recordings of several aircraft: {flight.table.aircraft.name} in {flight.path.name}, while "
                f"{aircraft.name} was {how} with another: {'; '.join(found)}\n"
                "hold each against a baseline of its own"
            )


def programme(
    logs: Sequence[Path],
    baseline_logs: Sequence[Path],
    aircraft: Aircraft,
    methods: Sequence[str],
    say: Callable[[str], None],
    asked: Callable[[Flight], tuple[Point, ...]] = lambda flight: flight.points,
) -> Programme:
    """Every point of the recordings by these methods.

    The baseline is made of every point of `baseline_logs`; without such, of those points whose condition says
    "baseline". `say` is told of each point as it begins; `asked` gives those to be used of a flight. Raises LogError,
    and UsageError where no point can be used.
    """
    flights = flights_of(tuple(dict.fromkeys((*baseline_logs, *logs))))
    _of_one_aircraft(flights)
    _of_the_profile_s(flights, aircraft)
    made = []
    for flight in flights:
        about = metadata(flight.path).about
        noise, place = about.noise_si(flight.table.aligned), about.imu_position
        for point in asked(flight):
            say(f"  {flight.path.name}: {point.note or point.n}, {point.start_s:.0f} to {point.end_s:.0f} s")
            made.append(flown_point(flight.table, point, aircraft, about.card, place, noise, methods, str(flight.path)))
    if not any(p.found for p in made):
        raise UsageError("no test point can be used\n" + "\n".join(f"{p.title}: {p.why}" for p in made[:2]))
    theirs = {str(p) for p in baseline_logs}
    of_baseline = [p for p in made if (p.log in theirs if theirs else p.is_baseline)]
    baseline = baseline_of(of_baseline, aircraft)
    others = {f.table.aircraft.name for f in flights} - {aircraft.name}
    remarks = [f"recorded with the profile {name}, identified with {aircraft.name}" for name in sorted(others)]
    for f in flights:
        said = unlike_recorded(aircraft, f.table.aircraft, mass_recorded="mass" in f.table.columns)
        remarks += [f"{f.path.name}: {words}" for words in said]
    remarks += twice(flights)
    remarks += [f"{f.path.name}: no test point is marked: all of it is one" for f in flights if not f.are_marked]
    remarks += list(_other_configurations(made, baseline, aircraft))
    remarks += list(_without_drag(made, baseline))
    changes = {i: {m: changes_of(p, m, baseline) for m in p.methods or {}} for i, p in enumerate(made)}
    return Programme(aircraft, flights, tuple(made), baseline, (*remarks, *scatter_of(baseline)), changes)


def twice(flights: Sequence[Flight]) -> Iterator[str]:
    """Points of a flight that overlap in time, and those of one name."""
    for flight in flights:
        points = [(named(p)[0], p) for p in flight.points]
        for i, (name, p) in enumerate(points):
            for other, q in points[:i]:
                begin, end = max(p.start_s, q.start_s), min(p.end_s, q.end_s)
                if begin < end:
                    yield (
                        f"{flight.path.name}: {other} and {name} overlap from {begin:.0f} to {end:.0f} s: what was "
                        "flown there counts twice, and their errors are not independent"
                    )
        names = [name for name, _ in points]
        for name in dict.fromkeys(n for n in names if names.count(n) > 1):
            yield f"{flight.path.name}: {names.count(name)} points are named {name}: tell them by their times"


def _other_configurations(points: Sequence[FlownPoint], baseline: Baseline, aircraft: Aircraft) -> Iterable[str]:
    """Points that were flown otherwise than the baseline, by their conditions."""
    theirs = [p.condition for p in points if p.title in baseline.points]
    if not theirs and aircraft.measured is not None:
        theirs = [aircraft.measured.condition]
    for p in points:
        found = dict.fromkeys(pair for condition in theirs for pair in otherwise(p.condition, condition))
        for own, other in found:
            yield f"{p.name}: {own}, the baseline {other}: what that alone changes is told as changed"


def _without_drag(points: Sequence[FlownPoint], baseline: Baseline) -> Iterable[str]:
    """Points of which no change of drag can be told though the baseline knows its own, and why."""
    for p in points if baseline.drag is not None else ():
        change = drag_change(p, baseline)
        if p.found is not None and not change.is_known:
            yield f"{p.name}: nothing is known of its drag: {change.why}"


def likeness(changes: Mapping[str, Change], aircraft: Aircraft, lift: float = math.nan) -> str:
    """What changes at a mean CL of `lift` look like, in words; "" where nothing has changed."""
    if not changed(changes):
        return ""
    known = {n: (c.estimate / 100, (c.high - c.low) / (200 * NORMAL_95)) for n, c in changes.items() if c.is_known}
    return in_words(matches(known, patterns(aircraft, lift)))


def changed(changes: Mapping[str, Change]) -> dict[str, Change]:
    """Those of a point that stand out of all that are looked at in it: of points at which nothing has changed, one in
    twenty has any (Sidak 1967)."""
    known = {n: changes[n] for n in NAMES if n in changes and changes[n].is_known}
    level = float(norm.isf(0.5 * (1 - 0.95 ** (1 / max(len(known), 1))))) / NORMAL_95
    return {n: c for n, c in known.items() if 2 * abs(c.estimate) > level * (c.high - c.low)}


def significant(changes: Mapping[str, Change]) -> Iterable[str]:
    """What has changed at a point, in words, with 95 %."""
    for name, c in changed(changes).items():
        yield f"{name} {c.estimate:+.0f} % ({c.low:.0f} to {c.high:.0f})"
