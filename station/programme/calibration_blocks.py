"""Recordings of a calibration flight as block means on one axis, and the runs that were flown."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.estimation.flight_record import FlightRecord
from station.estimation.instrument_errors import known
from station.identification.cleaning import cleaned
from station.identification.preparation import corrected, flight_record, less_fuel
from station.log import About, Table, metadata, table
from station.model.air_data_calibration import Blocks
from station.numerics.atmosphere import air_densities
from station.numerics.regression import NotIdentifiable
from station.profile import Aircraft, Instrument
from station.rows import UsageError

Array = NDArray[np.float64]

BLOCK_S: Final = 4.0
"""Of a mean: shorter than a gust's passage, longer than a short period."""
NEEDED: Final = ("airspeed", "alpha_vane", "theta", "phi", "v_north", "v_east", "v_down", "p", "q", "r", "ax", "az")
OPTIONAL: Final = (
    "psi", "beta_vane", "ay", "dynamic_pressure", "altitude", "mass", "static_pressure", "air_temperature",
)  # fmt: skip
CALIBRATED: Final = (
    "airspeed", "dynamic_pressure", "alpha_vane", "beta_vane", "phi", "theta", "psi", "ax", "ay", "az",
)  # fmt: skip
"""Signals whose stated errors are taken out of the profile, to be found anew."""
RARE: Final = 0.5
"""Share of the blocks that have an optional signal, below which it is left out, not the others."""
STILL: Final = math.radians(1.0)
"""Standard deviation of the pitch rate, rad/s, above which a block holds a test input or its answer."""
ROLLING: Final = math.radians(6.0)
"""Change of bank within a block above which its means are no longer one attitude's: of a vector that is turned by so
much the mean is 0.05 % short, 5 mm/s2 of gravity, as the accelerometers' zeros are to be known."""
TURNING: Final = math.radians(0.7)
"""Turn rate, rad/s, from which an aircraft turns: a quarter of rate one."""
SAME_SPEED: Final = 2.5
"""m/s: a run ends where the speed has left its mean by more."""
SAME_HEADING: Final = math.radians(10.0)
SHORTEST_RUN_S: Final = 12.0
LEAST_S: Final = 60.0
"""Of usable blocks, together."""
PAUSE_S: Final = 300.0
"""Between recordings whose clocks do not say."""
DAY_S: Final = 86400.0


@dataclass(frozen=True, slots=True)
class Run:
    """A stretch of one kind: "steady", "turn" or "input"."""

    log: str
    kind: str
    start_s: float
    end_s: float
    speed: float
    """Mean of the airspeed as measured, m/s."""
    heading: float
    """Mean track, rad; NaN in a turn."""
    bank: float
    mass: float
    """kg; NaN where it is not recorded."""
    rows: slice
    """Of the blocks."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """One recording: its record with the stated errors of what is calibrated left in, and where its blocks are."""

    path: Path
    record: FlightRecord
    start_s: float
    """On the blocks' time axis."""
    rows: slice


@dataclass(frozen=True, slots=True)
class Calibrating:
    """All recordings of a calibration flight."""

    blocks: Blocks
    runs: tuple[Run, ...]
    recordings: tuple[Recorded, ...]
    remarks: tuple[str, ...]


def bare(aircraft: Aircraft) -> Aircraft:
    """The aircraft without the stated errors of what is calibrated."""
    kept = {n: e for n, e in aircraft.instruments.items() if n not in CALIBRATED}
    for name in set(aircraft.instruments) & set(CALIBRATED):
        e = aircraft.instruments[name]
        still = Instrument().model_copy(update={"latency": 0.0 if name == "alpha_vane" else e.latency, "lag": e.lag})
        if still != Instrument():
            kept[name] = still
    return aircraft.model_copy(update={"instruments": kept})


Opened = Callable[[Path], tuple[Table, About]]


def opened(path: Path) -> tuple[Table, About]:
    """A recording, and what it says of itself. Raises LogError."""
    return table(path), metadata(path).about


def calibrating(logs: Sequence[Path], aircraft: Aircraft, read: Opened = opened) -> Calibrating:
    """Raises LogError, and UsageError for recordings that nothing can be calibrated with."""
    subject = bare(aircraft)
    remarks = [*known(subject).refused]
    recordings: list[Recorded] = []
    parts: list[tuple[dict[str, Array], Array]] = []
    runs: list[Run] = []
    after, count, mass = 0.0, 0, aircraft.inertia.mass
    for path, utc in _in_order(logs):
        record, words = _record(path, subject, read, mass)
        mass = float(np.ravel(record.airframe.mass)[-1])
        remarks += [f"{path.name}: {w}" for w in words]
        time, columns, rare = _blocks(record)
        remarks += [f"{path.name}: {n} is missing in more than half of the flight: left out" for n in rare]
        if not len(time):
            remarks.append(f"{path.name}: no block of {BLOCK_S:g} s has all that is needed: it is left out")
            continue
        start = after if utc is None else max(after, utc)
        rows = slice(count, count + len(time))
        recordings.append(Recorded(path, record, start, rows))
        runs += _runs(path.name, time, columns, count)
        parts.append((columns, time + start))
        count += len(time)
        after = start + float(time[-1]) + (PAUSE_S if utc is None else BLOCK_S)
    if not parts or count * BLOCK_S < LEAST_S:
        why = "\n".join(remarks[:2])
        raise UsageError(f"{count * BLOCK_S:.0f} s can be used: a calibration needs {LEAST_S:g} s and more\n{why}")
    names = set.intersection(*(set(c) for c, _ in parts))
    lost = sorted(set.union(*(set(c) for c, _ in parts)) - names)
    if lost:
        remarks.append(f"not in every recording, and left out: {', '.join(lost)}")
    columns = {n: np.concatenate([c[n] for c, _ in parts]) for n in names}
    blocks = Blocks(
        np.concatenate([t for _, t in parts]),
        {n: x for n, x in columns.items() if n not in ("density", "q_sd", "rolled")},
        columns["density"],
        (columns["q_sd"] < STILL) & (columns["rolled"] < ROLLING),
        _held(columns["airspeed"], runs),
    )
    return Calibrating(blocks, tuple(runs), tuple(recordings), tuple(remarks))


def _held(airspeed: Array, runs: Sequence[Run]) -> Array:
    held = airspeed.copy()
    for run in runs:
        held[run.rows] = airspeed[run.rows].mean()
    return held


def _in_order(logs: Sequence[Path]) -> list[tuple[Path, float | None]]:
    """As flown, with their begin in s after the first, where their clocks tell them apart; else as given."""
    if len(logs) == 1:
        return [(logs[0], None)]
    begins = {path: metadata(path).utc_ns * 1e-9 for path in dict.fromkeys(logs)}
    ordered = sorted(begins, key=lambda p: begins[p])
    steps = np.diff([begins[p] for p in ordered])
    imported = any(metadata(p).about.imported for p in ordered)
    if imported or not ((steps > BLOCK_S) & (steps < DAY_S)).all():
        return [(path, None) for path in begins]
    return [(p, begins[p] - begins[ordered[0]]) for p in ordered]


def _record(path: Path, subject: Aircraft, read: Opened, mass: float) -> tuple[FlightRecord, list[str]]:
    """`mass`: at its beginning, kg, where the fuel flow is recorded. Raises UsageError for one without what is
    needed."""
    flown, about = read(path)
    whole, words = cleaned(flown)
    loading = subject.inertia.model_copy(update={"mass": mass})
    whole, subject = less_fuel(whole, subject.model_copy(update={"inertia": loading}))
    if "mass" in whole.columns and "mass" not in flown.columns:
        left = whole.columns["mass"]
        words = [*words, f"mass by the fuel flow: {left[0]:.0f} kg at the beginning, {left[-1]:.0f} kg at the end"]
    ready = corrected(whole, subject, about.noise_si(whole.aligned), about.imu_position)
    lacking = [n for n in NEEDED if n not in ready.columns or not np.isfinite(ready.columns[n]).any()]
    if "v_north" in lacking or "v_east" in lacking:
        raise UsageError(
            f"{path}: no GNSS velocity ({', '.join(n for n in lacking if n.startswith('v_'))}): nothing to hold the "
            "airspeed against\nrecord v_north, v_east and v_down, and calibrate again"
        )
    if lacking:
        raise UsageError(f"{path}: cannot be calibrated with: it has no {', '.join(lacking)}")
    try:
        record, _ = flight_record(ready, subject, about.imu_position, about.noise_si(whole.aligned))
    except NotIdentifiable as why:
        raise UsageError(f"{path}: {why}") from why
    if "dynamic_pressure" not in whole.columns:  # the record makes one of the airspeed
        record.motion.pop("dynamic_pressure", None)  # type: ignore[attr-defined]
    return record, list(words)


def _blocks(record: FlightRecord) -> tuple[Array, dict[str, Array], list[str]]:
    """Middles (n,) s of the record's time, and means of all that is needed, of blocks without a gap; and which optional
    signals are left out because more than half of the blocks lack them."""
    motion, dt = record.motion, record.dt
    width = max(2, round(BLOCK_S / dt))
    every = np.arange(len(record.t_s) // width)[:, None] * width + np.arange(width)
    there = {n: np.isfinite(motion[n])[every].all(axis=1) for n in (*NEEDED, *OPTIONAL) if record.has(n)}
    whole = np.all([there[n] for n in NEEDED], axis=0)
    # A signal that is missing for a while, at the beginning above all, costs blocks; one that seldom is there, itself.
    rare: list[str] = [n for n in OPTIONAL if n in there and np.sum(there[n] & whole) < RARE * np.sum(whole)]
    names = [n for n in there if n not in rare]
    rows = every[np.all([there[n] for n in names], axis=0)]
    t = (np.arange(width) - 0.5 * (width - 1)) * dt
    made = {n: motion[n][rows].mean(axis=1) for n in names if n != "psi"}
    if "psi" in names:
        made["psi"] = np.unwrap(motion["psi"][rows], axis=1).mean(axis=1)
    air = (motion.get(n, np.full(len(record.t_s), np.nan)) for n in ("static_pressure", "air_temperature", "altitude"))
    stated = record.aircraft.air_density
    made["density"] = air_densities(np.nan if stated is None else stated, *air)[rows].mean(axis=1)
    made["q_sd"] = motion["q"][rows].std(axis=1)
    made["rolled"] = np.ptp(motion["phi"][rows], axis=1)
    # In a turn the mean of a vector is shorter than the vectors: magnitude and direction are averaged instead.
    ground = np.hypot(motion["v_north"], motion["v_east"])[rows]
    track = np.unwrap(np.arctan2(motion["v_east"], motion["v_north"])[rows], axis=1)
    speed, way = ground.mean(axis=1), track.mean(axis=1)
    slope = t / float(t @ t)
    faster, turning, down = ground @ slope, track @ slope, motion["v_down"][rows] @ slope
    made["v_north"], made["v_east"] = speed * np.cos(way), speed * np.sin(way)
    made["v_north_dot"] = faster * np.cos(way) - speed * turning * np.sin(way)
    made["v_east_dot"] = faster * np.sin(way) + speed * turning * np.cos(way)
    made["v_down_dot"] = down
    made["track"], made["turning"] = way, turning
    phi, theta = motion["phi"][rows], motion["theta"][rows]
    yawing = (motion["q"][rows] * np.sin(phi) + motion["r"][rows] * np.cos(phi)) / np.cos(theta)
    made["swept"] = np.std(np.cumsum(yawing, axis=1) * dt, axis=1)
    if not np.isfinite(made["density"]).all():
        made["density"] = np.full(len(rows), np.nan)
        made.pop("dynamic_pressure", None)
    return record.t_s[rows].mean(axis=1), made, rare


def _runs(log: str, time: Array, columns: Mapping[str, Array], first: int) -> list[Run]:
    """Stretches of one kind; steady ones of one speed and heading."""
    kinds = np.where(
        columns["q_sd"] >= STILL, "input", np.where(np.abs(columns["turning"]) > TURNING, "turn", "steady")
    )
    made, begin = [], 0
    for k in range(1, len(time) + 1):
        if k < len(time) and kinds[k] == kinds[begin] and time[k] - time[k - 1] < 1.5 * BLOCK_S:
            so_far = slice(begin, k)
            moved = abs(columns["airspeed"][k] - columns["airspeed"][so_far].mean()) > SAME_SPEED
            turn = math.remainder(columns["track"][k] - columns["track"][begin], 2 * math.pi)
            if kinds[k] != "steady" or (not moved and abs(turn) < SAME_HEADING):
                continue
        rows = slice(begin, k)
        start, end = float(time[begin]) - BLOCK_S / 2, float(time[k - 1]) + BLOCK_S / 2
        if kinds[begin] == "input" or end - start >= SHORTEST_RUN_S:
            track = columns["track"][rows]
            turns = kinds[begin] == "turn"
            made.append(
                Run(
                    log,
                    str(kinds[begin]),
                    start,
                    end,
                    float(columns["airspeed"][rows].mean()),
                    math.nan if turns else math.atan2(np.sin(track).mean(), np.cos(track).mean()),
                    float(columns["phi"][rows].mean()),
                    float(columns["mass"][rows].mean()) if "mass" in columns else math.nan,
                    slice(first + begin, first + k),
                )
            )
        begin = k
    return made
