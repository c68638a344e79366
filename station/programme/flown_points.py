"""The test points of recordings: which they are, what was flown in them, and what every method makes of each.

Turbulence is judged during the input, not over the point nor at its end: an input flown in calm air before a gust field
is met needs no correction for gusts, and methods that apply one would bias it (Martos 2013, test point 12).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from station.estimation.acceptance import banked
from station.estimation.flight_record import LEAST_S, LEAST_SHARE, SLOWEST_S, FlightRecord
from station.estimation.method_table import METHODS
from station.estimation.results import MethodResult, not_applicable
from station.identification.analysis import identify
from station.identification.flown_inputs import FlownInput, inputs_of
from station.identification.identified import Identification
from station.identification.request import Request
from station.log import Point, Table
from station.numerics.turbulence import HIGH_HZ, LOW_HZ, classified
from station.profile import Aircraft, Card
from station.programme.drag import DragOfPoint, drag_of
from station.rows import UsageError

Array = NDArray[np.float64]

BASELINE: Final = "baseline"
"""A point whose condition says so is one of the baseline's."""
SHORTEST_S: Final = 6.0
"""Of a point: below, not even one short period and the trim before it are in it."""
ANSWER_S: Final = 1.0
"""Before and after an input that its turbulence is judged over, too."""


@dataclass(frozen=True, slots=True)
class FlownPoint:
    """A test point and what was made of it."""

    log: str
    number: int
    name: str
    condition: str
    start_s: float
    end_s: float
    found: Identification | None
    """None where no method could use it, and why:"""
    why: str = ""
    inputs: tuple[FlownInput, ...] = ()
    turbulence: str = "unknown"
    """During the inputs, as `gust_sd` is."""
    gust_sd: float = math.nan
    """Standard deviation of the vertical gust in 2-7 Hz, m/s."""
    drag: DragOfPoint | None = None
    """Where thrust is recorded."""
    methods: Mapping[str, MethodResult] | None = None
    """Those that the air during the input lets apply."""

    @property
    def is_baseline(self) -> bool:
        return _says_baseline(self.condition)

    @property
    def banked(self) -> str:
        """Why nothing is told of its derivatives, if it was flown in a steep turn; else ""."""
        bank = self.found.record.motion.get("phi") if self.found else None
        return banked(float(np.nanmax(np.abs(bank)))) if bank is not None and np.isfinite(bank).any() else ""

    @property
    def title(self) -> str:
        return f"{self.name} ({self.condition})" if self.condition else self.name


def named(point: Point) -> tuple[str, str]:
    """Name and condition of a marked point: what stands before and after the note's first semicolon."""
    name, _, condition = point.note.partition(";")
    name = name.strip()
    return (f"TP {point.n}" if not name or name == f"test point {point.n}" else name), condition.strip()


def is_of_baseline(point: Point) -> bool:
    """Whether a marked point's condition says that it is one of the baseline's."""
    return _says_baseline(named(point)[1])


def _says_baseline(condition: str) -> bool:
    return BASELINE in condition.lower()


def marked(table: Table, points: Sequence[Point], log: Path) -> list[Point]:
    """The points of a recording; where none is marked, all of it is one, named as the file."""
    return list(points) or [Point(1, float(table.t_s[0]), float(table.t_s[-1]), log.stem)]


def flown_point(
    table: Table,
    point: Point,
    aircraft: Aircraft,
    card: Card | None,
    imu_position: tuple[float, float, float],
    noise: Mapping[str, float] | None,
    methods: Sequence[str],
    log: str,
) -> FlownPoint:
    """One point by these methods; a point that none can use says why."""
    name, condition = named(point)
    made = FlownPoint(log, point.n, name, condition, point.start_s, point.end_s, None)
    if point.end_s - point.start_s < SHORTEST_S:
        return replace(made, why=f"{point.end_s - point.start_s:.1f} s long: {SHORTEST_S:g} s are the least")
    request = Request(
        methods, point.start_s, point.end_s, card=card, imu_position=imu_position, noise=noise, force=True, log=log
    )
    try:
        found = identify(table, aircraft, request)
    except UsageError as error:
        return replace(made, why=str(error).partition("\n")[0])
    inputs = inputs_of(found.record)
    level, gust_sd = _turbulence(found, inputs)
    if not inputs:
        made = replace(made, why="the elevator rests throughout: no input was flown")
    return replace(
        made,
        found=found,
        inputs=inputs,
        turbulence=level,
        gust_sd=gust_sd,
        drag=drag_of(found.record),
        methods={n: _judged(n, r, level) for n, r in found.methods.items()},
    )


def gusts_over(found: Identification) -> Array | None:
    """Vertical gust in 2-7 Hz over an identified interval, m/s, (n,) on its record's grid; None where unknown."""
    return banded(found.record, found.flown.gust_vertical(found.record) if found.flown else None)


def banded(record: FlightRecord, gust: Array | None) -> Array | None:
    """A vertical gust in 2-7 Hz, m/s; without one, alpha times V, which holds the motion."""
    if record.dt > SLOWEST_S:
        return None
    w = record.alpha * record.motion["airspeed"] if gust is None else gust
    good = np.isfinite(w)
    if good.mean() < LEAST_SHARE or good.sum() * record.dt < LEAST_S:
        return None
    whole = np.interp(record.t_s, record.t_s[good], w[good])
    sos = butter(4, [LOW_HZ, HIGH_HZ], "bandpass", fs=1 / record.dt, output="sos")
    return np.asarray(sosfiltfilt(sos, whole - whole.mean()))


def _turbulence(found: Identification, inputs: Sequence[FlownInput]) -> tuple[str, float]:
    """Class and level during the inputs; over all of the point where none was flown."""
    record, band = found.record, gusts_over(found)
    if band is None:
        return "unknown", math.nan
    during = np.zeros(len(band), dtype=bool)
    for one in inputs:
        during |= (record.t_s >= one.start_s - ANSWER_S) & (record.t_s <= one.end_s + ANSWER_S)
    level = float(np.std(band[during if during.any() else slice(None)]))
    speed = float(np.nanmean(record.motion["airspeed"]))
    return classified(level, speed, record.noise["alpha_vane"], record.dt), level


def _judged(name: str, result: MethodResult, level: str) -> MethodResult:
    """A method for turbulence does not apply where the input was flown in calm air."""
    if not METHODS[name].turbulence_only or level != "calm" or not result.parameters:
        return result
    refused = not_applicable("calm during the input", [p.name for p in result.parameters])
    return replace(refused, settings=result.settings)
