"""A recording's rows as columns, a group for each time base, kept on disk while they are gathered: an hour's need no
more memory than a minute's."""

from __future__ import annotations

import tempfile
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from station.convert.fdata import EXTRA_UNITS
from station.convert.tracks import Column
from station.log import Table, metadata, read_rows, table
from station.log.messages import ESTIMATE_UNITS
from station.rows import AlphaEstimate, Frame, MethodEstimate, Sample, Truth

ROWS: Final = 16_384
"""Of a block."""
HELD: Final = 65_536
"""Numbers of a group in memory before they go to the disk: half a MiB."""
Block = tuple[Column, Mapping[str, Column]]
Units = Mapping[str, str]
Told = Callable[[int], None]
"""Called with the station time (ns) of what has been read."""


class Group:
    """Columns on one time base, SI: rows are added, and read back in blocks."""

    def __init__(self, name: str, units: Units) -> None:
        """`units` of each column, by its name."""
        self.name = name
        self.units = dict(units)
        self.rows = 0
        self._held = array("d")
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 closed with the group
        self._there = np.zeros(len(units), dtype=bool)
        self._shown: Units | None = None

    def add(self, t_s: float, values: Sequence[float]) -> None:
        """One row, with a value for each column."""
        self._held.append(t_s)
        self._held.extend(values)
        self.rows += 1
        if len(self._held) >= HELD:
            self._flush()

    def widen(self, units: Units) -> None:
        """More columns, of which the rows so far have none."""
        blocks = [np.column_stack([t_s, *columns.values()]) for t_s, columns in self.blocks()]
        more = len(units) - len(self.units)
        self.units = dict(units)
        self._there = np.concatenate([self._there, np.zeros(more, dtype=bool)])
        self._file.seek(0)
        self._file.truncate()
        for block in blocks:
            wide = np.column_stack([block, np.full((len(block), more), np.nan)])
            self._file.write(wide.astype("<f8").tobytes())

    def keep_only_known(self) -> None:
        """Without the columns that are missing throughout."""
        self._flush()
        known = [n for n, there in zip(self.units, self._there.tolist(), strict=True) if there]
        self._shown = {n: self.units[n] for n in known}

    @property
    def columns(self) -> Units:
        """Unit of each column that is read back, by its name."""
        return self.units if self._shown is None else self._shown

    def blocks(self) -> Iterator[Block]:
        """Times (n,) and columns (n,) of up to ROWS rows after the other."""
        self._flush()
        width = 1 + len(self.units)
        self._file.seek(0)
        while data := self._file.read(ROWS * width * 8):
            matrix = np.frombuffer(data).reshape(-1, width)
            named = {n: matrix[:, i + 1].copy() for i, n in enumerate(self.units)}
            yield matrix[:, 0].copy(), {n: named[n] for n in self.columns}

    def whole(self) -> Block:
        """All of it in memory."""
        blocks = list(self.blocks())
        t_s = np.concatenate([np.zeros(0), *(t for t, _ in blocks)])
        return t_s, {n: np.concatenate([c[n] for _, c in blocks]) for n in self.columns}

    def close(self) -> None:
        self._file.close()

    def _flush(self) -> None:
        if self._held:
            matrix = np.frombuffer(self._held).reshape(-1, 1 + len(self.units))
            self._there |= ~np.isnan(matrix[:, 1:]).all(axis=0)
            self._file.seek(0, 2)
            self._file.write(matrix.tobytes())
            self._held = array("d")


class Gathered:
    """Groups of a recording: the aligned "table" first, then streams at their own rate, "alpha", methods, "truth", and
    of an import "extra"."""

    def __init__(self, path: Path, told: Told = lambda _: None) -> None:
        """Raises LogError where there are neither frames nor samples. `zero_ns`: station time that times count from."""
        self._path = path
        self._told = told
        info = metadata(path)
        self._streams = {s.name: s for s in info.streams}
        self._signals = info.about.signals
        self.groups: dict[str, Group] = {}
        first = next(read_rows(path, (Frame,)), None)
        flown = None if first is not None else table(path)
        self.zero_ns = first.t_ns if first is not None else flown.t0_ns if flown is not None else 0
        self._is_single = flown is not None and flown.record_ns is not None
        if flown is not None:
            self._of_table(flown)
        self._gather()

    def in_order(self) -> list[Group]:
        """The table first."""
        named = {"table": 0, "alpha": 2, "truth": 4, "extra": 5}
        order = {name: i for i, name in enumerate(self._streams)}

        def key(group: Group) -> tuple[int, int]:
            return named.get(group.name, 3 if group.name.startswith("method ") else 1), order.get(group.name, 0)

        return sorted(self.groups.values(), key=key)

    def close(self) -> None:
        for group in self.groups.values():
            group.close()

    def _group(self, name: str, units: Callable[[], Units]) -> Group:
        if name not in self.groups:
            self.groups[name] = Group(name, units())
        return self.groups[name]

    def _gather(self) -> None:
        kinds = (Frame, Sample, AlphaEstimate, MethodEstimate, Truth)
        for count, row in enumerate(read_rows(self._path, kinds)):
            t_s = (row.t_ns - self.zero_ns) / 1e9
            if not count % ROWS:
                self._told(row.t_ns)
            if isinstance(row, Sample):
                self._sample(row, t_s)
            elif isinstance(row, Frame):
                group = self._group("table", lambda: {n: s.unit for n, s in self._signals.items()})
                group.add(t_s, row.values)
            elif isinstance(row, AlphaEstimate):
                values = [getattr(row, n) for n in ESTIMATE_UNITS]
                self._group("alpha", lambda: {**ESTIMATE_UNITS, "valid": "1"}).add(t_s, [*values, float(row.valid)])
            elif isinstance(row, MethodEstimate):
                self._method(row, t_s)
            elif isinstance(row, Truth) and "table" in self.groups and "truth" not in self.groups:
                self._truth()
        if "table" in self.groups and not self._is_single:
            self.groups["table"].keep_only_known()

    def _sample(self, row: Sample, t_s: float) -> None:
        stream = self._streams.get(row.stream)
        if self._is_single or stream is None or len(row.values) != len(stream.signals):
            return
        units = {**{n: self._signals[n].unit for n in stream.signals}, "time_device": "s", "quality": "1"}
        device = np.nan if row.t_device_ns is None else row.t_device_ns / 1e9
        self._group(row.stream, lambda: units).add(t_s, [*row.values, device, float(row.quality)])

    def _method(self, row: MethodEstimate, t_s: float) -> None:
        names = [n for p in row.parameters for n in (p.name, f"{p.name}_sd")]
        group = self._group(f"method {row.method}", dict)
        if len(names) > len(group.units):
            group.widen(dict.fromkeys(names, "1/rad"))
        values = [v for p in row.parameters for v in (p.value, p.sd)]
        group.add(t_s, values + [np.nan] * (len(group.units) - len(values)))

    def _truth(self) -> None:
        """At the times of the table."""
        self._fill("truth", (flown := table(self._path)).t_s, flown.truth, {n: self._unit(n) for n in flown.truth})

    def _of_table(self, flown: Table) -> None:
        """Of a recording without frames."""
        times = flown.t_s if flown.record_ns is None else flown.record_ns / 1e9
        self._fill("table", times, flown.columns, {n: self._unit(n) for n in flown.columns})
        if flown.truth:
            self._fill("truth", flown.t_s, flown.truth, {n: self._unit(n) for n in flown.truth})
        if flown.extra:
            self._fill("extra", times, flown.extra, {n: EXTRA_UNITS.get(n, "") for n in flown.extra})

    def _fill(self, name: str, t_s: Column, columns: Mapping[str, Column], units: Units) -> None:
        group = self._group(name, lambda: units)
        for row in zip(t_s.tolist(), *(c.tolist() for c in columns.values()), strict=True):
            group.add(row[0], row[1:])

    def _unit(self, name: str) -> str:
        return self._signals[name].unit if name in self._signals else ""
