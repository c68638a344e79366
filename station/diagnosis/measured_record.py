"""A manoeuvre as diagnosis takes it: a recording's signals on one uniform grid, long gaps refused."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import MIN_SPEED, SEA_LEVEL_DENSITY
from station.diagnosis.diagnosis_result import Effect
from station.estimation.acceptance import banked
from station.numerics.atmosphere import air_density, height_at_density, height_at_pressure
from station.numerics.default_noise import DEFAULT_NOISE
from station.profile import Aircraft
from station.rows import UsageError

Array = NDArray[np.float64]

NEEDED: Final = ("alpha_vane", "q", "theta", "ax", "az", "airspeed", "elevator")
OPTIONAL: Final = ("v_down", "v_north", "v_east", "psi", "phi", "p", "r", "thrust", "altitude")
"""Used where they are there throughout; without velocity the motion is integrated from the accelerometers, and its mean
and slope are those of the altitude."""
SIDEWAYS: Final = ("ay", "beta_vane", "aileron", "rudder")
"""What lateral motion is judged by besides."""
LATERAL_SURFACES: Final = ("aileron", "rudder")
SHORTEST_S: Final = 6.0
PIECE_S: Final = 45.0
LONGEST_S: Final = 75.0
BRIDGED_S: Final = 0.25
HELD_SAMPLES: Final = 3
"""Median samples between changes from which a signal repeats its values."""
LEAST_CHANGES: Final = 4
LEAST_ROWS: Final = 10
SLOWEST_STEP_S: Final = 0.2
_EXCITED: Final = math.radians(0.3)
"""Standard deviation of a surface, below which no input was flown by it: holding attitude takes as much."""
_MAY_MOVE: Final = ("elevator", "alpha_vane", *LATERAL_SURFACES)
_NOISE_TIMES: Final = 3.0
"""Times a sensor's noise (standard deviations), from which what it measures moves: nine tenths of the variance are
motion then."""
PLANE: Final = 0.1
"""Of the airspeed, by which the speed to the north may differ from it, where none to the east is recorded, to be that
along the path, as of flight in one plane: a track 26 deg off is slower."""
_STRAIGHT: Final = math.radians(4.0)


@dataclass(frozen=True, slots=True)
class Record:
    """One manoeuvre: `signals` (n,) each, SI, every `dt` seconds; "v_along" is the ground speed along the mean heading.

    `density` (kg/m3) and `height` (m) are means. `missing` are the optional signals that are not there.
    """

    name: str
    dt: float
    start_s: float
    signals: Mapping[str, Array]
    density: float
    height: float
    missing: tuple[str, ...] = ()
    held: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)
    """Signals that repeat their values, and the samples at which they are fresh."""
    mass: float | None = None
    """kg and kg m2, where the record itself has them (means)."""
    iyy: float | None = None
    lost: float = 0.0
    """Share of rows in which a needed signal was missing and bridged."""
    imu: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where the rig says the imu is, from the CG in body axes, m."""
    stated: Mapping[str, float] = field(default_factory=dict)
    """The noise that the rig states, SI."""
    remarks: tuple[str, ...] = ()
    """What was left out of the recording, and corrected in it."""
    seen: tuple[Effect, ...] = ()
    """Signs and units of the recording that were mistaken, and have been taken back."""
    sideways: Mapping[str, Array] = field(default_factory=dict)
    """Of SIDEWAYS those that are there, psi, and the ground speeds to the right of the mean heading ("v_across") and
    along it ("v_ahead")."""

    @property
    def n(self) -> int:
        return len(self.signals["q"])

    @property
    def seconds(self) -> float:
        return self.n * self.dt


def why_not_flown(aircraft: Aircraft) -> str:
    """What keeps the simulation from flying an aircraft beside its records; "" if nothing does."""
    if aircraft.kinematics_only:
        return "the profile has no aerodynamic data"
    there = {"inertia.iyy": aircraft.inertia.iyy, **{n: aircraft.value(n) for n in ("CL_alpha", "Cm_de")}}
    missing = [name for name, value in there.items() if not value]
    return f"the profile gives no {', '.join(missing)}" if missing else ""


def manoeuvres(
    name: str,
    t_s: Array,
    columns: Mapping[str, Array],
    aircraft: Aircraft,
    spans: Sequence[tuple[float, float]] = (),
) -> list[Record]:
    """A recording cut into manoeuvres: the marked `spans` (s), else pieces of about PIECE_S; and where a signal that is
    needed has a gap.

    Pieces that are too short, or without excitation, are left out. Raises UsageError where none remains, saying why.
    """
    lacking = [s for s in NEEDED if s not in columns or not np.isfinite(columns[s]).any()]
    if lacking:
        raise UsageError(f"{name}: cannot be diagnosed: it has no {', '.join(lacking)}")
    if len(t_s) < LEAST_ROWS:
        raise UsageError(f"{name}: {len(t_s)} rows are too few")
    dt = float(np.median(np.diff(t_s)))
    if dt > SLOWEST_STEP_S * (1 + 1e-6):  # rounded times
        raise UsageError(f"{name}: {1 / dt:.2g} Hz is too slow: 5 Hz are needed")
    first, last = float(t_s[0]), float(t_s[-1])
    if not spans:
        pieces = 1 if last - first <= LONGEST_S else round((last - first) / PIECE_S)
        edges = np.linspace(first, last, pieces + 1)
        spans = list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))
    parts = [part for start, end in spans for part in _between_gaps(t_s, columns, start, end)]
    left_out = sum(end - start for start, end in spans) - sum(end - start for start, end in parts)
    spans = parts
    found, refused = [], ""
    for k, (start, end) in enumerate(spans):
        label = name if len(spans) == 1 else f"{name} #{k + 1}"
        try:
            found.append(_piece(label, t_s, columns, aircraft, start, end, dt))
        except UsageError as refusal:
            refused = str(refusal)
    if not found:
        raise UsageError(refused)
    if left_out > 0:
        found[0] = replace(found[0], remarks=(f"{name}: {left_out:.1f} s left out, with gaps in what is needed",))
    return found


def _between_gaps(t_s: Array, columns: Mapping[str, Array], start: float, end: float) -> list[tuple[float, float]]:
    """The parts of a span, long enough to be judged, in which no signal that is needed is missing for longer than
    BRIDGED_S; the span itself where there is none."""
    inside = (t_s >= start - 1e-9) & (t_s <= end + 1e-9)
    missing_spans: list[tuple[float, float]] = []
    for name in NEEDED:
        t = t_s[inside & np.isfinite(columns[name])]
        apart = np.flatnonzero(np.diff(t) > BRIDGED_S + float(np.median(np.diff(t_s))))
        missing_spans += zip(t[apart].tolist(), t[apart + 1].tolist(), strict=True)
    parts, since = [], start
    for last, first in sorted(missing_spans):
        if last - since >= SHORTEST_S:
            parts.append((since, last))
        since = max(since, first)
    if end - since >= SHORTEST_S:
        parts.append((since, end))
    return parts if missing_spans and parts else [(start, end)]


def _piece(
    name: str, t_s: Array, columns: Mapping[str, Array], aircraft: Aircraft, start: float, end: float, dt: float
) -> Record:
    rows = np.flatnonzero((t_s >= start - 1e-9) & (t_s <= end + 1e-9))
    usable = np.all([np.isfinite(columns[s][rows]) for s in NEEDED], axis=0)
    if not usable.any():
        raise UsageError(f"{name}: no instant from {start:g} to {end:g} s has all of {', '.join(NEEDED)}")
    rows = rows[np.flatnonzero(usable)[0] : np.flatnonzero(usable)[-1] + 1]
    times = t_s[rows]
    grid = times[0] + dt * np.arange(math.floor((times[-1] - times[0]) / dt + 1e-6) + 1)
    if len(grid) * dt < SHORTEST_S:
        raise UsageError(f"{name}: {len(grid) * dt:.1f} s are too short: {SHORTEST_S:g} s are needed")
    signals: dict[str, Array] = {}
    missing = []
    for s in (*NEEDED, *OPTIONAL, "dynamic_pressure"):
        column = columns.get(s)
        values = None if column is None else _on_grid(column[rows], times, grid, s == "psi")
        if values is None:
            if s in NEEDED:
                raise UsageError(f"{name}: {s} has a gap of more than {BRIDGED_S:g} s")
            missing.append(s)
        else:
            signals[s] = values
    sideways = {
        s: x for s in SIDEWAYS if s in columns and (x := _on_grid(columns[s][rows], times, grid, False)) is not None
    }
    _refuse_unusable(name, signals, sideways)
    mass, iyy = _mean(columns, "mass", rows), _mean(columns, "iyy", rows)
    lost = float(1 - usable[np.flatnonzero(usable)[0] : np.flatnonzero(usable)[-1] + 1].mean())
    density, height = _air(columns, rows, signals, aircraft)
    if "dynamic_pressure" not in signals:
        signals["dynamic_pressure"] = 0.5 * density * signals["airspeed"] ** 2
    held = _held(signals)
    sideways |= _across(signals)
    _along(signals)
    if "v_down" in signals:
        signals.pop("altitude", None)
    if "v_along" not in signals:
        missing.append("v_along")
    return Record(
        name, dt, float(grid[0]), signals, density, height, tuple(missing), held,
        mass=mass, iyy=iyy, lost=lost, sideways=sideways,
    )  # fmt: skip


def _refuse_unusable(name: str, signals: Mapping[str, Array], sideways: Mapping[str, Array]) -> None:
    """Raises UsageError for a manoeuvre that is not flown throughout, has no input, or is banked."""
    if signals["airspeed"].min() < MIN_SPEED:
        raise UsageError(f"{name}: airspeed falls to {signals['airspeed'].min():.1f} m/s: not in flight throughout")
    moving = {n: x for n, x in (*signals.items(), *sideways.items()) if n in _MAY_MOVE}
    if all(x.std() < _NOISE_TIMES * DEFAULT_NOISE[n] for n, x in moving.items()):
        raise UsageError(f"{name}: neither a surface nor the air moved: nothing can be judged without an input")
    if "phi" in signals and (why := banked(float(np.abs(signals["phi"]).max()))):
        raise UsageError(f"{name}: {why}")


def _on_grid(column: Array, times: Array, grid: Array, wraps: bool) -> Array | None:
    """On the grid by straight lines; None where a gap is longer than BRIDGED_S."""
    good = np.isfinite(column)
    if good.sum() <= 1:
        return None
    t, x = times[good], column[good]
    if max(float(np.diff(t).max()), t[0] - grid[0], grid[-1] - t[-1]) > BRIDGED_S + (grid[1] - grid[0]):
        return None
    made: Array = np.interp(grid, t, np.unwrap(x) if wraps else x)
    return made


def _held(signals: Mapping[str, Array]) -> dict[str, NDArray[np.int64]]:
    """The samples at which velocities that repeat their values are fresh."""
    found = {s: held_samples(signals[s]) for s in ("v_down", "v_north", "v_east") if s in signals}
    same = {"v_along": "v_north", "v_ahead": "v_north", "v_across": "v_east"}
    found |= {name: found[of] for name, of in same.items() if of in found}
    return {name: fresh for name, fresh in found.items() if len(fresh)}


def held_samples(x: Array) -> NDArray[np.int64]:
    """The samples at which a value that is held is new; empty for one that is new more often than each third time."""
    changes = np.flatnonzero(np.diff(x) != 0) + 1
    if len(changes) < LEAST_CHANGES or np.median(np.diff(changes)) < HELD_SAMPLES:
        return np.empty(0, dtype=np.int64)
    return changes


def _mean(columns: Mapping[str, Array], name: str, rows: NDArray[np.int64]) -> float | None:
    column = columns.get(name)
    if column is None or not np.isfinite(column[rows]).any():
        return None
    return float(np.nanmean(column[rows]))


def _air(
    columns: Mapping[str, Array], rows: NDArray[np.int64], signals: Mapping[str, Array], aircraft: Aircraft
) -> tuple[float, float]:
    """Mean density (kg/m3) by atmosphere.air_density, else of dynamic pressure and airspeed, else sea level's; and
    height (m)."""

    def mean(name: str) -> float:
        found = _mean(columns, name, rows)
        return math.nan if found is None else found

    pressure, altitude = mean("static_pressure"), mean("altitude")
    stated = math.nan if aircraft.air_density is None else aircraft.air_density
    density = float(air_density(stated, pressure, mean("air_temperature"), altitude))
    shown = math.nan
    if "dynamic_pressure" in signals:
        shown = float(np.mean(2 * signals["dynamic_pressure"] / signals["airspeed"] ** 2))
    if math.isnan(density):
        density = shown if math.isfinite(shown) else SEA_LEVEL_DENSITY
    if math.isfinite(altitude):
        return density, altitude
    if math.isfinite(pressure):
        return density, height_at_pressure(pressure)
    return density, height_at_density(shown) if math.isfinite(shown) else 0.0


def _along(signals: dict[str, Array]) -> None:
    """Ground speed along the mean heading in place of v_north and v_east, where the heading is steady."""
    north, east = signals.pop("v_north", None), signals.pop("v_east", None)
    heading = signals.pop("psi", None)
    if north is None:
        return
    if east is None:
        speed = float(np.mean(north))
        if abs(abs(speed) / float(np.mean(signals["airspeed"])) - 1) < PLANE:
            signals["v_along"] = math.copysign(1.0, speed) * north
        return
    if heading is None:
        heading = np.unwrap(np.arctan2(east, north))
    if np.ptp(heading) > _STRAIGHT:
        return
    mean = float(np.mean(heading))
    signals["v_along"] = north * math.cos(mean) + east * math.sin(mean)


def _across(signals: Mapping[str, Array]) -> dict[str, Array]:
    """Heading, and the ground speeds across and along its mean, where these are recorded."""
    heading = signals.get("psi")
    if heading is None:
        return {}
    if "v_north" not in signals or "v_east" not in signals:
        return {"psi": heading}
    mean = float(np.mean(heading))
    north, east, cos, sin = signals["v_north"], signals["v_east"], math.cos(mean), math.sin(mean)
    return {"psi": heading, "v_across": east * cos - north * sin, "v_ahead": north * cos + east * sin}


_OF_BOTH: Final = ("theta", "phi", "p", "q", "r", "ax", "az", "airspeed", "dynamic_pressure", "v_down")
"""Signals that lateral motion is judged by, too."""


def lateral_record(record: Record) -> Record | str:
    """The record with the signals of its lateral motion; or why that cannot be judged."""
    there = {**{n: record.signals[n] for n in _OF_BOTH if n in record.signals}, **record.sideways}
    lacking = [n for n in (*SIDEWAYS, "p", "r", "phi") if n not in there]
    if lacking:
        return f"no {', '.join(lacking)}"
    if not any(was_moved(record, s) for s in LATERAL_SURFACES):
        return "neither aileron nor rudder moved"
    return replace(record, signals=there)


def was_moved(record: Record, surface: str) -> bool:
    """Whether an input was flown by it."""
    x = record.signals.get(surface, record.sideways.get(surface))
    return x is not None and float(x.std()) >= _EXCITED


def why_not_lateral(aircraft: Aircraft) -> str:
    """What keeps an aircraft's lateral motion from being judged; "" if nothing does."""
    own = aircraft.inertia
    there = {"inertia.ixx": own.ixx, "inertia.izz": own.izz, **{n: aircraft.value(n) for n in ("Cl_p", "Cn_beta")}}
    missing = [name for name, value in there.items() if not value]
    return f"the profile gives no {', '.join(missing)}" if missing else ""


def describe_missing(record: Record) -> list[str]:
    """What was left out or corrected, and what cannot be judged for want of signals."""
    words = list(record.remarks)
    if "v_down" in record.missing:
        words.append("no vertical velocity: slow gusts are not separated from slow motion, velocity is not judged")
    if "v_along" in record.missing:
        words.append("no ground speed along a steady heading: horizontal accelerations are not checked against it")
    if "thrust" in record.missing:
        words.append("no thrust: taken as constant")
    return words
