"""Samples of many streams in rings, sorted by time, and their values at one instant; compiled. See alignment.py."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import TICK_NS
from station.numerics.angles import wrap
from station.rows import Quality

Array = NDArray[np.float64]
Whole = NDArray[np.int64]
Flags = NDArray[np.bool_]

HALF_TICK_NS: Final = TICK_NS // 2
FRESH, HELD, SUSPECT, MISSING = (int(quality) for quality in Quality)


class Rings(NamedTuple):
    """The newest samples of each stream: number `i` of stream `s` is at [s, i % length]."""

    times: Whole
    """(streams, length), ns, rising."""
    values: Array
    """(streams, length, signals)"""
    first: Whole
    """(streams,): samples before this number do not count."""
    kept: Whole
    """(streams,): how many there have been."""


class Layout(NamedTuple):
    """What is known of each stream."""

    times: Whole
    """(streams, 3): longest gap to bridge and longest time to hold, ns; and how many signals."""
    columns: Whole
    """(streams, signals): where each signal stands in a frame."""
    wraps: Whole
    """(streams, signals): whether it is an angle that wraps."""


def make_rings(streams: int, length: int, signals: int) -> Rings:
    """Empty."""
    return Rings(
        np.zeros((streams, length), dtype=np.int64),
        np.zeros((streams, length, signals)),
        np.zeros(streams, dtype=np.int64),
        np.zeros(streams, dtype=np.int64),
    )


@njit(cache=True)
def take(rings: Rings, given: Array, stamps: Whole, count: int) -> None:
    """Sort the first `count` samples of `given` (n, 2 + signals) in: stream, time, values; edits `rings`.

    `stamps`: the same memory as whole numbers, which stream and time are. A second sample of one time is dropped.
    """
    times, values, first, kept = rings
    length = times.shape[1]
    for n in range(count):
        s, t = stamps[n, 0], stamps[n, 1]
        end = kept[s]
        start = max(first[s], end - length + 1)
        at = end
        while at > start and times[s, (at - 1) % length] > t:
            at -= 1
        if at > start and times[s, (at - 1) % length] == t:
            continue
        for i in range(end, at, -1):
            times[s, i % length] = times[s, (i - 1) % length]
            for j in range(values.shape[2]):
                values[s, i % length, j] = values[s, (i - 1) % length, j]
        times[s, at % length] = t
        # By element: numba takes seconds to compile the check of two arrays' shapes.
        for j in range(values.shape[2]):
            values[s, at % length, j] = given[n, 2 + j]
        kept[s] = end + 1


@njit(cache=True)
def interpolate(rings: Rings, layout: Layout, is_stuck: Flags, t_ns: int, out: Array) -> None:
    """Fill `out` (3, signals of a frame) with values, ages in s and quality at `t_ns`; NaN and MISSING elsewhere."""
    times, values, first, kept = rings
    length = times.shape[1]
    known, columns, wraps = layout
    out[:2] = math.nan
    out[2] = MISSING
    for s in range(times.shape[0]):
        bridge_ns, stale_ns, signals = known[s]
        oldest, newest = max(first[s], kept[s] - length), kept[s] - 1
        at = newest
        while at >= oldest and times[s, at % length] > t_ns:
            at -= 1
        if at < oldest:
            continue
        if is_stuck[s]:
            for c in range(signals):
                out[2, columns[s, c]] = SUSPECT
            continue
        before_ns = times[s, at % length]
        age_ns = t_ns - before_ns
        low, high = at, at
        if age_ns > 0 and (at == newest or times[s, (at + 1) % length] - before_ns > bridge_ns):
            if age_ns > stale_ns:
                continue
        else:
            while low > oldest and t_ns - times[s, (low - 1) % length] <= HALF_TICK_NS:
                low -= 1
            high = at if age_ns == 0 else at + 1
            while high < newest and times[s, (high + 1) % length] - t_ns <= HALF_TICK_NS:
                high += 1
            age_ns = 0
        # The line through samples low to high: weights 1/n - slope (x - mean).
        n = high - low + 1
        total = squares = 0.0
        for i in range(low, high + 1):
            x = (times[s, i % length] - t_ns) * 1e-9
            total += x
            squares += x * x
        mean = total / n
        slope = mean / (squares - n * mean * mean) if n > 1 else 0.0
        for c in range(signals):
            origin = values[s, low % length, c]
            value = 0.0
            for i in range(low, high + 1):
                weight = 1.0 / n - slope * ((times[s, i % length] - t_ns) * 1e-9 - mean)
                seen = values[s, i % length, c]
                value += weight * (wrap(seen - origin) if wraps[s, c] else seen)
            if wraps[s, c]:
                value = wrap(origin + value)
            column = columns[s, c]
            if math.isnan(value):
                out[2, column] = SUSPECT
            else:
                out[0, column] = value
                out[1, column] = age_ns * 1e-9
                out[2, column] = FRESH if age_ns == 0 else HELD
