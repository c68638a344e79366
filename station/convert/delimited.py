"""Text records: the station's CSV in and out, and the HFB-320's columns.

A value that is in SI already comes back with the same bits: it is written as the shortest decimal that reads back the
same. Time is kept to the nanosecond.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import SIGNALS, UNIT_ALIASES, UNITS, Unit, unit_named
from station.convert.tracks import Column, Record, Track, in_si, ordered
from station.profile import Aircraft, Rig, nearest
from station.rows import LogError

LATEST_S: Final = 9e9
"""Beyond it nanoseconds do not fit in 64 bits."""

_HEADING = re.compile(r"^(?P<name>[^\[\]]*?)\s*(?:\[(?P<unit>[^\[\]]*)\])?$")


def read_csv(path: Path, aircraft: Aircraft, rig: Rig | None = None) -> Record:
    """A CSV whose first line names each signal with its unit in brackets, one of them time: the station's, and those
    that the `rig` declares.

    Raises LogError naming line and column, with the nearest signal or the units that fit.
    """
    lines = _lines(path)
    number, header = next(lines, (0, ""))
    if not number:
        raise LogError(f"{path}: empty: the first line must name the columns, for example: time [s],q [deg/s]")
    names, units = _headings(path, number, header, _known(rig))
    time_at = names.index("time")
    columns: list[list[float]] = [[] for _ in names]
    for number, line in lines:
        cells = line.split(",")
        if len(cells) != len(names):
            at = min(len(cells), len(names)) + 1
            raise LogError(f"{path}: line {number}, column {at}: {len(cells)} columns, but the header has {len(names)}")
        for i, cell in enumerate(cells):
            columns[i].append(_value(path, number, i, cell))
        times = columns[time_at]
        if math.isnan(times[-1]):
            raise LogError(f"{path}: line {number}, column {time_at + 1}: time is missing")
        if len(times) > 1 and not times[-1] > times[-2]:
            raise LogError(
                f"{path}: line {number}, column {time_at + 1}: time does not increase: {times[-1]} after {times[-2]}"
            )
    if not columns[time_at]:
        raise LogError(f"{path}: no row of values below the header")
    seconds = in_si(np.array(columns[time_at]), units[time_at])
    t_ns = _nanoseconds(path, seconds)
    # What a rig derives is made anew of the others.
    derived = () if rig is None else tuple(rig.derived)
    found = {
        name: in_si(np.array(column), unit)
        for name, unit, column in zip(names, units, columns, strict=True)
        if name != "time" and name not in derived
    }
    return Record([Track("record", t_ns, found)], aircraft, "csv", {"file": path.name}, rig)


def _known(rig: Rig | None) -> dict[str, str]:
    """The SI unit of each signal that a column may be of."""
    own = {} if rig is None else {s.name: s.unit for s in rig.further.own}
    return {**{name: s.unit for name, s in SIGNALS.items()}, **own}


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Lines with their numbers, without comments and blank lines."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise LogError(f"{path}: byte {error.start}: not UTF-8 text") from None
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error
    for number, line in enumerate(io.StringIO(text), start=1):
        line = line.strip()
        if line and not line.startswith("#"):
            yield number, line


def _headings(path: Path, number: int, header: str, signals: Mapping[str, str]) -> tuple[list[str], list[Unit]]:
    """`signals`: the SI unit of each that is known."""
    names: list[str] = []
    units: list[Unit] = []
    for i, cell in enumerate(header.split(","), start=1):
        where = f"{path}: line {number}, column {i}"
        match = _HEADING.match(cell.strip())
        if match is None:
            raise LogError(f"{where}: {cell.strip()!r} is not a name and its unit in brackets, as in q [deg/s]")
        name, unit_name = match["name"], match["unit"]
        si = "s" if name == "time" else signals.get(name)
        if si is None:
            known = f"known, each with its unit as in q [deg/s]: time, {', '.join(signals)}"
            more = "" if len(signals) > len(SIGNALS) else "; others are those of a rig that declares them (--rig)"
            raise LogError(f"{where}: unknown signal {name!r}{nearest(name, (*signals, 'time'))}\n{known}{more}")
        if name in names:
            raise LogError(f"{where}: {name} is given twice, first in column {names.index(name) + 1}")
        fitting = ", ".join([*_units_of(si)])
        if unit_name is None:
            raise LogError(f"{where}: {name} has no unit: write {name} [{si}]\nfitting: {fitting}")
        unit = unit_named(unit_name)
        if unit is None or unit.si != si:
            what = "unknown unit" if unit is None else "unit that does not fit"
            raise LogError(f"{where}: {name}: {what}: {unit_name!r}\nfitting: {fitting}")
        names.append(name)
        units.append(unit)
    if "time" not in names:
        raise LogError(f"{path}: line {number}: no column time [s]")
    if len(names) == 1:
        raise LogError(f"{path}: line {number}: no signal beside time")
    return names, units


def _units_of(si: str) -> list[str]:
    return [name for name, unit in UNITS.items() if unit.si == si and name not in UNIT_ALIASES]


def _value(path: Path, number: int, column: int, cell: str) -> float:
    cell = cell.strip()
    if not cell:
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        value = math.inf
    if math.isinf(value):
        raise LogError(f"{path}: line {number}, column {column + 1}: {cell!r} is not a number")
    return value


def _nanoseconds(path: Path, seconds: Column) -> NDArray[np.int64]:
    if np.max(np.abs(seconds)) > LATEST_S:
        raise LogError(f"{path}: time {seconds[-1]} s is out of range")
    t_ns = np.round(seconds * 1e9).astype(np.int64)
    steps = np.diff(t_ns)
    if np.any(steps <= 0):
        raise LogError(f"{path}: time does not increase by a nanosecond after {seconds[int(np.argmax(steps <= 0))]} s")
    return t_ns


def write_csv(path: Path, units: Mapping[str, str], blocks: Iterable[tuple[Column, Mapping[str, Column]]]) -> None:
    """Times (s) and columns, block by block, with their `units` in the header; missing is blank. Raises OSError."""
    header = ",".join(["time [s]", *(f"{name} [{unit}]" for name, unit in units.items())])
    with path.open("x", encoding="utf-8", newline="\n") as file:
        file.write(header + "\n")
        for t_s, columns in blocks:
            for row in zip(t_s.tolist(), *(c.tolist() for c in columns.values()), strict=True):
                file.write(",".join(["" if v != v else repr(v) for v in row]) + "\n")


_HFB_SIGNALS: Final[Sequence[str]] = (
    "time", "elevator", "dynamic_pressure", "thrust", "airspeed", "alpha_vane", "theta", "q", "qdot", "ax", "az", "ay",
)  # fmt: skip
"""The HFB-320 example's columns, SI (Jategaonkar 2015, supplementary data); those after them are lateral, unnamed."""


def read_hfb(path: Path, aircraft: Aircraft) -> Record:
    """The HFB-320 record: 12 columns or more, blank-separated, no header. Raises LogError naming the line."""
    rows: list[list[float]] = []
    for number, line in _lines(path):
        cells = line.split()
        width = len(rows[0]) if rows else len(cells)
        if len(cells) != width or width < len(_HFB_SIGNALS):
            expected = str(width) if rows else f"at least {len(_HFB_SIGNALS)}"
            raise LogError(f"{path}: line {number}: {len(cells)} columns, not {expected}")
        rows.append([_value(path, number, i, cell) for i, cell in enumerate(cells)])
    if not rows:
        raise LogError(f"{path}: empty")
    matrix = np.array(rows)
    t_ns = _nanoseconds(path, matrix[:, 0])
    found = {name: matrix[:, i].copy() for i, name in enumerate(_HFB_SIGNALS) if i}
    extra = {f"column_{i + 1}": matrix[:, i].copy() for i in range(len(_HFB_SIGNALS), matrix.shape[1])}
    track = Track("record", t_ns, ordered(found), extra)
    return Record([track], aircraft, "hfb320", {"file": path.name})
