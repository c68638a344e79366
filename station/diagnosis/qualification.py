"""The aircraft simulated from measured inputs, before and after its extension, against a simulator's qualification.

Tolerances: 14 CFR part 60, appendix A, table A2A (full flight simulators). Open loop a simulation drifts by whatever
its trim is wrong by; as in the validation of simulators, initial state and trim (CL_0, Cm_0, CD_0) are fitted to each
manoeuvre, before and after alike, and nothing else is. Differences count up to the frequency up to which the vane tells
the gust (vane_gust.GUST_PASS_HZ): what lies beyond shakes the aircraft, not its simulation. Until wing and tail fly in
air that the vane met in the record (measured_inputs.settled_s), no input says what drove the aircraft: so long it is
led as it was flown, and not judged.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import G0, to_si
from station.diagnosis.measured_record import Record
from station.diagnosis.oscillation import LEAST_SHOWN, apart, oscillation
from station.diagnosis.vane_gust import as_the_gust, inputs_of, without_errors
from station.numerics.secant_fit import secant_fit
from station.profile import Aircraft
from station.rows import ProfileError
from station.simulation.measured_inputs import MeasuredFlight, Start, settled_s
from station.simulation.motion import DT

Array = NDArray[np.float64]

COMPARED: Final = ("theta", "q", "az", "alpha_vane", "airspeed")
PITCH: Final = to_si(1.5, "deg")
PITCH_RATE: Final = to_si(2.0, "deg/s")
ACCELERATION: Final = 0.10 * G0
"""Of the short period: either of the first two, and the third."""
_SCALES: Final = {"theta": PITCH, "q": PITCH_RATE, "az": ACCELERATION, "alpha_vane": PITCH, "airspeed": to_si(3, "kt")}
"""By which differences are made comparable where trim and initial state are fitted; the airspeed's is that of trims and
change dynamics in the same table."""
_SPREADS: Final = {
    "speed": 3.0, "alpha": to_si(3, "deg"), "theta": to_si(2, "deg"), "q": to_si(2, "deg/s"),
    "cl_0": 0.3, "cm_0": 0.1, "cd_0": 0.05,
}  # fmt: skip
"""Prior standard deviations of what is fitted, SI: they decide only what a manoeuvre does not show."""
_BEGIN_S: Final = 0.2
"""Of a record, from where it is judged on, whose mean is where the fit begins."""
_ALONE: Final = to_si(0.5, "deg")
"""Elevator's range while the aircraft is left to its phugoid."""
LEAST_PERIODS: Final = 0.8
"""Of it, for its period and damping to be told."""
_LOST: Final = 1e3
"""In place of a difference that is no number: a simulation that has departed."""
_EVERY_S: Final = 0.1
"""Between the instants that are fitted."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One line: a manoeuvre against an entry of the table. Worst differences as shares of the tolerance."""

    name: str
    """Of the table."""
    tolerance: str
    before: float
    after: float
    outside_s: float | None
    """When the aircraft as extended is first outside, s of the manoeuvre; None where it stays inside."""

    @property
    def inside(self) -> bool:
        return self.after <= 1.0


@dataclass(frozen=True, slots=True)
class Flown:
    """A manoeuvre, measured and simulated; (n,) each, SI. `why` it could not be simulated."""

    record: str
    t_s: Array
    measured: Mapping[str, Array]
    before: Mapping[str, Array]
    after: Mapping[str, Array]
    entries: tuple[Entry, ...]
    judged_from_s: float = 0.0
    why: str = ""


def qualified(records: Sequence[Record], before: Aircraft, after: Aircraft) -> list[Flown]:
    """Every manoeuvre flown by both aircraft, side by side."""
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(lambda r: _flown(r, before, after), records))


def flown_beside(record: Record, aircraft: Aircraft) -> Flown:
    """One manoeuvre beside one aircraft, and what the short period's tolerances say. Raises ProfileError for one
    that cannot be flown."""
    t, measured = _measured(record)
    begin = _judged_from(record, aircraft)
    shown, _ = simulated(record, _loaded(aircraft, record, *_loading(record, aircraft)), begin)
    return Flown(record.name, t, measured, shown, shown, (_short_period(t, measured, shown, shown, begin),), begin)


def _judged_from(record: Record, *aircraft: Aircraft) -> float:
    """From which of its instants on a record is judged, s."""
    speed = float(record.signals["airspeed"].mean())
    return record.dt * math.ceil(max(settled_s(a, speed) for a in aircraft) / record.dt)


def _measured(record: Record) -> tuple[Array, Mapping[str, Array]]:
    return np.asarray(record.dt * np.arange(record.n)), {name: record.signals[name] for name in COMPARED}


def _loading(record: Record, aircraft: Aircraft) -> tuple[float, float]:
    """Mass and pitch inertia of the record, as shares of the profile's."""
    own = aircraft.inertia
    return (record.mass or own.mass) / own.mass, (record.iyy or own.iyy or 1.0) / (own.iyy or 1.0)


def _flown(record: Record, before: Aircraft, after: Aircraft) -> Flown:
    t, measured = _measured(record)
    mass, iyy = _loading(record, before)
    begin = _judged_from(record, before, after)
    try:
        other, slopes = simulated(record, _loaded(after, record, mass, iyy), begin)  # whose trim is near
        one, _ = simulated(record, _loaded(before, record, mass, iyy), begin, slopes)
    except ProfileError as error:
        return Flown(record.name, t, measured, {}, {}, (), begin, str(error).splitlines()[0])
    elevator, speed = record.signals["elevator"], float(record.signals["airspeed"].mean())
    entries = [_short_period(t, measured, one, other, begin), *_phugoid(t, elevator, speed, (measured, one, other))]
    return Flown(record.name, t, measured, one, other, tuple(entries), begin)


def _loaded(aircraft: Aircraft, record: Record, mass: float, iyy: float) -> Aircraft:
    """In the record's air, with its loading, and without an averaging of gusts that the simulation's step is too long
    for."""
    own, lag = aircraft.inertia, aircraft.unsteady
    inertia = own.model_copy(update={"mass": own.mass * mass, "iyy": (own.iyy or 1.0) * iyy})
    if lag.gust_span < DT * float(record.signals["airspeed"].mean()):
        lag = lag.model_copy(update={"gust_span": 0.0})
    return aircraft.model_copy(update={"air_density": record.density, "inertia": inertia, "unsteady": lag})


def simulated(
    record: Record, aircraft: Aircraft, begin_s: float, slopes: Array | None = None
) -> tuple[Mapping[str, Array], Array]:
    """COMPARED as the aircraft's instruments would have shown them, trim and initial state fitted to what is shown from
    `begin_s` on, and what moving these does to the differences; `slopes`: the same of an aircraft like it. Raises
    ProfileError for one that cannot be flown."""
    x = without_errors(record, aircraft)
    inputs = inputs_of(x, record.dt, aircraft)
    flight = MeasuredFlight(aircraft, inputs, record.height, record.imu, begin_s)
    at = round(begin_s / record.dt)
    first = inputs.motion[at : at + max(2, round(_BEGIN_S / record.dt))].mean(axis=0)
    begin = dict(zip(_SPREADS, [*first.tolist(), 0.0, 0.0, 0.0], strict=True))
    judged = slice(at, None, max(1, round(_EVERY_S / record.dt)))

    def fly(moved: Array) -> dict[str, Array]:
        made = {n: begin[n] + s * float(m) for (n, s), m in zip(_SPREADS.items(), moved, strict=True)}
        shown = flight.fly(Start(**made))
        return {name: shown[name] for name in COMPARED}

    def differences(moved: Array) -> Array:
        shown = fly(moved)
        parts = [(shown[n] - record.signals[n])[judged] / s for n, s in _SCALES.items()]
        return np.nan_to_num(np.concatenate(parts), nan=_LOST, posinf=_LOST, neginf=-_LOST)

    moved, slopes = secant_fit(differences, len(_SPREADS), slopes)
    return fly(moved), slopes


def _short_period(
    t: Array, measured: Mapping[str, Array], before: Mapping[str, Array], after: Mapping[str, Array], begin_s: float
) -> Entry:
    """Entry 2.c.10: pitch or pitch rate, of which the less restrictive counts, and normal acceleration; each as far up
    as the gust is known, from `begin_s` on."""
    dt = float(t[1] - t[0])

    def worst(flown: Mapping[str, Array]) -> Array:
        off = {n: np.abs(as_the_gust((flown[n] - measured[n])[judged], dt)) for n in ("theta", "q", "az")}
        either = np.minimum(off["theta"] / PITCH, off["q"] / PITCH_RATE)
        return np.asarray(np.maximum(either, off["az"] / ACCELERATION))

    judged = t > begin_s - 0.5 * dt
    one, other = worst(before), worst(after)
    beyond = np.flatnonzero(~(other <= 1.0))
    return Entry(
        "short period dynamics",
        "1.5 deg pitch or 2 deg/s pitch rate, and 0.10 g",
        float(one.max()),
        float(other.max()),
        float(t[judged][beyond[0]]) if len(beyond) else None,
    )


def _phugoid(t: Array, elevator: Array, speed: float, flown: Sequence[Mapping[str, Array]]) -> list[Entry]:
    """Entry 2.c.9, of the pitch angle, `flown` as measured, before and after; none where the elevator is not left alone
    for most of a period at the record's end, or what follows is no phugoid."""
    period = math.pi * math.sqrt(2) * speed / G0  # Lanchester
    moved = np.flatnonzero(np.abs(elevator - elevator[-1]) > _ALONE)
    begin = int(moved[-1]) + 1 if len(moved) else 0
    if t[-1] - t[begin - 1 if begin == len(t) else begin] < LEAST_PERIODS * period:
        return []
    found = [oscillation(t[begin:], x["theta"][begin:], period) for x in flown]
    if found[0].share < LEAST_SHOWN:
        return []
    before, after = (apart(o, found[0]) for o in found[1:])
    words = "10 % of period; 10 % of time to half or double amplitude or 0.02 damping ratio"
    return [Entry("phugoid dynamics", words, before, after, float(t[begin]) if after > 1 else None)]


def qualification_json(flown: Sequence[Flown]) -> dict[str, Any]:
    """Of station.diagnose/1."""
    return {
        "source": "14 CFR part 60, appendix A, table A2A",
        "fitted": ["initial state", "CL_0", "Cm_0", "CD_0"],
        "manoeuvres": [
            {
                "record": f.record,
                "why": f.why,
                "judged_from_s": f.judged_from_s,
                "entries": [
                    {
                        "entry": e.name,
                        "tolerance": e.tolerance,
                        "worst_before": _finite(e.before),
                        "worst_after": _finite(e.after),
                        "inside": e.inside,
                        "first_outside_s": e.outside_s,
                    }
                    for e in f.entries
                ],
                "rms": {
                    n: {
                        "before": _finite(np.sqrt(np.mean((f.before[n] - f.measured[n]) ** 2))),
                        "after": _finite(np.sqrt(np.mean((f.after[n] - f.measured[n]) ** 2))),
                    }
                    for n in f.before
                },
            }
            for f in flown
        ],
    }


def _finite(x: float) -> float | None:
    """None of a simulation that departs."""
    return float(x) if math.isfinite(x) else None


def qualification_lines(flown: Sequence[Flown]) -> list[str]:
    """One line a manoeuvre; worst differences in tolerances."""
    lines = []
    for f in flown:
        if f.why:
            lines.append(f"{f.record}: not simulated: {f.why}")
        for e in f.entries:
            begun = "" if e.outside_s is None else f" from {e.outside_s:.1f} s"
            end = "inside" if e.inside else f"outside{begun}"
            one, other = (f"{x:.2f}" if math.isfinite(x) else "departs" for x in (e.before, e.after))
            lines.append(f"{f.record}: {e.name}: worst {one} -> {other} of the tolerance: {end}")
    return ["simulated from measured inputs, 14 CFR 60 table A2A:", *(f"  {line}" for line in lines)]
