"""A replay against what was recorded, bit for bit."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any, Final

import msgspec

from station.flight.loop import Beat
from station.rows import Code, Event, MethodEstimate, ParamEstimate, Rows, Status

BAND: Final = 1e-12
"""Of a number, or of one where it is smaller: other kernels of the same sums may make as much, no sensor sees it."""
SHARE_OF_SD: Final = 1e-6
"""Of a derivative's standard error. Equation error magnifies rounding a millionfold: 6e-10 of a derivative was measured
between OpenBLAS's kernels for Haswell and for AVX-512."""
SHOWN: Final = 5
"""Fields of the first difference that are told."""


class Comparison:
    """Counts, and the first difference in words ("" if there is none), one that is no rounding before all others."""

    def __init__(self) -> None:
        self.beats = self.rows = self.different = self.beyond = 0
        self.first = ""
        self.gap_k: int | None = None
        """The first tick before which the recording lacks rows: the loop did not say that it left out any."""
        self.before_gap = 0
        """Rows that differ before it; after it what the estimators had had cannot be repeated."""
        self._next_k = 0

    def take(self, beat: Beat, made: Sequence[Rows]) -> None:
        """One tick: what was recorded of it, and what is made of it now."""
        self.beats += 1
        left_out = sum(e.count for e in beat.rows if isinstance(e, Event) and e.code is Code.OVERRUN)
        if self.gap_k is None and beat.tick.k > self._next_k + left_out:
            self.gap_k = beat.tick.k
        self._next_k = beat.tick.k + 1
        if not beat.recorded:
            return  # the station died between the tick and its estimates
        self.rows += len(beat.recorded)
        # A crash may have cut the last beat's rows short: what was recorded must match.
        for was, now in itertools.zip_longest(beat.recorded, made[: len(beat.recorded)]):
            if now is None or not same_bits(was, now):
                self.different += 1
                self.before_gap += self.gap_k is None
                is_beyond = not is_rounding(was, now)
                if not self.first or (is_beyond and not self.beyond):
                    self.first = f"first difference at tick {beat.tick.k}: {difference(was, now)}"
                self.beyond += is_beyond


def same_bits(one: Rows, other: Rows) -> bool:
    """Whether two rows are equal to the last bit (NaN equals NaN, -0.0 differs from 0.0)."""
    return msgspec.msgpack.encode(one) == msgspec.msgpack.encode(other)


def is_rounding(was: Rows, now: Rows | None) -> bool:
    """Whether another machine's kernels may make one row of the other: same kind, words and status, numbers in BAND,
    derivatives within SHARE_OF_SD. The numbers of derivatives that are not estimated are no results."""
    if isinstance(was, MethodEstimate) and isinstance(now, MethodEstimate):
        if len(was.parameters) != len(now.parameters) or _without_numbers(was) != _without_numbers(now):
            return False
        return all(_is_same_result(p, q) for p, q in zip(was.parameters, now.parameters, strict=True))
    if now is None or type(was) is not type(now):
        return False
    before, after = (dict(_fields("", msgspec.to_builtins(row))) for row in (was, now))
    return before.keys() == after.keys() and all(_is_near(one, after[name]) for name, one in before.items())


def _without_numbers(row: MethodEstimate) -> tuple[object, ...]:
    words = tuple((p.name, p.status, p.why) for p in row.parameters)
    return row.t_ns, row.method, row.applicable, row.why, words


def _is_same_result(one: ParamEstimate, other: ParamEstimate) -> bool:
    if one.status is not Status.ESTIMATED:
        return True
    return max(abs(one.value - other.value), abs(one.sd - other.sd)) <= SHARE_OF_SD * one.sd


def _is_near(one: object, other: object) -> bool:
    if isinstance(one, float) and isinstance(other, float) and math.isfinite(one) and math.isfinite(other):
        return abs(one - other) <= BAND * max(1.0, abs(one), abs(other))
    return repr(one) == repr(other)


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
