"""A recording as columns on one time axis: its 50 Hz frames, or an imported record's samples on their own grid."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.conventions import ANGLES_THAT_WRAP, TICK_NS
from station.log.about import LogInfo
from station.log.reading import metadata, read_rows, row_times
from station.profile import Aircraft, Further
from station.rows import Code, Event, Extra, Frame, LogError, Quality, Sample, Truth

Column = NDArray[np.float64]

FAR_S: Final = 1e8
"""Longer than any recording, s."""


@dataclass(frozen=True, slots=True)
class Table:
    """Columns of one length n: `t_s` (n,) is seconds since `t0_ns` of station time; `columns` are signals in the units
    of SIGNALS, then what the rig declares; NaN where missing; a signal that is missing throughout has no column."""

    t_s: Column
    columns: Mapping[str, Column]
    aircraft: Aircraft
    t0_ns: int
    quality: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict)
    """Of frames: a Quality number for each value."""
    ages: Mapping[str, Column] = field(default_factory=dict)
    """Of frames: seconds since each value was measured, 0 where it was interpolated at the row's own time."""
    truth: Mapping[str, Column] = field(default_factory=dict)
    """What the simulation knows, at the same times (linear between its steps)."""
    extra: Mapping[str, Column] = field(default_factory=dict)
    """Of an imported record: its columns that are no signal, SI."""
    record_ns: NDArray[np.int64] | None = None
    """Of an imported record on one time base: (n,) the record's own time."""

    @property
    def rate_hz(self) -> float:
        """From the median step; NaN for fewer than two rows."""
        return float(1.0 / np.median(np.diff(self.t_s))) if len(self.t_s) > 1 else float("nan")

    @property
    def aligned(self) -> bool:
        """Whether the rows are frames, aligned in flight, and not samples as they came."""
        return bool(self.quality)

    def between(self, start_s: float, end_s: float) -> Table:
        """The rows with start_s <= t_s <= end_s, their times unchanged."""
        keep = (self.t_s >= start_s) & (self.t_s <= end_s)

        def cut(columns: Mapping[str, Column]) -> dict[str, Column]:
            return {name: column[keep] for name, column in columns.items()}

        return replace(
            self,
            t_s=self.t_s[keep],
            columns=cut(self.columns),
            quality={name: column[keep] for name, column in self.quality.items()},
            ages=cut(self.ages),
            truth=cut(self.truth),
            extra=cut(self.extra),
            record_ns=None if self.record_ns is None else self.record_ns[keep],
        )

    def age_s(self, name: str) -> Column:
        """(n,) seconds since each value of a signal was measured, NaN where it is missing: as recorded in flight; else
        of a held value since it was last new, and 0 of the others."""
        column = self.columns[name]
        if name in self.ages:
            return np.where(np.isnan(column), np.nan, self.ages[name])
        held = self.quality.get(name, np.zeros(len(column), dtype=np.uint8)) == Quality.HELD
        at, there = np.arange(len(column)), np.isfinite(column)
        before = np.concatenate(([-1], np.maximum.accumulate(np.where(there, at, -1))[:-1]))
        repeats = held & (before >= 0) & (column == column[before])
        newest = np.maximum.accumulate(np.where(there & ~repeats, at, -1))
        age = np.where(held, self.t_s - self.t_s[newest], 0.0)
        return np.where(np.isnan(column) | (newest < 0), np.nan, age)


class Point(NamedTuple):
    """A test point flown and marked: seconds on the table's time axis."""

    n: int
    start_s: float
    end_s: float
    note: str


class _Track(NamedTuple):
    """Rows of one stream: times in ns (n,) and values (n, signals)."""

    t_ns: NDArray[np.int64]
    values: Column


def table(path: Path, span_s: tuple[float, float] | None = None) -> Table:
    """The frames of a recording; without frames, its samples: on their own times where all streams share them, else
    linearly interpolated at 50 Hz. Raises LogError where there is neither.

    `span_s`: only the rows from and to these seconds of the whole table's time axis, which then stays as it is.
    """
    info = metadata(path)
    grid = _on_grid(path)
    origin_ns: int | None = None
    span_ns: tuple[int, int] | None = None
    if span_s is not None and grid is Frame:
        origin_ns = next(read_rows(path, (Frame,))).t_ns
        span_ns = origin_ns + _ns(span_s[0]), origin_ns + _ns(span_s[1])
    frames: list[Frame] = []
    samples: dict[str, list[Sample]] = {}
    named: dict[type, list[Truth | Extra]] = {Truth: [], Extra: []}
    for row in read_rows(path, (grid, Truth, Extra), span_ns):
        if isinstance(row, Frame):
            frames.append(row)
        elif isinstance(row, Truth | Extra):
            named[type(row)].append(row)
        elif isinstance(row, Sample):
            samples.setdefault(row.stream, []).append(row)
    record_ns = None
    quality: dict[str, NDArray[np.uint8]] = {}
    ages: dict[str, Column] = {}
    if frames:
        t_ns, columns, quality, ages = _from_frames(frames, info.about.signals)
    elif samples:
        t_ns, columns = _from_samples(samples, info)
        first = next(iter(samples.values()))[0]
        if info.about.imported and len(samples) == 1 and first.t_device_ns is not None:
            record_ns = t_ns + (first.t_device_ns - first.t_ns)
    elif origin_ns is not None and span_s is not None:
        raise LogError(f"{path}: holds nothing from {span_s[0]:g} to {span_s[1]:g} s")
    else:
        raise LogError(f"{path}: holds neither frames nor samples")
    truth = {n: _at(t_ns, t.t_ns, t.values[:, 0], False) for n, t in _by_name(named[Truth]).items()}
    extra = {n: _at(t_ns, t.t_ns, t.values[:, 0], False) for n, t in _by_name(named[Extra]).items()}
    zero = int(t_ns[0]) if origin_ns is None else origin_ns
    whole = Table((t_ns - zero) / 1e9, columns, info.aircraft, zero, quality, ages, truth, extra, record_ns)
    return whole if span_s is None else whole.between(*span_s)


def _ns(seconds: float) -> int:
    """Kept within what fits in 64 bits."""
    return round(min(max(seconds, -FAR_S), FAR_S) * 1e9)


def _on_grid(path: Path) -> type[Frame] | type[Sample]:
    """The rows that the table's times come from."""
    return Sample if next(read_rows(path, (Frame,)), None) is None else Frame


def _from_frames(
    frames: list[Frame], signals: Iterable[str]
) -> tuple[NDArray[np.int64], dict[str, Column], dict[str, NDArray[np.uint8]], dict[str, Column]]:
    """Times, values, quality and ages."""
    t_ns = np.array([f.t_ns for f in frames], dtype=np.int64)
    values = np.array([f.values for f in frames], dtype=np.float64)
    quality = np.array([f.quality for f in frames], dtype=np.uint8)
    ages = np.array([f.age_s for f in frames], dtype=np.float64)
    there = {n: i for i, n in enumerate(signals) if not np.all(np.isnan(values[:, i]))}
    return (
        t_ns,
        {n: values[:, i].copy() for n, i in there.items()},
        {n: quality[:, i].copy() for n, i in there.items()},
        {n: ages[:, i].copy() for n, i in there.items()},
    )


def _from_samples(samples: Mapping[str, list[Sample]], info: LogInfo) -> tuple[NDArray[np.int64], dict[str, Column]]:
    known = {s.name: s for s in info.streams}
    tracks: dict[str, _Track] = {}
    for name, rows in samples.items():
        stream = known.get(name)
        if stream is None:
            continue
        # A device's latency is known from the rig; an imported record's times are the record's own.
        late = 0 if info.about.imported else round(stream.latency_s * 1e9)
        good = [r for r in rows if len(r.values) == len(stream.signals)]
        t_ns = np.array([r.t_ns - late for r in good], dtype=np.int64)
        tracks[name] = _Track(t_ns, np.array([r.values for r in good], dtype=np.float64))
    first = next(iter(tracks.values()))
    shared = all(np.array_equal(t.t_ns, first.t_ns) for t in tracks.values())
    if shared:
        grid = first.t_ns
    else:
        start = min(int(t.t_ns[0]) for t in tracks.values())
        end = max(int(t.t_ns[-1]) for t in tracks.values())
        grid = np.arange(start, end + 1, TICK_NS, dtype=np.int64)
    columns: dict[str, Column] = {}
    for name, track in tracks.items():
        for i, signal in enumerate(known[name].signals):
            column = track.values[:, i]
            if not shared:
                column = _at(grid, track.t_ns, column, signal in ANGLES_THAT_WRAP)
            if not np.all(np.isnan(column)):
                columns[signal] = column.copy()
    columns |= _derived(columns, info.about.further, len(grid))
    return grid, {n: columns[n] for n in info.about.signals if n in columns}


def _derived(columns: Mapping[str, Column], further: Further, n: int) -> dict[str, Column]:
    """What the rig derives, where no frames have it, (n,) each; without those that have no value at all."""
    found: dict[str, Column] = {}
    for d in further.derived:
        given = {**columns, **found}
        value = d.formula.over({name: given.get(name, np.full(n, np.nan)) for name in d.formula.names})
        if np.isfinite(value).any():
            found[d.signal.name] = value * d.factor + d.offset
    return found


def _by_name(rows: list[Truth | Extra]) -> dict[str, _Track]:
    names = dict.fromkeys(name for row in rows for name in row.values)
    found = {}
    for name in names:
        has = [row for row in rows if name in row.values]
        t_ns = np.array([row.t_ns for row in has], dtype=np.int64)
        found[name] = _Track(t_ns, np.array([[row.values[name]] for row in has], dtype=np.float64))
    return found


def _at(grid: NDArray[np.int64], t_ns: NDArray[np.int64], values: Column, wraps: bool) -> Column:
    """Linear interpolation; NaN before the first and after the last value, and next to missing ones."""
    if np.array_equal(grid, t_ns):
        return values
    order = np.argsort(t_ns, kind="stable")
    t_ns, values = t_ns[order], values[order]
    if wraps:
        good = ~np.isnan(values)
        values = values.copy()
        values[good] = np.unwrap(values[good])
    start = t_ns[0]
    at = np.interp((grid - start).astype(np.float64), (t_ns - start).astype(np.float64), values, np.nan, np.nan)
    return np.asarray((at + np.pi) % (2 * np.pi) - np.pi if wraps else at, dtype=np.float64)


def points(path: Path) -> list[Point]:
    """The numbered test points marked in a flight: POINT_START and POINT_END, `count` the number, `detail` the note.

    A point without an end lasts to the end of the recording.
    """
    open_points: dict[int, Event] = {}
    closed: list[tuple[Event, int]] = []
    for row in read_rows(path, (Event,)):
        if isinstance(row, Event):
            if row.code is Code.POINT_START:
                open_points[row.count] = row
            elif row.code is Code.POINT_END and row.count in open_points:
                closed.append((open_points.pop(row.count), row.t_ns))
    if not closed and not open_points:
        return []
    times = row_times(path, _on_grid(path))
    zero, last = (int(times.min()), int(times.max())) if len(times) else (0, 0)
    closed += [(event, last) for event in open_points.values()]
    found = [Point(e.count, (e.t_ns - zero) * 1e-9, (end - zero) * 1e-9, e.detail) for e, end in closed]
    return sorted(found, key=lambda p: p.start_s)
