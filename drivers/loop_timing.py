"""How well a loop keeps time: steps that came late, and how long a surface takes to the wire of the vane."""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Iterable
from typing import Final

import numpy as np

REPORT_EVERY_NS: Final = 5_000_000_000
PRIORITY: Final = 10
"""Of 1 to 99: above all ordinary programs, below the drivers of the system."""
_KEPT: Final = 60_000
"""Latencies of ten minutes at 100 Hz."""


def claim_real_time() -> bool:
    """Have this process run before those that have no deadline; whether the system grants it (limits: rtprio)."""
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(PRIORITY))
    except (AttributeError, OSError):
        return False
    return True


class Overruns:
    """Steps that began later than the step after them was due."""

    def __init__(self, step_ns: int) -> None:
        self._step_ns = step_ns
        self.steps = self.late = 0
        self.worst_ns = 0
        self._new = self._new_worst_ns = 0

    def began(self, due_ns: int, now_ns: int) -> None:
        self.steps += 1
        behind_ns = now_ns - due_ns
        if behind_ns > self._step_ns:
            self.late += 1
            self._new += 1
            self.worst_ns = max(self.worst_ns, behind_ns)
            self._new_worst_ns = max(self._new_worst_ns, behind_ns)

    def said(self) -> str:
        """In words, those since this was last asked; empty without any."""
        words = f"{self._new} steps late, by {self._new_worst_ns * 1e-6:.1f} ms at most" if self._new else ""
        self._new = self._new_worst_ns = 0
        return words

    def report(self) -> dict[str, float]:
        return {"steps": self.steps, "late": self.late, "worst_late_ms": round(self.worst_ns * 1e-6, 2)}


class Latency:
    """From when a surface's value came to when the bytes left that were made with it."""

    def __init__(self) -> None:
        self._newest_s = math.nan
        self._under_way: list[float] = []
        self._ms: deque[float] = deque(maxlen=_KEPT)
        self._told = 0

    def flown(self, came_s: Iterable[float]) -> None:
        """Rows have come that were flown with a value of that time; NaN: with none from outside."""
        for t in came_s:
            if not math.isnan(t) and t != self._newest_s:
                self._newest_s = t
                self._under_way.append(t)

    def sent(self, now_s: float) -> None:
        """What was made of all rows has left."""
        self._ms.extend(1e3 * (now_s - t) for t in self._under_way)
        self._told += len(self._under_way)
        self._under_way.clear()

    def report(self) -> dict[str, float]:
        """Median, 99th percentile, jitter (standard deviation) and worst, ms, of so many values; empty without any."""
        if not self._ms:
            return {}
        ms = np.array(self._ms)
        middle, late, worst = np.percentile(ms, [50, 99, 100])
        found = {"p50": middle, "p99": late, "jitter": float(ms.std()), "worst": worst}
        return {name: round(float(v), 2) for name, v in found.items()} | {"values": self._told}
