"""Derived signals in flight: expressions over the other values of a frame, worked out at each tick.

Pure: the same frame gives the same bits. One that has no value now, as it divides by zero, is missing; the first time
is told, and all else goes on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from station.profile import Further, why_none
from station.profile.expression import Work
from station.rows import Code, Event, Quality


@dataclass(frozen=True, slots=True)
class _Made:
    name: str
    work: Work
    factor: float
    offset: float
    inputs: tuple[int, ...]
    """Their columns."""


class DerivedSignals:
    """What a rig derives, appended to the values of a frame."""

    def __init__(self, further: Further) -> None:
        self._made = tuple(
            _Made(
                d.signal.name,
                d.formula.numbers(further.index),
                d.factor,
                d.offset,
                tuple(further.index[n] for n in d.formula.names),
            )
            for d in further.derived
        )
        self._told: set[tuple[str, str]] = set()

    def add(self, t_ns: int, values: list[float], ages: list[float], quality: list[int]) -> list[Event]:
        """Append the derived ones, each as old and as good as the worst of what it is made of; what went wrong for the
        first time."""
        events = []
        for d in self._made:
            value, age, mark = math.nan, math.nan, max(quality[i] for i in d.inputs)
            if not any(math.isnan(values[i]) for i in d.inputs):
                try:
                    value = float(d.work(values)) * d.factor + d.offset
                    why = "" if math.isfinite(value) else "is too large a number"
                except (ArithmeticError, ValueError) as error:
                    why = why_none(error)
                if why:
                    value, mark = math.nan, int(Quality.SUSPECT)
                    if (d.name, why) not in self._told:
                        self._told.add((d.name, why))
                        events.append(Event(t_ns, d.name, Code.RANGE, 1, f"{why}: it is missing meanwhile"))
                else:
                    age = max(ages[i] for i in d.inputs)
            values.append(value)
            ages.append(age)
            quality.append(mark)
        return events
