"""A replay against what was recorded, bit for bit."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any, Final

import msgspec

from station.flight.loop import Beat
from station.rows import Rows

BAND: Final = 1e-12
"""Of a value, or of one where it is smaller: other kernels of the same sums may make as much; no sensor resolves it."""
SHOWN: Final = 5
"""Fields of the first difference that are told."""


class Comparison:
    """Counts, and the first difference in words ("" if there is none), one beyond BAND before all others."""

    def __init__(self) -> None:
        self.beats = self.rows = self.different = self.beyond = 0
        self.first = ""
        self.largest = 0.0
        """Difference of two numbers, over their size or over one; inf where words, status or kinds of rows differ."""

    def take(self, beat: Beat, made: Sequence[Rows]) -> None:
        """One tick: what was recorded of it, and what is made of it now."""
        self.beats += 1
        if not beat.recorded:
            return  # the station died between the tick and its estimates
        self.rows += len(beat.recorded)
        # A crash may have cut the last beat's rows short: what was recorded must match.
        for was, now in itertools.zip_longest(beat.recorded, made[: len(beat.recorded)]):
            if now is None or not same_bits(was, now):
                self.different += 1
                apart = deviation(was, now)
                self.largest = max(self.largest, apart)
                is_first_beyond = apart > BAND and not self.beyond
                self.beyond += apart > BAND
                if is_first_beyond or not self.first:
                    self.first = f"first difference at tick {beat.tick.k}: {difference(was, now)}"


def same_bits(one: Rows, other: Rows) -> bool:
    """Whether two rows are equal to the last bit (NaN equals NaN, -0.0 differs from 0.0)."""
    return msgspec.msgpack.encode(one) == msgspec.msgpack.encode(other)


def deviation(was: Rows, now: Rows | None) -> float:
    """The largest difference of two rows' numbers, over their size or over one; inf where anything else differs."""
    if type(was) is not type(now):
        return math.inf
    before, after = (dict(_fields("", msgspec.to_builtins(row))) for row in (was, now))
    if before.keys() != after.keys():
        return math.inf
    return max((_apart(one, after[name]) for name, one in before.items()), default=0.0)


def _apart(one: Any, other: Any) -> float:
    if not (isinstance(one, float) and isinstance(other, float)):
        return 0.0 if one == other else math.inf
    if math.isfinite(one) and math.isfinite(other):
        return abs(one - other) / max(1.0, abs(one), abs(other))
    return 0.0 if repr(one) == repr(other) else math.inf


def difference(was: Rows, now: Rows | None) -> str:
    """The fields in which two rows differ, recorded and now; both rows' kinds if they differ in that."""
    kind = type(was).__name__
    if type(was) is not type(now):
        return f"{kind} recorded, {'nothing' if now is None else type(now).__name__} now"
    before, after = (dict(_fields("", msgspec.to_builtins(row))) for row in (was, now))
    lines = [
        f"{name}: {before.get(name, '-')} recorded, {after.get(name, '-')} now"
        for name in dict.fromkeys((*before, *after))
        if repr(before.get(name)) != repr(after.get(name))
    ]
    more = [f"and {len(lines) - SHOWN} more fields"] if len(lines) > SHOWN else []
    return "\n".join([f"{kind} {getattr(was, 'method', '')}".strip(), *lines[:SHOWN], *more])


def _fields(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    """The leaves of nested rows; an item of a list is called by its name if it has one."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _fields(f"{path}.{key}" if path else key, item)
    elif isinstance(value, list | tuple):
        for k, item in enumerate(value):
            name = item.get("name", k) if isinstance(item, dict) else k
            yield from _fields(f"{path}[{name}]", item)
    else:
        yield path, value
