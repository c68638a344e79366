"""The bus: rows put by any thread, drained by the loop in the order of their station time."""

from __future__ import annotations

import threading
from collections import deque
from typing import Final

from station.rows import Code, Event, RawBlock, Rows

CAPACITY: Final = 200_000
"""Rows held while the loop is away; two minutes of a busy rig. Beyond it the oldest go, and that is counted."""
RAW_BYTES: Final = 64 * 2**20
"""Raw bytes held meanwhile: a flooded link's blocks are 64 kB each."""


class Bus:
    """Many producers, one consumer. `put` never raises and waits for no more than a drain; what is held is bounded."""

    def __init__(self, capacity: int = CAPACITY, raw_bytes: int = RAW_BYTES) -> None:
        self._rows: deque[Rows] = deque()
        self._capacity, self._most_raw = capacity, raw_bytes
        self._raw = self._lost = 0
        self._counting = threading.Lock()
        self.dropped = 0

    def put(self, row: Rows) -> None:
        """Append a row; safe from any thread."""
        self._rows.append(row)
        if type(row) is RawBlock or len(self._rows) > self._capacity:
            with self._counting:
                if type(row) is RawBlock:
                    self._raw += len(row.data)
                while len(self._rows) > self._capacity or (self._raw > self._most_raw and self._rows):
                    self._take()
                    self._lost += 1

    def _take(self) -> Rows:
        row = self._rows.popleft()
        if type(row) is RawBlock:
            self._raw -= len(row.data)
        return row

    def drain(self) -> list[Rows]:
        """All rows put so far, by station time; rows of one time stay in the order they were put."""
        with self._counting:
            rows = [self._take() for _ in range(len(self._rows))]
            lost, self._lost = self._lost, 0
        if lost:
            self.dropped += lost
            first_ns = rows[0].t_ns if rows else 0
            rows.append(Event(first_ns, "bus", Code.DROPPED, lost, "rows lost: the loop was away too long"))
        rows.sort(key=_time)
        return rows


def _time(row: Rows) -> int:
    return row.t_ns
