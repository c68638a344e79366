"""Samples of many streams -> one frame per tick, and the health of each stream.

A frame at time T holds each signal at T: the straight line through the samples within half a tick of T where there
are several (a stream faster than the ticks), else between the two samples around T. Either way the group delay is zero
for every stream; what 20 ms of averaging takes at 2 Hz is 0.3 %. Where the newest sample is older than T the value is
held and says how old it is; where it is too old, or suspect, it is NaN. Each stream is shifted by its own latency from
the rig. Pure: the same samples and ticks give the same frames and events.

Samples are checked and streams watched from the first row on. Interpolation is compiled: where that is still to be
done, `hold` the frames, which are then empty, and `begin` them when it is.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import ANGLES_THAT_WRAP, CLOCK_LAW, TICK_HZ, Stream
from station.flight.derived_signals import DerivedSignals
from station.flight.stream_buffer import ALONE, MANY, SLOW_SHARE, Buffer
from station.profile import NOTHING, Further
from station.rows import Code, Event, Frame, Health, Quality, Rows, Sample, StreamHealth, TimeSync

if TYPE_CHECKING:
    from station.flight import rings

KEEP_S: Final = 3.0
PENDING: Final = 128
"""Samples that wait for a frame before they are sorted in by themselves."""
LATE_NS: Final = 50_000_000
SUSPECT_AFTER_JUMP_NS: Final = 1_000_000_000
REPEAT_NS: Final = 500_000_000
"""Like events of one source are told at once and then counted, at most one row in this time."""
WORDS_IN_S_MS: Final = 1000.0
"""A jump from here on is told in seconds."""
NAN: Final = math.nan


class _Interpolation:
    """Samples in rings, sorted by time, and their values at one instant: the compiled part."""

    def __init__(self, buffers: list[Buffer], column: Mapping[str, int]) -> None:
        """`column` of each measured signal."""
        from station.flight import rings  # brings numba

        self._take, self._interpolate = rings.take, rings.interpolate
        width = max((len(b.stream.signals) for b in buffers), default=1)
        keep = max((math.ceil(KEEP_S * b.stream.rate_hz) for b in buffers), default=1)
        self._rings: rings.Rings = rings.make_rings(len(buffers), keep + 64, width)
        # Samples since the last frame: stream and time as whole numbers, then values.
        self._pending = np.zeros((PENDING, 2 + width))
        self._row_bytes = self._pending.strides[0]
        self._waiting = 0
        self._layout = rings.Layout(
            np.array([(b.bridge_ns, b.stale_ns, len(b.stream.signals)) for b in buffers], np.int64).reshape(-1, 3),
            _table([[column[name] for name in b.stream.signals] for b in buffers], width),
            _table([[name in ANGLES_THAT_WRAP for name in b.stream.signals] for b in buffers], width),
        )
        self._out = np.empty((3, len(column)))
        # Compiled now: no tick of a flight has to.
        self.at(0, np.zeros(len(buffers), dtype=np.bool_))

    def add(self, buffer: Buffer, t_ns: int, values: tuple[float, ...]) -> None:
        if self._waiting == PENDING:
            self._sort_in()
        buffer.pack(self._pending.data, self._waiting * self._row_bytes, buffer.index, t_ns, *values)
        self._waiting += 1

    def forget(self, buffer: Buffer) -> None:
        """A stream's samples so far count no more."""
        self._sort_in()
        self._rings.first[buffer.index] = self._rings.kept[buffer.index]

    def at(self, t_ns: int, is_stuck: NDArray[np.bool_]) -> list[list[float]]:
        """Values, ages and quality of all measured signals."""
        self._sort_in()
        self._interpolate(self._rings, self._layout, is_stuck, t_ns, self._out)
        made: list[list[float]] = self._out.tolist()
        return made

    def _sort_in(self) -> None:
        self._take(self._rings, self._pending, self._pending.view(np.int64), self._waiting)
        self._waiting = 0


class Aligner:
    """Takes rows in arrival order and gives a frame, events and (once a second) health for each tick."""

    def __init__(
        self,
        streams: Iterable[Stream],
        noise: Mapping[str, float],
        clock_law: int = CLOCK_LAW,
        further: Further = NOTHING,
    ) -> None:
        """`noise`: standard deviation of each signal, SI; a stream with a noisy signal that repeats itself is stuck.
        `clock_law`: that of the recording which is replayed. `further`: what the rig declares."""
        known = further.signals
        self._buffers = {s.name: Buffer(i, s, known, noise, clock_law) for i, s in enumerate(streams)}
        self._derived = DerivedSignals(further) if further.derived else None
        self._columns = {name: i for name, i in further.index.items() if i < len(known) - len(further.derived)}
        self._nothing = (NAN,) * len(known), (NAN,) * len(known), (int(Quality.MISSING),) * len(known)
        self._interpolation: _Interpolation | None = None
        self._early: deque[tuple[Buffer, int, tuple[float, ...]]] | None = None
        """Samples that wait for `begin`, while frames are held."""
        self._is_stuck = np.zeros(len(self._buffers), dtype=np.bool_)
        self._by_device: dict[str, list[Buffer]] = {}
        for buffer in self._buffers.values():
            self._by_device.setdefault(buffer.stream.device, []).append(buffer)
        self._events: list[Event] = []
        self._told: dict[tuple[str, Code], tuple[int, int]] = {}
        self._bad: dict[str, int] = {}
        self._lost: dict[str, int] = {}
        self._start_ns: int | None = None
        self._overruns = 0
        self._dropped = 0

    def hold(self) -> None:
        """Until `begin`, frames are empty and nothing compiled is needed; to be called before the first row."""
        rates = sum(b.stream.rate_hz for b in self._buffers.values())
        self._early = deque(maxlen=math.ceil(KEEP_S * rates) + PENDING)

    def begin(self) -> None:
        """Make frames from now on, with what has come in the last seconds. Compiles, unless the cache has it."""
        self._interpolation = _Interpolation(list(self._buffers.values()), self._columns)
        early, self._early = self._early or (), None
        for buffer, t_ns, values in early:
            self._interpolation.add(buffer, t_ns, values)

    def accept(self, row: Rows) -> None:
        """Take one row; all but samples, clock exchanges and events pass by."""
        if type(row) is Sample:
            buffer = self._buffers.get(row.stream)
            if buffer is not None:
                buffer.waiting.append(row)
        elif isinstance(row, TimeSync):
            self._exchange(row)
        elif isinstance(row, Event):
            if row.code is Code.CRC:
                self._bad[row.source] = self._bad.get(row.source, 0) + row.count
            elif row.code is Code.GAP:
                self._lost[row.source] = self._lost.get(row.source, 0) + row.count
            elif row.code is Code.OVERRUN:
                self._overruns += row.count
            elif row.code is Code.DROPPED:
                self._dropped += row.count

    def frame(self, k: int, tick_ns: int, t_ns: int) -> tuple[Frame, list[Event], Health | None]:
        """The frame at `t_ns` as of tick `k` at `tick_ns`; what changed since the last tick; health once a second."""
        if self._start_ns is None:
            self._start_ns = tick_ns
        for buffer in self._buffers.values():
            if buffer.waiting:
                self._take(buffer)
            self._watch(buffer, tick_ns)
        if self._early is not None:
            frame = Frame(t_ns, k, *self._nothing)
        else:
            values, ages, marks = self._made().at(t_ns, self._is_stuck)
            quality = [*map(int, marks)]
            if self._derived is not None:
                self._events += self._derived.add(t_ns, values, ages, quality)
            frame = Frame(t_ns, k, tuple(values), tuple(ages), tuple(quality))
        self._tell_counted(tick_ns)
        events, self._events = self._events, []
        health = self._health(tick_ns) if k % TICK_HZ == 0 else None
        return frame, events, health

    def _made(self) -> _Interpolation:
        if self._interpolation is None:
            self.begin()
        assert self._interpolation is not None
        return self._interpolation

    # --- samples in

    def _exchange(self, row: TimeSync) -> None:
        for buffer in self._by_device.get(row.device, ()):
            if buffer.waiting:
                self._take(buffer)
            buffer.clock.exchange(row.offset_ns, row.round_trip_ns, row.t_ns)

    def _take(self, buffer: Buffer) -> None:
        """All that waits of one stream: when each was measured, what is lost between them, what cannot be true."""
        rows, buffer.waiting = buffer.waiting, []
        times: list[int] = []
        kept = 0
        for begin, end in buffer.reads(rows) if len(rows) > 1 else ALONE:
            last = rows[end - 1]
            arrival_ns, device_ns = last.t_ns, last.t_device_ns
            if device_ns is None:
                times.append(arrival_ns - buffer.latency_ns)
                continue
            mapped = buffer.clock.update(device_ns, arrival_ns)
            if mapped.stepped:
                self._keep(buffer, rows[kept:begin], times[kept:])
                kept = begin
                self._forget(buffer, arrival_ns)
            elif mapped.jump_ns:
                by = -1e-6 * mapped.jump_ns
                words = f"{by:.1f} ms" if abs(by) < WORDS_IN_S_MS else f"{1e-3 * by:.1f} s"
                jumped = f"device clock jumped by {words} and is followed"
                self._count(arrival_ns, buffer.stream.name, Code.CLOCK_STEP, 1, jumped)
            if mapped.strays:
                wrong = "device times that no clock shows; their arrival counts"
                self._count(arrival_ns, buffer.stream.name, Code.CLOCK_STEP, mapped.strays, wrong)
            if mapped.late_ns > LATE_NS:
                buffer.late_until = arrival_ns + REPEAT_NS
            if buffer.clock.state != buffer.clock_state:
                buffer.clock_state = buffer.clock.state
                self._events.append(Event(arrival_ns, buffer.stream.name, Code.CLOCK_STATE, 1, buffer.clock_state))
            t_ns = mapped.t_ns - buffer.latency_ns
            if end - begin > 1:
                times += [t_ns - device_ns + (row.t_device_ns or 0) for row in rows[begin : end - 1]]
            times.append(t_ns)
        self._keep(buffer, rows[kept:] if kept else rows, times[kept:] if kept else times)

    def _forget(self, buffer: Buffer, t_ns: int) -> None:
        """What has come so far counts no more: its clock has leapt."""
        self._count(t_ns, buffer.stream.name, Code.CLOCK_STEP, 1, "device clock jumped; synchronising again")
        if self._early is not None:
            self._early = deque((s for s in self._early if s[0] is not buffer), self._early.maxlen)
        else:
            self._made().forget(buffer)
        buffer.last_values = None

    def _keep(self, buffer: Buffer, rows: list[Sample], times: list[int]) -> None:
        if not rows:
            return
        buffer.count += len(rows)
        buffer.last_arrival_ns = rows[-1].t_ns
        if buffer.first_arrival_ns is None:
            buffer.first_arrival_ns = rows[0].t_ns
        self._check_order(buffer, rows)
        is_plain = len(rows) >= MANY and buffer.finds_nothing(rows, times)
        if is_plain:
            buffer.last_values, buffer.last_t_ns = rows[-1].values, times[-1]
        for row, t_ns in zip(rows, times, strict=True):
            values = row.values if is_plain else self._check(buffer, row, t_ns)
            if self._early is not None:
                self._early.append((buffer, t_ns, values))
            else:
                self._made().add(buffer, t_ns, values)

    def _check_order(self, buffer: Buffer, rows: list[Sample]) -> None:
        """What is lost between samples, and whether they repeat themselves."""
        last, last_values, arrived = buffer.last_seq, buffer.last_values, buffer.arrivals.append
        for row in rows:
            arrived(row.t_ns)
            if (seq := row.seq) is not None:
                if last is not None and (gap := seq - last - 1) > 0:
                    buffer.gaps += gap
                    self._count(row.t_ns, buffer.stream.name, Code.GAP, gap, "messages lost by sequence number")
                last = seq
            buffer.same = buffer.same + 1 if row.values == last_values else 0
            if buffer.may_be_still and last_values is not None:
                buffer.learn(row.values, last_values)
            last_values = row.values
        buffer.last_seq = last

    def _check(self, buffer: Buffer, row: Sample, t_ns: int) -> tuple[float, ...]:
        """The values with those that cannot be true as NaN."""
        values, last = row.values, buffer.last_values
        masked: list[float] | None = None
        dt = max((t_ns - buffer.last_t_ns) * 1e-9, 0.5e-9 * buffer.period_ns)
        low, high, max_rate, jitter = buffer.limits
        suspect_until = buffer.suspect_until
        for i, value in enumerate(values):
            if not low[i] <= value <= high[i]:
                signal = buffer.stream.signals[i]
                if not math.isnan(value):
                    is_said = math.isfinite(value)
                    wrong = f"= {value:.4g} cannot be true" if is_said else "is beyond what its message carries"
                    self._count(row.t_ns, buffer.stream.name, Code.RANGE, 1, f"{signal} {wrong}")
                masked = masked or list(values)
                masked[i] = NAN
                continue
            if last is not None and math.inf > abs(value - last[i]) > max_rate[i] * dt + jitter[i]:
                suspect_until[i] = t_ns + SUSPECT_AFTER_JUMP_NS
                detail = f"{buffer.stream.signals[i]} jumped by {value - last[i]:.4g}"
                self._count(row.t_ns, buffer.stream.name, Code.JUMP, 1, detail)
            if t_ns < suspect_until[i]:
                masked = masked or list(values)
                masked[i] = NAN
        buffer.last_values = values
        buffer.last_t_ns = t_ns
        return values if masked is None else tuple(masked)

    # --- health

    def _watch(self, buffer: Buffer, now_ns: int) -> None:
        arrived_ns, active, arrivals = buffer.last_arrival_ns, buffer.active, buffer.arrivals
        never = arrived_ns is None
        silent_ns = now_ns - ((self._start_ns or now_ns) if arrived_ns is None else arrived_ns)
        stale = silent_ns > (2_000_000_000 if never else buffer.stale_ns)
        if stale is not (Code.STALE in active):
            self._turn(now_ns, buffer, Code.STALE, f"nothing for {silent_ns * 1e-9:.2f} s")
        stuck = buffer.is_stuck and not stale
        if stuck is not (Code.STUCK in active):
            self._is_stuck[buffer.index] = stuck
            self._turn(now_ns, buffer, Code.STUCK, "the same values again and again")
        if (now_ns < buffer.late_until) is not (Code.LATE in active):
            self._turn(now_ns, buffer, Code.LATE, "messages arrive late by their own clock")
        since_ns = now_ns - buffer.window_ns
        while arrivals and arrivals[0] < since_ns:
            arrivals.popleft()
        settled = buffer.first_arrival_ns is not None and buffer.first_arrival_ns < since_ns
        slow = settled and not stale and len(arrivals) < buffer.few
        if slow is not (Code.SLOW in active):
            self._turn(now_ns, buffer, Code.SLOW, f"below {SLOW_SHARE:.0%} of {buffer.stream.rate_hz:g} Hz")

    def _turn(self, t_ns: int, buffer: Buffer, code: Code, detail: str) -> None:
        """Tell that a condition begins, or that it ends."""
        since_ns = buffer.active.pop(code, None)
        if since_ns is None:
            buffer.active[code] = t_ns
            self._events.append(Event(t_ns, buffer.stream.name, code, 1, detail))
        else:
            over = f"{code} over after {(t_ns - since_ns) * 1e-9:.2f} s"
            self._events.append(Event(t_ns, buffer.stream.name, Code.FRESH, 1, over))

    def _count(self, t_ns: int, source: str, code: Code, count: int, detail: str) -> None:
        """Tell at once the first time, then count until `REPEAT_NS` have passed."""
        key = (source, code)
        if key in self._told:
            told_ns, waiting = self._told[key]
            self._told[key] = (told_ns, waiting + count)
        else:
            self._told[key] = (t_ns, 0)
            self._events.append(Event(t_ns, source, code, count, detail))

    def _tell_counted(self, now_ns: int) -> None:
        for key, (told_ns, waiting) in list(self._told.items()):
            if now_ns - told_ns >= REPEAT_NS:
                if waiting:
                    self._told[key] = (now_ns, 0)
                    self._events.append(Event(now_ns, key[0], key[1], waiting, "more of the same"))
                else:
                    del self._told[key]

    def _health(self, now_ns: int) -> Health:
        rows = []
        for name, b in self._buffers.items():
            age_s = max(now_ns - b.last_arrival_ns, 0) * 1e-9 if b.last_arrival_ns is not None else NAN
            rows.append(
                StreamHealth(
                    stream=name,
                    device=b.stream.device,
                    rate_hz=len(b.arrivals) / (1e-9 * b.window_ns),
                    age_s=age_s,
                    clock=b.clock.state,
                    offset_s=b.clock.offset_s,
                    drift_ppm=b.clock.drift_ppm,
                    samples=b.count,
                    gaps=b.gaps + self._lost.get(b.stream.device, 0),
                    bad=self._bad.get(b.stream.device, 0),
                    alive=b.last_arrival_ns is not None and Code.STALE not in b.active,
                )
            )
        return Health(now_ns, tuple(rows), self._dropped, self._overruns)


def _table(rows: list[list[int]] | list[list[bool]], width: int) -> rings.Whole:
    """Of each stream's signals; 0 where a stream has fewer."""
    return np.array([[*row, *[0] * (width - len(row))] for row in rows], dtype=np.int64).reshape(-1, width)
