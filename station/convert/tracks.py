"""A record from elsewhere, in SI, and the recording made of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import SIGNALS, Stream, Unit
from station.log import About, write_log
from station.profile import Aircraft, Rig, from_json, to_json
from station.rows import Extra, LogError, ProfileError, Rows, Sample

Column = NDArray[np.float64]

EVERY: Final = 5_000
"""Rows: about a tenth of a second."""


@dataclass(frozen=True, slots=True)
class Track:
    """Signals on one time base: `t_ns` (n,) the record's own time, increasing; columns (n,) SI, NaN where missing."""

    name: str
    t_ns: NDArray[np.int64]
    columns: Mapping[str, Column]
    extra: Mapping[str, Column] = field(default_factory=dict)
    """Columns that are no signal of the station, SI."""

    def stream(self) -> Stream:
        step = float(np.median(np.diff(self.t_ns))) * 1e-9 if len(self.t_ns) > 1 else 1.0
        rate = 1.0 / step
        return Stream(self.name, tuple(self.columns), rate, max(0.2, 10 / rate))


@dataclass(frozen=True, slots=True)
class Record:
    tracks: Sequence[Track]
    aircraft: Aircraft
    source: str
    notes: Mapping[str, str] = field(default_factory=dict)
    rig: Rig | None = None
    """Which declares signals of the tracks beyond the station's."""


def write_record(path: Path, record: Record, told: Callable[[float], None] = lambda _: None) -> int:
    """Make a recording of it: station time 0 is the record's first sample. Returns the number of rows; `told` hears
    now and then what share of them is written.

    Raises LogError if the record is empty, its aircraft cannot be (whoever reads the recording would refuse it), or the
    file cannot be written.
    """
    try:
        from_json(Aircraft, to_json(record.aircraft))
    except ProfileError as error:
        words = str(error).removeprefix("recording: ")
        raise LogError(f"{record.source}: what the file says of its aircraft cannot be: {words}") from error
    tracks = [t for t in record.tracks if len(t.t_ns) and t.columns]
    if not tracks:
        raise LogError(f"{record.source}: holds no signal that the station knows: {', '.join(SIGNALS)}")
    about = About(
        record.aircraft,
        tuple(t.stream() for t in tracks),
        rig=record.rig,
        source=record.source,
        imported=True,
        notes=record.notes,
    )
    return write_log(path, about, _rows(tracks, told))


def _rows(tracks: Sequence[Track], told: Callable[[float], None]) -> Iterator[Rows]:
    zero = min(int(t.t_ns[0]) for t in tracks)
    # By time, then in the order of the tracks.
    times = np.concatenate([t.t_ns for t in tracks])
    which = np.concatenate([np.full(len(t.t_ns), i) for i, t in enumerate(tracks)])
    values = [list(zip(*(c.tolist() for c in t.columns.values()), strict=True)) for t in tracks]
    extras = [list(zip(*(c.tolist() for c in t.extra.values()), strict=True)) for t in tracks]
    at = [0] * len(tracks)
    for count, i in enumerate(which[np.argsort(times, kind="stable")].tolist()):
        if not count % EVERY:
            told(count / len(times))
        track, k = tracks[i], at[i]
        at[i] += 1
        t_ns = int(track.t_ns[k])
        yield Sample(t_ns - zero, track.name, t_ns, None, values[i][k])
        if track.extra:
            yield Extra(t_ns - zero, dict(zip(track.extra, extras[i][k], strict=True)))


def ordered(columns: Mapping[str, Column]) -> dict[str, Column]:
    """Those that are signals, in the order of SIGNALS."""
    return {name: columns[name] for name in SIGNALS if name in columns}


def in_si(values: Column, unit: Unit) -> Column:
    """Converted to SI; values that are in SI already keep their bits."""
    return _shifted(values if unit.factor == 1.0 else values * unit.factor, unit.offset)


def from_si(values: Column, unit: Unit) -> Column:
    """The inverse of `in_si`, to within one rounding each way."""
    shifted = _shifted(values, -unit.offset)
    return shifted if unit.factor == 1.0 else shifted / unit.factor


def _shifted(values: Column, offset: float) -> Column:
    # Adding zero would turn -0.0 into 0.0.
    return values + offset if offset else values
