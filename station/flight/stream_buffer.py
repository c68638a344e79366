"""What the aligner keeps of one stream: its recent messages' times and counts, and what is wrong with it now."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Mapping
from operator import sub
from typing import Final

from station.conventions import SURFACES, TICK_NS, Signal, Stream
from station.flight.timebase import ClockMap
from station.rows import Code, Sample

STUCK_AFTER_S: Final = 0.25
NOISE_JUMP: Final = 8.0
"""Standard deviations of noise that two samples may differ by without it being a jump."""
SLOW_SHARE: Final = 0.8
LAW_OF_READS: Final = 3
LAW_OF_STILLNESS: Final = 5
"""From this clock law on a surface may keep still: surfaces alone are stuck only against noise that they showed."""
BY_CHANCE: Final = 1e-6
"""So seldom noise repeats itself for STUCK_AFTER_S, where a repetition counts as stuck."""
FEWEST_TURNS: Final = 10
TURNED_SHARE: Final = 1 / 3
"""Of the changes of a signal that noise turns back, at least: of white noise two thirds, of a motion hardly any."""
ALONE: Final = ((0, 1),)
"""Where a read of one sample begins and ends."""
MANY: Final = 4
"""Samples that are looked at together first."""


class Buffer:
    """Recent samples of one stream and what is wrong with it now."""

    def __init__(
        self, index: int, stream: Stream, signals: Mapping[str, Signal], noise: Mapping[str, float], law: int
    ) -> None:
        self.index = index
        self.stream = stream
        self.pack = struct.Struct(f"qq{len(stream.signals)}d").pack_into
        known = [signals[name] for name in stream.signals]
        self.limits = (
            tuple(signal.low for signal in known),
            tuple(signal.high for signal in known),
            tuple(signal.max_rate for signal in known),
            tuple(NOISE_JUMP * noise.get(name, 0.0) for name in stream.signals),
        )
        """Of each signal: least and greatest value, rate, and noise in a jump."""
        self.period_ns = round(1e9 / stream.rate_hz)
        # A stamp counted in steps is half a step early against the floor of arrivals, whether it is cut or rounded:
        # the floor is where cutting took nothing, or where rounding added half a step.
        self.latency_ns = round((stream.latency_s - 0.5 * stream.stamp_resolution_s) * 1e9)
        self.stale_ns = round(stream.stale_after_s * 1e9)
        self.bridge_ns = max(round(2.5 * self.period_ns), 50_000_000)
        """Longest gap between samples that may be interpolated over."""
        self.clock_state = "none"
        self.has_reads = law >= LAW_OF_READS
        self.clock = ClockMap(self.period_ns, index * 3 * TICK_NS, law)
        self.arrivals: deque[int] = deque()
        can_stick = any(noise.get(name, 0.0) > 0 for name in stream.signals)
        self.stuck_count_at = max(4, round(STUCK_AFTER_S * stream.rate_hz)) if can_stick else 0
        self.same = 0
        self.may_be_still = law >= LAW_OF_STILLNESS and set(stream.signals) <= set(SURFACES)
        self.still, self.changed, self.turned = 0, 0, 0
        """Messages that repeat the one before but for those that are stuck, that do not, and that turn it back."""
        self.steps: tuple[float, ...] = ()
        """From the message before."""
        self.suspect_until = [0] * len(stream.signals)
        self.waiting: list[Sample] = []
        """What has come since the last frame."""
        self.last_values: tuple[float, ...] | None = None
        self.last_t_ns = 0
        self.last_seq: int | None = None
        self.last_arrival_ns: int | None = None
        self.first_arrival_ns: int | None = None
        self.count = 0
        self.gaps = 0
        self.late_until = 0
        self.window_ns = max(400_000_000, 6 * self.period_ns)
        """Over which the rate is counted."""
        self.few = SLOW_SHARE * self.window_ns / self.period_ns - 1
        self.active: dict[Code, int] = {}
        """Conditions that hold, and since when."""

    def learn(self, values: tuple[float, ...], last: tuple[float, ...]) -> None:
        """Whether a surface's sensor shows noise, which a motion does not look like."""
        if values == last:
            self.still += self.same < self.stuck_count_at
            return
        steps = tuple(map(sub, values, last))
        self.changed += 1
        self.turned += any(a * b < 0 for a, b in zip(steps, self.steps, strict=False))
        self.steps = steps

    @property
    def is_stuck(self) -> bool:
        """Whether it repeats itself as what it measures does not."""
        if not 0 < self.stuck_count_at <= self.same:
            return False
        if not self.may_be_still:
            return True
        repeats = self.still / max(1, self.still + self.changed)
        shows_noise = self.turned >= max(FEWEST_TURNS, TURNED_SHARE * self.changed)
        return shows_noise and repeats**self.stuck_count_at < BY_CHANCE

    def reads(self, rows: list[Sample]) -> list[tuple[int, int]]:
        """Where those begin and end that came in one read, their device times in order: the last was the least late,
        and says when all were measured. One by one as the clock laws before 3 had it."""
        found = []
        begin = 0
        for i in range(1, len(rows)):
            row, before = rows[i], rows[i - 1]
            step_ns = -1 if row.t_device_ns is None else row.t_device_ns - (before.t_device_ns or 0)
            if not (self.has_reads and row.t_ns == before.t_ns and 0 < step_ns <= 2 * self.period_ns):
                found.append((begin, i))
                begin = i
        found.append((begin, len(rows)))
        return found

    def finds_nothing(self, rows: list[Sample], times: list[int]) -> bool:
        """Whether all of many samples lie so close together that the check of each has nothing to find."""
        if self.last_values is None:
            return False
        shortest = 0.5e-9 * self.period_ns
        first_ns = min(times)
        columns = zip(self.last_values, *[row.values for row in rows], strict=True)
        for column, low, high, max_rate, jitter, suspect_until in zip(
            columns, *self.limits, self.suspect_until, strict=True
        ):
            # NaN where the first is; others are passed over, as in the check.
            step = max(map(abs, map(sub, column[1:], column)))
            if not (low <= min(column) and max(column) <= high and step <= max_rate * shortest + jitter):
                return False
            if first_ns < suspect_until:
                return False
        return True
