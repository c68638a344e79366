"""What the instruments of a record say of each other: the table that every analysis begins with.

Lag, scale and zero of each signal against the others, without any aerodynamics (station/model/instrument_lags.py), over
up to SEGMENTS minutes of the record, those in which it pitched most, or pitched, and rolled and yawed. SI, rad.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.table import Table as Grid

from station.estimation.flight_record import FlightRecord
from station.estimation.results import LATERAL_SURFACES, moves_laterally
from station.identification.by_input import is_flown
from station.identification.preparation import corrected, flight_record
from station.log import Table
from station.model.instrument_lags import Value, solve
from station.model.kinematic_equations import AGAINST, ANGLES, FLOW, GROUND
from station.model.kinematic_likelihood import LAGS_S, LEVEL, REFERENCE, ROLL, SEGMENT_S, ZEROS
from station.numerics.regression import NotIdentifiable
from station.numerics.second_order import vane_lag
from station.profile import Aircraft

Array = NDArray[np.float64]

SEGMENTS: Final = 8
MOSTLY: Final = 0.5
"""A signal present in a smaller share of the rows is left out."""
MARGIN_S: Final = 2 * LAGS_S + 0.1
CI95: Final = 1.96
KINDS: Final = ("lag", "scale", "zero")
JSON_NAMES: Final = (("lag", "lag_s", "ci95"), ("scale", "scale", "scale_ci95"), ("zero", "zero", "zero_ci95"))
LONGITUDINAL: Final = ("theta", "q", "az", "ax", "alpha_vane", "airspeed", *GROUND, "altitude")
ORDER: Final = (*LONGITUDINAL, "phi", "p", "psi", "r", "ay", "beta_vane")
UNITS: Final = {
    **dict.fromkeys(("p", "q", "r"), ("deg/s", 180 / np.pi)),
    **dict.fromkeys(FLOW, ("deg", 180 / np.pi)),
    **dict.fromkeys(("ax", "ay", "az"), ("m/s2", 1.0)),
}
"""Of a zero, as shown, and the factor from SI."""
REFERENCE_WHY: Final = "the reference"
GUSTED: Final = "moves with the gusts: no aileron or rudder was flown"
NO_SCALE: Final = {
    **dict.fromkeys(ANGLES, "an angle of the attitude reference"),
    "airspeed": "the scale of all speeds",
    "altitude": "not looked for",
}


@dataclass(frozen=True, slots=True)
class Instrument:
    """A signal against the others; a part that cannot be told says why."""

    signal: str
    against: tuple[str, ...]
    lag: Value
    scale: Value
    zero: Value
    stated: dict[str, float]
    """What the profile says of it, by kind."""

    def of(self, kind: str) -> Value:
        made: Value = getattr(self, kind)
        return made


@dataclass(frozen=True, slots=True)
class InstrumentTable:
    """Every instrument that the record has, and the gusts that the vane shows beside the motion."""

    rows: tuple[Instrument, ...]
    gust_sd: float
    """Of the vertical gust from 0.1 to 2 Hz, m/s; NaN without a vane."""
    seconds: float
    """Of the record that it rests on."""
    high_hz: float


def instrument_table(record: FlightRecord) -> InstrumentTable | str:
    """Of a record; or the reason why nothing can be told."""
    present = [n for n in ORDER if record.has(n) and np.isfinite(record.motion[n]).mean() > MOSTLY]
    if "theta" not in present:
        return "no attitude to hold the instruments against"
    good = np.all([np.isfinite(record.motion[n]) for n in present], axis=0)
    if "airspeed" in present:
        good &= record.motion["airspeed"] > 1.0
    lateral = [record.motion[n] for n in ("p", "r") if n in present and moves_laterally(record)]
    spans = _spans(good, [[record.motion["q"]], lateral] if lateral else [[record.motion["q"]]], record.dt)
    motion = {n: np.where(good, record.motion[n], 0.0) for n in present}
    boom = record.aircraft.boom
    arm = (boom.vane_x, boom.vane_y, boom.vane_z) if boom else (0.0, 0.0, 0.0)
    moving = {n: x for n, x in motion.items() if n in ANGLES or np.ptp(x[good]) > 0}
    # Where nothing is flown, yaw answers the gusts that the vane shows, which looks like a lag and a scale of its own.
    is_recorded = all(record.has(n) for n in LATERAL_SURFACES)
    gusted = is_recorded and "beta_vane" in moving and not is_flown(record, LATERAL_SURFACES, "beta_vane")
    try:
        found = solve(moving, record.dt, arm, spans, 1 / boom.steady_calibration if boom else 1.0)
    except NotIdentifiable as why:
        return str(why)
    except np.linalg.LinAlgError:
        return "the record does not determine it: nothing moves"
    stated: dict[str, dict[str, float]] = {}
    if boom is not None:
        late = {"lag": vane_lag(boom.vane_frequency, boom.vane_damping)}
        stated = {"alpha_vane": {"zero": boom.zero, "scale": 1 / boom.steady_calibration, **late}, "beta_vane": late}
    rows = []
    for n in (n for n in present if n in (REFERENCE, ROLL) or np.ptp(motion[n][good]) > 0):
        parts = {kind: found.values.get((n, kind), Value(np.nan, np.nan, _why(n, kind))) for kind in KINDS}
        if gusted and n == "beta_vane":
            parts |= dict.fromkeys(("lag", "scale"), Value(np.nan, np.nan, GUSTED))
        against = () if parts["lag"].why == REFERENCE_WHY else tuple(a for a in AGAINST[n] if a in moving)[:2]
        rows.append(Instrument(n, against, **parts, stated=stated.get(n, {})))
    return InstrumentTable(tuple(rows), found.gust_sd, found.seconds, found.high_hz)


def of_recording(
    table: Table, aircraft: Aircraft, place: tuple[float, float, float], noise: Mapping[str, float] | None
) -> InstrumentTable | str:
    """Of a whole recording that is cleaned already; `place` (m, body) and `noise` (SI) are the rig's."""
    try:
        record, _ = flight_record(corrected(table, aircraft, noise, place), aircraft, place, noise)
    except NotIdentifiable as why:
        return str(why)
    return instrument_table(record)


def _why(signal: str, kind: str) -> str:
    if kind == "lag" and signal in (REFERENCE, ROLL):
        return REFERENCE_WHY
    if kind == "scale" and signal in LEVEL:
        return NO_SCALE[signal]
    if kind == "zero" and signal in ANGLES:
        return REFERENCE_WHY
    return "not in any row of the record" if signal in ZEROS else "needs wind and path known"


def _spans(good: NDArray[np.bool_], motions: Sequence[Sequence[Array]], dt: float) -> list[slice]:
    """Stretches without gaps; of a longer record the SEGMENTS pieces of SEGMENT_S in which it moved most, as many by
    each of the `motions`: rates (n,), whose variances are added."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(np.int8))).reshape(-1, 2)
    spans = [slice(int(a), int(b)) for a, b in edges]
    longest = max((s.stop - s.start for s in spans), default=0)
    if longest * dt <= SEGMENTS * SEGMENT_S:
        whole = [s for s in spans if (s.stop - s.start) * dt > SEGMENT_S + MARGIN_S or s.stop - s.start == longest]
        spans = whole
    piece = round((SEGMENT_S + MARGIN_S) / dt)
    if sum(s.stop - s.start for s in spans) * dt <= SEGMENTS * SEGMENT_S:
        return spans
    pieces = [slice(a, a + piece) for s in spans for a in range(s.start, s.stop - piece + 1, piece)]
    ranked = [sorted(pieces, key=lambda s: -sum(float(np.var(x[s])) for x in motion)) for motion in motions]
    best = list(dict.fromkeys((s.start, s.stop) for of_each in zip(*ranked, strict=True) for s in of_each))
    return [slice(*span) for span in sorted(best[:SEGMENTS])]


def as_json(table: InstrumentTable | str) -> dict[str, Any]:
    """`lags`, one object a signal, None where it cannot be told and `why`; `gust_sd_01_2hz_mps`."""
    if isinstance(table, str):
        return {"lags": [], "lags_why": table}
    return {"lags": [_row_json(row) for row in table.rows], "gust_sd_01_2hz_mps": _finite(table.gust_sd)}


def _row_json(row: Instrument) -> dict[str, Any]:
    made: dict[str, Any] = {"signal": row.signal, "against": ", ".join(row.against)}
    for kind, name, interval in JSON_NAMES:
        v = row.of(kind)
        told = not v.why
        made[name] = v.value if told else None
        made[f"{kind}_sd"] = v.sd if told else None
        made[interval] = [v.value - CI95 * v.sd, v.value + CI95 * v.sd] if told else None
        made[f"{kind}_status"] = "estimated" if told else "reference" if v.why == REFERENCE_WHY else "unestimated"
        if v.why:
            made[f"{kind}_why"] = v.why
    if row.stated:
        made["profile"] = row.stated
    return made


def _finite(x: float) -> float | None:
    return x if np.isfinite(x) else None


def cell(row: Instrument, kind: str) -> str:
    """As shown: a lag in ms, a zero in its instrument's unit, with two standard errors."""
    v = row.of(kind)
    if v.why:
        return "0" if v.why == REFERENCE_WHY and kind == "lag" else "-"
    unit, factor = UNITS.get(row.signal, ("", 1.0)) if kind == "zero" else ("ms", 1e3) if kind == "lag" else ("", 1.0)
    value, twice = v.value * factor, CI95 * v.sd * factor
    decimals = max(0, min(6, 1 - int(np.floor(np.log10(max(twice, 1e-9))))))
    return f"{value:.{decimals}f} ± {twice:.{decimals}f} {unit}".rstrip()


def print_table(table: InstrumentTable | str | None, console: Console, of: str = "") -> None:
    """In the terminal, where it was asked for; `of` names the recording where there are several."""
    if table is None:
        return
    if isinstance(table, str):
        console.print(f"Instruments against each other: {table}", highlight=False, markup=False)
        return
    console.print(heading(table) + (f": {of}" if of else ""), highlight=False, markup=False)
    grid = Grid("instrument", "against", "lag", "scale", "zero", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for row in table.rows:
        grid.add_row(row.signal, ", ".join(row.against) or "reference", *(cell(row, kind) for kind in KINDS))
    console.print(grid)


def heading(table: InstrumentTable) -> str:
    """What the table is, in one line."""
    return (
        f"Instruments against each other, without aerodynamics, over {table.seconds:.0f} s to {table.high_hz:g} Hz: "
        "95 % intervals; lag against the attitude; - cannot be told"
    )
