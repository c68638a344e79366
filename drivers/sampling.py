"""Readings of a device as samples of its streams: times and counters made continuous, fields made signals in SI."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from drivers.codec import Reading, TimeReply
from drivers.probe_pressures import ProbeReader
from station.profile import Device
from station.rows import Sample

_Fields = tuple[tuple[str, Callable[[float], float]], ...]
"""Of a stream's signals: the field on the wire, and what makes SI of it."""


@dataclass(slots=True)
class _Timeline:
    """A wrapping device time made continuous: the candidate nearest to where the time passed since puts it."""

    device_ns: int
    t_ns: int

    def unwrap(self, raw_ns: int, wrap_ns: int, t_ns: int) -> int:
        expected = self.device_ns + t_ns - self.t_ns
        turns = (expected - raw_ns + wrap_ns // 2) // wrap_ns
        self.device_ns, self.t_ns = raw_ns + turns * wrap_ns, t_ns
        return self.device_ns


class Sampler:
    """Of one device. Readings of a message that came together are converted together, column by column."""

    def __init__(self, device: Device, tell: Callable[[str], None]) -> None:
        """`tell`: why something cannot be made of a probe's pressures."""
        self._tell = tell
        self._streams: dict[str | int, list[tuple[str, _Fields, ProbeReader | None]]] = {}
        for stream in device.streams:
            fields = tuple((channel.field, channel.converter()) for channel in stream.signals.values())
            probe = ProbeReader(stream) if stream.probe is not None else None
            self._streams.setdefault(stream.message, []).append((f"{device.name}.{stream.name}", fields, probe))
        self._timelines: dict[int, _Timeline] = {}
        self._seqs: dict[str | int, int] = {}
        self.is_stamped = False
        """Whether the device says when it measured what came last."""

    def samples(self, t_ns: int, readings: Sequence[Reading | TimeReply]) -> list[Sample]:
        """Of readings that arrived at `t_ns`; those of one stream follow one another."""
        messages: dict[str | int, list[Reading]] = {}
        for reading in readings:
            if isinstance(reading, Reading) and reading.message in self._streams:
                messages.setdefault(reading.message, []).append(reading)
        made: list[Sample] = []
        for message, like in messages.items():
            stamps = [self._stamp(t_ns, reading) for reading in like]
            seqs = [self._number(message, reading) for reading in like]
            self.is_stamped = stamps[-1] is not None
            for name, fields, probe in self._streams[message]:
                found: list[Mapping[str, float]] = [reading.fields for reading in like]
                if probe is not None:
                    found = [self._probed(name, probe, each) for each in found]
                columns = [[to_si(each.get(field, math.nan)) for each in found] for field, to_si in fields]
                # A message without one usable value (no fix yet) is as good as none: the stream goes stale.
                made += [
                    Sample(t_ns, name, device_ns, seq, values)
                    for device_ns, seq, values in zip(stamps, seqs, zip(*columns, strict=True), strict=True)
                    if not all(map(math.isnan, values))
                ]
        return made

    def _stamp(self, t_ns: int, reading: Reading) -> int | None:
        device_ns = reading.t_device_ns
        if device_ns is None or not reading.wrap_ns:
            return device_ns
        timeline = self._timelines.setdefault(reading.wrap_ns, _Timeline(device_ns, t_ns))
        return timeline.unwrap(device_ns, reading.wrap_ns, t_ns)

    def _number(self, message: str | int, reading: Reading) -> int | None:
        seq = reading.seq
        if seq is None or not reading.seq_wrap:
            return seq
        last = self._seqs.get(message, seq)
        self._seqs[message] = made = last + (seq - last) % reading.seq_wrap
        return made

    def _probed(self, name: str, probe: ProbeReader, fields: Mapping[str, float]) -> Mapping[str, float]:
        found, left_out = probe.read(fields)
        for why in left_out:
            self._tell(f"{name}: {why}")
        return found
