"""The bus: rows put by any thread, drained by the loop in the order of their station time."""

from __future__ import annotations

from collections import deque
from typing import Final

from station.rows import Code, Event, Rows

CAPACITY: Final = 200_000
"""Rows held while the loop is away; two minutes of a busy rig. Beyond it the oldest go, and that is counted."""


class Bus:
    """Many producers, one consumer. `put` never blocks and never raises."""

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._rows: deque[Rows] = deque()
        self._capacity = capacity
        self.dropped = 0

    def put(self, row: Rows) -> None:
        """Append a row; safe from any thread (deque.append is atomic)."""
        self._rows.append(row)

    def drain(self) -> list[Rows]:
        """All rows put so far, by station time; rows of one time stay in the order they were put."""
        waiting = len(self._rows)
        rows = [self._rows.popleft() for _ in range(waiting)]
        lost = waiting - self._capacity
        if lost > 0:
            self.dropped += lost
            kept = rows[lost:]
            kept.append(Event(kept[0].t_ns, "bus", Code.DROPPED, lost, "rows lost: the loop was away too long"))
            rows = kept
        rows.sort(key=_time)
        return rows


def _time(row: Rows) -> int:
    return row.t_ns
