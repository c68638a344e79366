"""An emulated device's messages as a pure function of the truth: what is sent, when, with which stamp and faults.

Nothing here reads a clock or a port. Times are flight seconds from the announced start unless their name ends in _ns.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from drivers.codec import Reading
from drivers.faults import MessageFaults, clock_steps, faults_of, unplugged
from drivers.probe_pressures import ProbePressures
from station.conventions import ANGLES_THAT_WRAP
from station.profile import Card, Channel, Device, StreamProfile

Floats = NDArray[np.float64]

TRUTH_HZ = 200.0
_PHASE_S = 0.0008
"""Each device sends this much later than the one before it in the rig: real devices do not wake together."""


class Truth:
    """The last stretch of truth at TRUTH_HZ, the first row at flight time 0; grows at one end, forgets at the other."""

    def __init__(self, signals: Sequence[str], keep_s: float) -> None:
        self.signals = tuple(signals)
        self._wrap = np.array([s in ANGLES_THAT_WRAP for s in self.signals], dtype=np.bool_)
        self._keep = math.ceil(keep_s * TRUTH_HZ) + 2
        self._first = 0
        self._values: Floats = np.empty((0, len(self.signals)))

    @property
    def until_s(self) -> float:
        """Time of the newest row; before 0 if there is none."""
        return (self._first + len(self._values) - 1) / TRUTH_HZ

    def append(self, values: Floats) -> None:
        """The next rows, (n, signals)."""
        forget = max(0, len(self._values) - self._keep)
        self._values = np.concatenate((self._values[forget:], values))
        self._first += forget

    def at(self, t: Floats, columns: NDArray[np.int64]) -> Floats:
        """Values (n, columns) at times t (n,), linear between rows, the first row before it and the last one after."""
        x = np.clip(t * TRUTH_HZ - self._first, 0.0, len(self._values) - 1)
        i = np.minimum(x.astype(np.int64), max(0, len(self._values) - 2))
        low = self._values[i][:, columns]
        step = self._values[np.minimum(i + 1, len(self._values) - 1)][:, columns] - low
        wrap = self._wrap[columns]
        step[:, wrap] = np.remainder(step[:, wrap] + math.pi, 2 * math.pi) - math.pi
        out = low + (x - i)[:, None] * step
        turned = out[:, wrap]
        out[:, wrap] = np.where(np.abs(turned) > math.pi, np.remainder(turned + math.pi, 2 * math.pi) - math.pi, turned)
        return np.asarray(out)


@dataclass(frozen=True, slots=True)
class DeviceClock:
    """A device's own clock against the station's: an offset, a drift counted from the flight's start, and jumps."""

    start_ns: int
    offset_ns: int
    drift_ppm: float
    steps: tuple[tuple[float, float, float], ...] = ()
    """From, to (flight seconds), size (s)."""

    def at(self, station_ns: int) -> int:
        """Device time, ns, at a station time."""
        elapsed_ns = station_ns - self.start_ns
        jumps = sum(round(size * 1e9) for a, b, size in self.steps if a <= elapsed_ns * 1e-9 < b)
        return station_ns + self.offset_ns + round(elapsed_ns * self.drift_ppm * 1e-6) + jumps


def device_clock(index: int, device: Device, card: Card, start_ns: int) -> DeviceClock:
    """Device number `index` of the rig: its own multiple of the card's offset and drift, drifts alternating."""
    number = index + 1
    sign = 1 if index % 2 == 0 else -1
    return DeviceClock(
        start_ns,
        round(number * card.flight.device_clock_offset * 1e9),
        sign * number * card.flight.device_clock_drift_ppm,
        clock_steps(card.faults, device.name),
    )


@dataclass(frozen=True, slots=True)
class Outgoing:
    """A message on its way."""

    due_ns: int
    reading: Reading
    lost: bool
    garbage: bool


class MessageSource:
    """All messages of one kind from one device, in blocks. Deterministic given `seed`, however the blocks are cut."""

    def __init__(
        self,
        message: str | int,
        streams: Sequence[StreamProfile],
        rate_hz: float,
        truth: Truth,
        faults: MessageFaults,
        seed: Sequence[int],
        phase_s: float = 0.0,
        noise: bool = True,
    ) -> None:
        """`noise`: whether the rig's noise is added."""
        channels = [(s.latency, name, c) for s in streams for name, c in s.signals.items()]
        self.message = message
        self._rate = rate_hz
        self._phase = phase_s
        self._truth = truth
        self._latencies = sorted({latency for latency, _, _ in channels})
        self._columns = np.array([truth.signals.index(name) for _, name, _ in channels], dtype=np.int64)
        self._latency = np.array([latency for latency, _, _ in channels])
        self._channels = [c for _, _, c in channels]
        self._noise = np.array([c.noise_si() if noise else 0.0 for c in self._channels])
        self._rng = np.random.default_rng(seed)
        self._faults = faults
        self._k = 0
        self._seq = 0
        self._free_ns = 0

    def block(self, until_s: float, clock: DeviceClock) -> list[Outgoing]:
        """Every message not yet made that is stamped up to `until_s`, in order of sending."""
        end = math.floor((until_s - self._phase) * self._rate + 1e-9) + 1
        if end <= self._k:
            return []
        k = np.arange(self._k, end)
        self._k = end
        t = k / self._rate + self._phase
        fate = self._faults.apply(k, t, self._values(t))
        fields = [_field_values(c, fate.values[:, j]) for j, c in enumerate(self._channels)]
        names = [c.field for c in self._channels]
        out = []
        for i, (now, *values) in enumerate(zip(t.tolist(), *fields, strict=True)):
            if fate.silent[i]:
                continue
            t_ns = clock.start_ns + round(now * 1e9)
            # The link is a queue: what was held up is not overtaken.
            self._free_ns = max(self._free_ns, t_ns + round(float(fate.delay[i]) * 1e9))
            out.append(
                Outgoing(
                    self._free_ns,
                    Reading(self.message, clock.at(t_ns), self._seq, dict(zip(names, values, strict=True))),
                    bool(fate.lost[i]),
                    bool(fate.garbage[i]),
                )
            )
            self._seq += 1
        return out

    def _values(self, t: Floats) -> Floats:
        values = np.empty((len(t), len(self._columns)))
        for latency in self._latencies:
            own = np.flatnonzero(self._latency == latency)
            values[:, own] = self._truth.at(t - latency, self._columns[own])
        return np.asarray(values + self._noise * self._rng.standard_normal(values.shape))


def _field_values(channel: Channel, values: Floats) -> list[float]:
    """A signal's SI values as the field's, before rounding."""
    if channel.table is not None:
        return [channel.from_si(v) for v in values.tolist()]
    zero = channel.from_si(0.0)
    return [zero + (channel.from_si(1.0) - zero) * v for v in values.tolist()]


Encode = Callable[[Reading], bytes]


class DeviceScript:
    """All that a device will send, and when. Encoding is left to the moment of sending, to spread its cost."""

    def __init__(
        self,
        index: int,
        device: Device,
        card: Card,
        start_ns: int,
        encode: Encode,
        also: Mapping[str, float] = {},
        absent: Iterable[str] = (),
    ) -> None:
        """`also`: messages without signals and their rates (heartbeats). `absent`: signals that the flight lacks.

        A message none of whose signals are there is not sent.
        """
        self.clock = device_clock(index, device, card, start_ns)
        self.unplugged = unplugged(card.faults, device.name)
        grouped: dict[str | int, list[StreamProfile]] = {}
        for stream in device.streams:
            if not set(stream.signals) <= set(absent):
                grouped.setdefault(stream.message, []).append(stream)
        self.signals = tuple(dict.fromkeys(s for group in grouped.values() for stream in group for s in stream.signals))
        latest = max((s.latency for group in grouped.values() for s in group), default=0.0)
        self._truth = Truth(self.signals, keep_s=latest + 0.1)
        self._encode = encode
        self._probes = {m: [ProbePressures(s) for s in group if s.probe is not None] for m, group in grouped.items()}
        # A recording carries its sensors' own noise.
        noise = card.flight.source != "recording"
        seed = (card.flight.seed, index)
        rates = {message: max(s.rate for s in group) for message, group in grouped.items()} | dict(also)
        self._sources = []
        for number, (message, rate) in enumerate(rates.items()):
            group = grouped.get(message, [])
            signals = tuple(s for stream in group for s in stream.signals)
            mine = faults_of(card.faults, device.name, [s.name for s in group], signals)
            # What a message carries is lost together: the worst of its streams counts.
            share, length = max(((s.dropout, s.dropout_length) for s in group), default=(0.0, 0.0))
            gaps = (share, length * rate) if noise else (0.0, 0.0)
            luck = MessageFaults(mine, signals, np.random.default_rng((*seed, number, 1)), gaps)
            self._sources.append(
                MessageSource(message, group, rate, self._truth, luck, (*seed, number, 0), index * _PHASE_S, noise)
            )
        self._scramble = np.random.default_rng((*seed, len(rates), 2))

    def extend(self, values: Floats) -> list[Outgoing]:
        """Take the next rows of truth (n, signals) at TRUTH_HZ; return the messages they make, in order of sending."""
        self._truth.append(values)
        until = self._truth.until_s
        made = [m for source in self._sources for m in source.block(until, self.clock)]
        made.sort(key=lambda m: m.due_ns)
        return made

    def encode(self, m: Outgoing) -> bytes:
        """What goes onto the wire, empty if it is lost. To be called once for each message, in order of sending."""
        # A lost message is encoded all the same: it uses up a number where the encoder counts by itself.
        reading = m.reading
        for probe in self._probes.get(reading.message, ()):
            reading = msgspec.structs.replace(reading, fields=probe.fields_of(reading.fields))
        data = self._encode(reading)
        if m.garbage:
            data = self._scramble.bytes(len(data))
        return b"" if m.lost else data
