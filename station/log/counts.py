"""What a file of a recording holds, counted as it is written and kept at its end, so that an hour is told in a second.

Counts of files join to those of a recording. A file that was not completed has none, nor has one of an earlier station:
its rows are read and counted instead, to the same numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

import msgspec

from station.conventions import Stream
from station.rows import Event, Frame, MethodEstimate, Row, Sample, Tick

NAME: Final = "counts"
"""Of the metadata that hold them."""
KEPT: Final = 1000
"""Dropouts and events listed one by one; beyond that they are only counted."""
GAP: Final = 1.5
"""Nominal periods from which an interval is a gap."""


class StreamCounts(msgspec.Struct):
    """One stream: samples, and the intervals between them that are longer than they should be."""

    nominal_hz: float
    stale_s: float
    samples: int = 0
    first_ns: int = 0
    """Device time of the first and last sample; of arrival where the device has none."""
    last_ns: int = 0
    rate_hz: float = 0.0
    gaps: int = 0
    longest_gap_s: float = 0.0
    dropouts: list[tuple[int, float]] = msgspec.field(default_factory=list)
    """Station time (ns) at the end of each, and its length, s."""
    first_arrival_ns: int = 0

    def add(self, row: Sample) -> None:
        t_ns = row.t_ns if row.t_device_ns is None else row.t_device_ns
        if not self.samples:
            self.samples, self.first_ns, self.last_ns, self.first_arrival_ns = 1, t_ns, t_ns, row.t_ns
            return
        self._step(t_ns, row.t_ns)
        self.samples += 1
        self.last_ns = t_ns
        self._rated()

    def join(self, later: StreamCounts) -> None:
        if later.samples and self.samples:
            self._step(later.first_ns, later.first_arrival_ns)
        elif later.samples:
            self.first_ns, self.first_arrival_ns = later.first_ns, later.first_arrival_ns
        self.samples += later.samples
        self.gaps += later.gaps
        self.longest_gap_s = max(self.longest_gap_s, later.longest_gap_s)
        self.dropouts = (self.dropouts + later.dropouts)[:KEPT]
        if later.samples:
            self.last_ns = later.last_ns
            self._rated()

    def _step(self, t_ns: int, arrival_ns: int) -> None:
        step = (t_ns - self.last_ns) * 1e-9
        if self.nominal_hz > 0 and step > GAP / self.nominal_hz:
            self.gaps += 1
            self.longest_gap_s = max(self.longest_gap_s, step)
            if step > self.stale_s and len(self.dropouts) < KEPT:
                self.dropouts.append((arrival_ns, step))

    def _rated(self) -> None:
        if self.last_ns > self.first_ns:
            self.rate_hz = (self.samples - 1) / ((self.last_ns - self.first_ns) * 1e-9)


class Counts(msgspec.Struct):
    """One file, or several joined. Times are the station's, ns; `first_ns` None without rows."""

    streams: dict[str, StreamCounts]
    rows: int = 0
    first_ns: int | None = None
    """Of the first row, and the latest of all."""
    last_ns: int = 0
    ticks: int = 0
    ticks_missed: int = 0
    first_k: int | None = None
    last_k: int | None = None
    frames: int = 0
    methods: list[str] = msgspec.field(default_factory=list)
    event_counts: dict[str, int] = msgspec.field(default_factory=dict)
    events: list[tuple[int, str, str, int, str]] = msgspec.field(default_factory=list)
    """Time, source, code, count and detail of each."""
    goes_on: bool = False
    """Whether the flight's recording goes on in another file."""

    @classmethod
    def of(cls, streams: Iterable[Stream]) -> Counts:
        """None counted yet of these streams."""
        return cls({s.name: StreamCounts(s.rate_hz, s.stale_after_s) for s in streams})

    def add(self, row: Row) -> None:
        self.rows += 1
        t_ns = row.t_ns
        if self.first_ns is None:
            self.first_ns = t_ns
        if t_ns > self.last_ns:
            self.last_ns = t_ns
        if isinstance(row, Sample):
            stream = self.streams.get(row.stream)
            if stream is not None:
                stream.add(row)
        elif isinstance(row, Tick):
            self._tick(row.k)
        elif isinstance(row, Frame):
            self.frames += 1
        elif isinstance(row, MethodEstimate):
            if row.method not in self.methods:
                self.methods.append(row.method)
        elif isinstance(row, Event):
            self._event(row)

    def _tick(self, k: int) -> None:
        self.ticks += 1
        if self.last_k is None:
            self.first_k = k
        else:
            self.ticks_missed += max(0, k - self.last_k - 1)
        self.last_k = k

    def _event(self, row: Event) -> None:
        self.event_counts[row.code] = self.event_counts.get(row.code, 0) + row.times
        if len(self.events) < KEPT:
            self.events.append((row.t_ns, row.source, str(row.code), row.count, row.detail))

    def join(self, later: Counts) -> None:
        """Add those of the recording's next file."""
        for name, stream in self.streams.items():
            if name in later.streams:
                stream.join(later.streams[name])
        self.rows += later.rows
        self.first_ns = later.first_ns if self.first_ns is None else self.first_ns
        self.last_ns = max(self.last_ns, later.last_ns)
        self.ticks += later.ticks
        self.ticks_missed += later.ticks_missed
        if self.last_k is not None and later.first_k is not None:
            self.ticks_missed += max(0, later.first_k - self.last_k - 1)
        self.first_k = later.first_k if self.first_k is None else self.first_k
        self.last_k = self.last_k if later.last_k is None else later.last_k
        self.frames += later.frames
        self.methods = list(dict.fromkeys(self.methods + later.methods))
        for code, n in later.event_counts.items():
            self.event_counts[code] = self.event_counts.get(code, 0) + n
        self.events = (self.events + later.events)[:KEPT]
        self.goes_on = later.goes_on

    def as_metadata(self) -> dict[str, str]:
        """As they are kept."""
        return {"json": msgspec.json.encode(self).decode()}


def counted(metadata: Mapping[str, str]) -> Counts | None:
    """What was kept; None where it cannot be read."""
    try:
        return msgspec.json.decode(metadata["json"], type=Counts)
    except (KeyError, ValueError):
        return None
