"""A recording made ready for identification: cleaned, its stated instrument errors undone, its interval cut out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.estimation.bending import Bending
from station.estimation.flight_record import FlightRecord
from station.estimation.instrument_errors import Corrector, known
from station.identification.cleaning import cleaned
from station.identification.request import DEFAULT_CARD, Request
from station.identification.signs_and_units import mistakes
from station.identification.vanes_compared import in_reserve
from station.log import Table
from station.numerics.regression import NotIdentifiable
from station.profile import Aircraft, unlike_recorded
from station.rows import Quality, UsageError

Array = NDArray[np.float64]

SHORTEST_STEP_S: Final = 1e-4
LEAST_ROWS: Final = 2
SUPPORTED: Final = 0.2
"""Share of a record's rate up to which its lines are used: what lies above half the rate is folded to four fifths of it
and more, where motion and gusts are a sixteenth."""
LINKS_START_S: Final = 2.0
"""Within which the links of a rig come up."""
NEEDED: Final = ("alpha_vane", "airspeed", "q", "ax", "az", "theta", "v_down", "elevator")


@dataclass(frozen=True, slots=True)
class Prepared:
    """A recording ready for identification; `request` with its interval as seconds of the table's time axis."""

    request: Request
    recorded: Table
    """All of the recording, cleaned, as its instruments showed it."""
    whole: Table
    """The same, corrected."""
    cut: Table
    """The interval of it."""
    record: FlightRecord
    refusal: str
    """Why no derivative can come of it; "" if one may."""
    mistaken: str
    """The sign or unit that contradicts the other signals; "" if none."""
    remarks: tuple[str, ...]
    """What was excluded."""

    @property
    def start_s(self) -> float:
        start = self.request.start_s
        return float(self.whole.t_s[0]) if start is None else start

    def record_of_whole(self) -> FlightRecord:
        """All of the recording, of which `record` is a part. Raises NotIdentifiable."""
        if len(self.whole.t_s) <= len(self.record.t_s):
            return self.record
        return flight_record(self.whole, self.record.aircraft, self.request.imu_position, self.request.noise)[0]


def prepare(table: Table, aircraft: Aircraft, request: Request) -> Prepared:
    """Clean, correct and cut `table`. Raises UsageError for an empty interval, or a record that no method can use."""
    whole, remarks = cleaned(table)
    whole, said = in_reserve(whole, request.vanes, aircraft)
    remarks = [*unlike_recorded(aircraft, table.aircraft, mass_recorded="mass" in table.columns), *remarks, *said]
    whole, aircraft = less_fuel(whole, aircraft)
    recorded = whole
    whole = corrected(whole, aircraft, request.noise, request.imu_position)
    if not len(table.t_s):
        raise UsageError(f"{request.subject}: no data from {request.start_s} to {request.end_s} s")
    if not len(whole.t_s):
        raise UsageError(f"{request.subject}: shorter than the delays of the profile's instruments")
    first, last = float(whole.t_s[0]), float(whole.t_s[-1])
    start = begin(whole) if request.start_s is None else request.start_s
    if request.start_s is None and start > first + LINKS_START_S:
        remarks = [*remarks, f"the first {start - first:.0f} s hold no frames: identified from {start:.1f} s on"]
    end = last if request.end_s is None else request.end_s
    cut = whole.between(start, end)
    if not start < end or len(cut.t_s) < LEAST_ROWS:
        raise UsageError(
            f"{request.subject}: no data from {start:g} to {end:g} s: the recording has {first:g} to {last:g} s"
        )
    mistaken = " or ".join(m.sentence for m in mistakes(cut.t_s, cut.columns, aircraft))
    try:
        record, refusal = flight_record(cut, aircraft, request.imu_position, request.noise)
    except NotIdentifiable as why:
        raise UsageError(f"{request.subject}: {why}" + (f"\n{mistaken}" if mistaken else "")) from why
    card = request.card if request.card is not None else DEFAULT_CARD
    high = SUPPORTED / record.dt
    if high < card.high and card.low + card.step < high:
        card = card.model_copy(update={"high": high})
        remarks = [*remarks, f"recorded at {1 / record.dt:.3g} Hz: lines from {card.low:g} to {high:.2g} Hz are used"]
    asked = replace(request, start_s=start, end_s=end, card=card)
    return Prepared(asked, recorded, whole, cut, record, refusal, mistaken, tuple(remarks))


def begin(table: Table) -> float:
    """When a recording has every signal that estimates need, s of its time axis: links come up one after the other, and
    before the station's frames are prepared there are none. A signal that comes later still is not waited for."""
    there = [np.isfinite(column) for name, column in table.columns.items() if name in NEEDED]
    some, all_of_them = np.any(there, axis=0), np.all(there, axis=0)
    if not some.any():
        return float(table.t_s[0])
    opened, complete = float(table.t_s[np.argmax(some)]), float(table.t_s[np.argmax(all_of_them)])
    return complete if all_of_them.any() and complete <= opened + LINKS_START_S else opened


def flight_record(
    cut: Table,
    aircraft: Aircraft,
    imu_position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    noise: Mapping[str, float] | None = None,
) -> tuple[FlightRecord, str]:
    """The record of a table, and why no derivative can come of it ("" if one may): a record without elevator or an
    aircraft without aerodynamic data still has kinematics. Raises NotIdentifiable."""
    refusal = ""
    columns = cut.columns
    if aircraft.kinematics_only:
        refusal = f"the profile of {aircraft.name} has no aerodynamic data: no derivatives, kinematics only"
    if "elevator" not in columns or not np.isfinite(columns["elevator"]).any():
        refusal = refusal or "the record has no elevator"
        columns = {**columns, "elevator": np.zeros(len(cut.t_s))}
    given = [n for n in cut.quality if n in cut.columns and (n != "elevator" or not refusal)]
    record = FlightRecord.of(
        cut.t_s,
        columns,
        aircraft,
        quality={n: cut.quality[n] for n in given},
        ages={n: cut.age_s(n) for n in given},
        extra=cut.extra,
        imu_position=imu_position,
        noise=noise,
    )
    return record, refusal


def less_fuel(table: Table, aircraft: Aircraft) -> tuple[Table, Aircraft]:
    """The table with the mass that the recorded fuel flow leaves of the profile's, which is that at its beginning, and
    the aircraft whose recorded mass is known no better than that; both as they are where there is no such flow, or the
    mass itself is recorded."""
    flow, recorded = (table.columns.get(n, np.empty(0)) for n in ("fuel_flow", "mass"))
    known = np.isfinite(flow)
    if known.sum() < LEAST_ROWS or np.isfinite(recorded).any():
        return table, aircraft
    every = np.interp(table.t_s, table.t_s[known], flow[known])
    burnt = np.concatenate(([0.0], np.cumsum(0.5 * (every[1:] + every[:-1]) * np.diff(table.t_s))))
    columns = {**table.columns, "mass": aircraft.inertia.mass - burnt}
    doubt = aircraft.uncertainty.model_copy(update={"recorded_mass": aircraft.uncertainty.mass})
    return replace(table, columns=columns), aircraft.model_copy(update={"uncertainty": doubt})


def corrected(
    table: Table,
    aircraft: Aircraft,
    noise: Mapping[str, float] | None,
    imu_position: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Table:
    """The table with the instrument errors undone that the profile states, as in flight: without the end, for which
    late signals have not come, and the beginning, which early ones lack; and the boom's bending removed."""
    if len(table.t_s) < LEAST_ROWS:
        return table
    dt = max(float(np.median(np.diff(table.t_s))), SHORTEST_STEP_S)
    made = _undone(table, aircraft, noise, dt) if known(aircraft).errors else table
    if not aircraft.bends or "alpha_vane" not in made.columns or not len(made.t_s):
        return made
    vane = Bending(aircraft, imu_position, dt).sweep(made.columns)
    lost = np.isnan(vane)
    marks = made.quality.get("alpha_vane", np.zeros(len(vane), dtype=np.uint8))
    quality = {**made.quality, "alpha_vane": np.where(lost, np.uint8(Quality.MISSING), marks)}
    return replace(made, columns={**made.columns, "alpha_vane": vane}, quality=quality)


def _undone(table: Table, aircraft: Aircraft, noise: Mapping[str, float] | None, dt: float) -> Table:
    undoing = Corrector(aircraft, noise or {}, dt, len(table.t_s))
    nothing = np.full(len(table.t_s), np.nan)
    values = [table.columns.get(name, nothing) for name in undoing.names]
    given = [table.age_s(name) if name in table.columns else nothing for name in undoing.names]
    found, ages, marks = undoing.sweep(table.t_s, np.column_stack(values), np.column_stack(given))
    columns, quality, age = dict(table.columns), dict(table.quality), dict(table.ages)
    for j, name in enumerate(undoing.names):
        if name in table.columns:
            columns[name], age[name], quality[name] = found[:, j], ages[:, j], marks[:, j]
    made = replace(table, columns=columns, quality=quality, ages=age)
    last = max(len(table.t_s) - 1 - undoing.ahead, 0)
    return made.between(float(table.t_s[0]) + undoing.early_s, float(table.t_s[last]))
