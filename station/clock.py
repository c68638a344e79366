"""Time. The only file that reads a clock or sleeps; everything else is handed a Clock or a time."""

from __future__ import annotations

import threading
import time
from datetime import UTC, datetime
from typing import Protocol


class Clock(Protocol):
    """Station time: integer nanoseconds, monotonic, from an arbitrary origin."""

    def now_ns(self) -> int: ...

    def sleep_until_ns(self, t_ns: int) -> None:
        """Return at once if `t_ns` has passed."""
        ...


class SystemClock:
    """The machine's monotonic clock; on Linux it is one clock for all processes, so emulators share it."""

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def sleep_until_ns(self, t_ns: int) -> None:
        wait = t_ns - time.monotonic_ns()
        if wait > 0:
            time.sleep(wait * 1e-9)


class ManualClock:
    """Time that moves only when told, for tests and replay. Sleeping moves it."""

    def __init__(self, t_ns: int = 0) -> None:
        self._t_ns = t_ns
        self._lock = threading.Lock()

    def now_ns(self) -> int:
        return self._t_ns

    def sleep_until_ns(self, t_ns: int) -> None:
        with self._lock:
            self._t_ns = max(self._t_ns, t_ns)

    def advance_s(self, seconds: float) -> None:
        with self._lock:
            self._t_ns += round(seconds * 1e9)


def utc_now_ns() -> int:
    """Wall-clock time, ns since 1970 UTC: an anchor for a recording's metadata, never used by the numerics."""
    return time.time_ns()


def utc_instant(utc_ns: int) -> datetime:
    """Of ns since 1970 UTC, to the microsecond."""
    return datetime.fromtimestamp(utc_ns // 1000 / 1e6, UTC)


def utc_date(utc_ns: int) -> str:
    """Of ns since 1970 UTC: 2026-11-22."""
    return datetime.fromtimestamp(utc_ns // 1_000_000_000, UTC).strftime("%Y-%m-%d")


def asleep_ns() -> int:
    """How long the machine has been suspended since it was switched on; meanwhile station time stands still. 0 where
    the system does not tell."""
    if not hasattr(time, "CLOCK_BOOTTIME"):
        return 0
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME) - time.monotonic_ns()


def utc_words() -> str:
    """Now in UTC, ISO 8601, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def utc_file_stamp() -> str:
    """Now in UTC as a sortable file-name part, to the second."""
    return datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")


def utc_time(utc_ns: int) -> str:
    """Of ns since 1970 UTC: 14:03:21."""
    return datetime.fromtimestamp(utc_ns // 1_000_000_000, UTC).strftime("%H:%M:%S")
