"""A baseline of test points as an aircraft profile: measured derivatives and drag, and by what another point lies off.

Errors are without those of mass and inertia: they are the profile's, whose [uncertainty] states them, and every later
flight with it shares them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from station.conventions import LONGITUDINAL, from_si
from station.log import Point
from station.model.energy_drag import FEWEST, WINDOW_S
from station.numerics.random_effects import NORMAL_95, Pooled
from station.profile import Aircraft, Derivative, Measured
from station.profile.quantity import SI_NUMBERS
from station.programme.changes import CALM, OWN, baseline_of, lift_of, recommended
from station.programme.flown_points import FlownPoint, is_of_baseline
from station.programme.programme import Flight, twice
from station.rows import UsageError


@dataclass(frozen=True, slots=True)
class MeasuredBaseline:
    """The profile, and what is to be said of it."""

    aircraft: Aircraft
    values: dict[str, Pooled]
    definition: str
    drag: Pooled | None
    points: tuple[FlownPoint, ...]
    remarks: tuple[str, ...]


def baseline_points(flight: Flight) -> tuple[Point, ...]:
    """Of a recording, the points that a baseline is pooled of."""
    marked = tuple(p for p in flight.points if is_of_baseline(p))
    return marked or flight.points


def measured_baseline(flights: Sequence[Flight], points: Sequence[FlownPoint], aircraft: Aircraft) -> MeasuredBaseline:
    """Of the points whose condition says "baseline", of all where none does. Raises UsageError where there is nothing
    to pool, or recordings are of several aircraft."""
    names = sorted({f.table.aircraft.name for f in flights})
    if len(names) > 1:
        raise UsageError(f"recordings of several aircraft, {', '.join(names)}: a baseline is one aircraft's")
    marked = [p for p in points if p.is_baseline]
    used = tuple(p for p in marked or points if recommended(p))
    found = baseline_of(used, aircraft)
    if not used or not found.points:
        raise UsageError("no point gives a derivative: nothing to pool")
    definition = OWN if found.values.get(OWN) else CALM
    values = dict(found.values[definition])
    drag = found.drag
    speeds = [float(np.nanmean(p.found.record.motion["airspeed"])) for p in used if p.found]
    stated = {
        "points": len(used),
        "condition": "; ".join(dict.fromkeys(p.condition for p in used if p.condition)),
        "lowest_speed": min(speeds),
        "highest_speed": max(speeds),
        "CD_0": drag.value if drag else None,
        "CD_0_sd": _of_another(drag) if drag else 0.0,
    }
    source = f"measured: {len(used)} points by {found.method}, random effects (REML), sd of another point"
    derivatives = dict(aircraft.derivatives)
    for name, p in values.items():
        derivatives[name] = Derivative(value=p.value, sd=_of_another(p), source=source)
    # With the slopes that it is held against in later flights.
    lift = lift_of(used, aircraft.model_copy(update={"derivatives": derivatives}))
    stated |= {"CL_0": lift.value if lift else None, "CL_0_sd": _of_another(lift) if lift else 0.0}
    measured = Measured.model_validate(stated, context=SI_NUMBERS)
    made = {"derivatives": derivatives, "measured": measured, "name": f"{aircraft.name}_measured"}
    if drag is not None and aircraft.drag is not None and drag.value > 0:
        made["drag"] = aircraft.drag.model_copy(update={"zero_lift": drag.value})
    return MeasuredBaseline(
        aircraft.model_copy(update=made),
        values,
        definition,
        drag,
        used,
        (*_remarks(used, values, drag, bool(marked)), *of_several_speeds(speeds), *twice(flights)),
    )


def _of_another(p: Pooled) -> float:
    """Standard deviation of another point about the mean, as wide as its 95 % interval says."""
    return p.of_another * p.widening / NORMAL_95


SPEEDS_APART: Final = 0.1
"""Between the speeds of points that are pooled: a tenth is a fifth of lift coefficient and dynamic pressure."""


def of_several_speeds(speeds: Sequence[float]) -> Iterator[str]:
    """m/s."""
    low, high = min(speeds), max(speeds)
    if high > (1 + SPEEDS_APART) * low:
        yield (
            f"pooled of {from_si(low, 'kt'):.0f} to {from_si(high, 'kt'):.0f} kt: what speed and lift change of the "
            "derivatives is in the sd of another point; a baseline of each speed tells smaller changes"
        )


def _remarks(used: Sequence[FlownPoint], values: dict[str, Pooled], drag: Pooled | None, is_marked: bool) -> list[str]:
    made = []
    if not is_marked:
        made.append('no condition says "baseline": pooled of every point that can be used')
    if len(used) == 1:
        made.append("a baseline of one point: by how much points scatter is not known, and not in its sd; fly two more")
    lacking = [n for n in LONGITUDINAL if n not in values]
    if lacking:
        made.append(f"not estimated at any point, left as the profile has them: {', '.join(lacking)}")
    if drag is None:
        known = [p.found.record.why_no_thrust for p in used if p.found is not None]
        why = next(
            (words for words in known if words), f"no point has {FEWEST} stretches of {WINDOW_S:g} s that tell drag"
        )
        made.append(f"{why}: nothing is measured of drag, and nothing will be told of its change")
    conditions = {p.condition for p in used}
    if len(conditions) > 1:
        made.append(f"pooled of different conditions: {'; '.join(sorted(c or 'none stated' for c in conditions))}")
    return made
