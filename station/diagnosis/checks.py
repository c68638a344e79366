"""What a recording shows before any fit: mistaken signs and units, values left out, repeated values and lost rows.

The rules are those of identify (station.identification): what it refuses is named here and taken back, what it leaves
out is left out here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import SIGNALS
from station.diagnosis.diagnosis_result import Effect
from station.diagnosis.effects import BY_ID, signal_effect
from station.diagnosis.measured_record import Record, manoeuvres
from station.diagnosis.term import Term
from station.estimation.flight_record import accepted
from station.identification.cleaning import cleaned
from station.identification.preparation import corrected
from station.identification.remarks import about_columns
from station.identification.signs_and_units import Mistake, mistakes
from station.log import Table
from station.profile import Aircraft, unlike_recorded

Array = NDArray[np.float64]
Place = tuple[float, float, float]

MOST_MISTAKES: Final = 3
"""Mistakes of one recording that are looked for in turn."""
LOST: Final = 0.01
"""Share of rows without a signal that is needed, from which that is named."""


@dataclass(frozen=True, slots=True)
class Checked:
    """A recording's table as identify cleans it, with mistaken signs and units taken back; what was seen and done."""

    name: str
    table: Table
    seen: tuple[Effect, ...]
    remarks: tuple[str, ...]
    noise: Mapping[str, float] | None
    imu_position: Place

    def columns(self) -> dict[str, Array]:
        """Signals, SI, without values that are impossible, or marked as missing, suspect or held."""
        marks = self.table.quality
        signals = {n: accepted(n, c, marks.get(n)) for n, c in self.table.columns.items() if n in SIGNALS}
        return {**self.table.extra, **signals}

    def records(self, aircraft: Aircraft, spans: Sequence[tuple[float, float]] = ()) -> list[Record]:
        """Its manoeuvres, those of `manoeuvres`. Raises UsageError where there is none."""
        found = manoeuvres(self.name, self.table.t_s, self.columns(), aircraft, spans)
        place, noise, seen = self.imu_position, self.noise or {}, self.seen
        return [replace(r, imu=place, stated=noise, seen=seen, remarks=(*self.remarks, *r.remarks)) for r in found]


def checked(
    name: str,
    table: Table,
    aircraft: Aircraft,
    noise: Mapping[str, float] | None = None,
    imu_position: Place = (0.0, 0.0, 0.0),
) -> Checked:
    """A recording's table made ready. `noise` (SI) and `imu_position` (m, body) are the rig's."""
    unlike = unlike_recorded(aircraft, table.aircraft, mass_recorded="mass" in table.columns)
    table, remarks = cleaned(table)
    remarks = [*unlike, *remarks]
    seen: list[Effect] = []
    for _ in range(MOST_MISTAKES):
        # What the profile says of its instruments is no mistake.
        known = corrected(table, aircraft, noise, imu_position)
        found = mistakes(known.t_s, known.columns, aircraft)
        if not found:
            break
        seen += _named(found)
        remarks.append(f"{' or '.join(m.sentence for m in found)}: taken back before anything is compared")
        back = {n: table.columns[n] / found[0].factor for n in found[0].signals}
        table = replace(table, columns={**table.columns, **back})
    remarks += about_columns(table)
    return Checked(name, table, tuple(seen), tuple(f"{name}: {r}" for r in remarks), noise, imu_position)


def _named(found: Sequence[Mistake]) -> list[Effect]:
    """The first mistake by signal, with the others that it may be instead."""

    def terms(mistake: Mistake) -> list[Term]:
        kind = "sign" if mistake.factor == -1 else "unit"
        return [signal_effect(name, kind, f"{mistake.sentence}.") for name in mistake.signals]

    own = terms(found[0])
    others = dict.fromkeys(t.id for m in found[1:] for t in terms(m))
    alternatives = tuple(i for i in others if i not in [t.id for t in own])
    signature = "without it the signals agree with each other"
    return [Effect(t, found[0].factor, alternatives=alternatives, signature=signature) for t in own]


def repeated_and_lost(held: Mapping[str, Sequence[float]], lost: float) -> list[Effect]:
    """Signals that repeat their values, by the time (s) in each record before one is new; rows that lack a signal, as
    the largest share of any record."""
    seen = []
    for name, spans in held.items():
        if spans:
            term = signal_effect("velocity" if name == "v_down" else name, "stale")
            seen.append(Effect(term, float(np.median(spans)), signature=f"{name} repeats its values"))
    if lost > LOST:
        seen.append(Effect(BY_ID["stream.dropout"], lost, signature="rows missing"))
    return seen


def first_seen(records: Sequence[Record]) -> tuple[Effect, ...]:
    """What all the records show before any fit, each effect once."""
    held = [float(np.median(np.diff(r.held["v_down"]))) * r.dt for r in records if "v_down" in r.held]
    return merged([s for r in records for s in r.seen], {"v_down": held}, max(r.lost for r in records))


def merged(mistaken: Sequence[Effect], held: Mapping[str, Sequence[float]], lost: float) -> tuple[Effect, ...]:
    """Mistakes of several recordings, each once, and what repeats and is lost."""
    return (*{s.term.id: s for s in reversed(mistaken)}.values(), *repeated_and_lost(held, lost))
