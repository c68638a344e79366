"""When a surface was flown in a record, and when it rested: forced parts, and parts that gusts alone moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.estimation.flight_record import FlightRecord

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

REST_S: Final = 2.0
"""A surface that rests so long has ended its input."""
MOVED: Final = 0.2
"""Share of its largest motion from which a surface is flown, not trimmed."""
QUIET: Final = 6.0
"""Standard deviations of its noise below which it rests whatever its largest motion is."""
TRIM_S: Final = 10.0
"""Over which the trim is a median."""
DIES_AWAY_S: Final = 4.0
"""After an input, its answer is no longer seen: two periods of a short period of 0.5 Hz, well damped."""


@dataclass(frozen=True, slots=True)
class FlownInput:
    """A time, s, in which the elevator was flown."""

    start_s: float
    end_s: float


def inputs_of(record: FlightRecord) -> tuple[FlownInput, ...]:
    """When the elevator was flown: it stood off its trim, or moved, by more than MOVED of the most it did."""
    if not record.has("elevator"):
        return ()
    de = record.motion["elevator"]
    good = np.isfinite(de)
    de = np.interp(record.t_s, record.t_s[good], de[good])
    off = np.abs(de - _running_median(de, round(TRIM_S / record.dt)))
    least = max(MOVED * float(off.max()), QUIET * record.noise["elevator"])
    at = np.flatnonzero(off > least)
    if not len(at):
        return ()
    breaks = np.flatnonzero(np.diff(record.t_s[at]) > REST_S)
    starts, ends = at[np.concatenate(([0], breaks + 1))], at[np.concatenate((breaks, [len(at) - 1]))]
    return tuple(FlownInput(float(record.t_s[a]), float(record.t_s[b])) for a, b in zip(starts, ends, strict=True))


def _running_median(x: Array, width: int) -> Array:
    """By medians of pieces half that wide, straight between their middles."""
    half = max(1, width // 2)
    pieces = [x[max(0, k - half) : k + half] for k in range(0, len(x) + half, half)]
    middles = np.minimum(np.arange(len(pieces)) * half, len(x) - 1)
    medians = [float(np.median(p)) if len(p) else float(x[-1]) for p in pieces]
    return np.asarray(np.interp(np.arange(len(x)), middles, medians))


def forced(record: FlightRecord, inputs: Sequence[FlownInput]) -> Flags:
    """(n,): rows within an input and its answer."""
    made = np.zeros(len(record.t_s), dtype=bool)
    for one in inputs:
        made |= (record.t_s >= one.start_s) & (record.t_s <= one.end_s + DIES_AWAY_S)
    return made
