"""How long ticks took, of a flight's last half hour."""

from __future__ import annotations

from typing import Final

import numpy as np

KEPT: Final = 90_000
"""Ticks: half an hour of them."""


class TickTimes:
    """Takes its memory when made and none in flight: a Python integer a tick was 7 MiB an hour."""

    def __init__(self, kept: int = KEPT) -> None:
        self._took_ns = np.full(kept, -1, dtype=np.int64)
        """A ring; filled, so that its pages are there before the flight."""
        self.ticks = 0

    def note(self, took_ns: int) -> None:
        """One tick more, done so long after it was due."""
        self._took_ns[self.ticks % len(self._took_ns)] = took_ns
        self.ticks += 1

    def words(self) -> str:
        """Nothing before the first tick."""
        if not self.ticks:
            return ""
        middle, late, worst = np.percentile(self._took_ns[: self.ticks] * 1e-6, [50, 99, 100])
        return f"ticks done after {middle:.2f} ms (median), {late:.2f} ms (p99), {worst:.1f} ms (worst)"
