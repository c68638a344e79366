"""Linux's input events out of a stream of bytes: struct input_event of a 64-bit machine (linux/input.h). Pure.

Through a pipe anything may come. What is no event is passed over, up to where several follow one another.
"""

from __future__ import annotations

import struct
from typing import Final

EVENT: Final = struct.Struct("<qqHHi")
"""Seconds, microseconds, type, code, value."""
SYN, ABS = 0, 3
_HIGHEST: Final = {
    SYN: 0x0F, 1: 0x2FF, 2: 0x0F, ABS: 0x3F, 4: 0x07, 5: 0x11, 0x11: 0x0F, 0x12: 0x07, 0x14: 0x01, 0x15: 0x7F, 0x16: 0,
    0x17: 0x01,
}  # fmt: skip
"""Code of each type (linux/input-event-codes.h)."""
_MOST_SECONDS: Final = 2**33
"""Since 1970: the year 2242."""
_MICROSECONDS: Final = 1_000_000
_SURE: Final = 3
"""So many events in a row are no accident."""
_NARROW: Final = struct.Struct("<IIHHi")
"""The same of a 32-bit machine."""
_SHOWN: Final = 24

Event = tuple[int, int, int]
"""Type, code and value."""


class InputEvents:
    """Feed it bytes cut anywhere."""

    def __init__(self) -> None:
        self._rest = b""
        self._in_step = True
        self.passed_over = ""
        """What was no event, in words, of the first time; empty without any."""

    def feed(self, data: bytes) -> list[Event]:
        """The events that `data` completes."""
        data = self._rest + data
        found: list[Event] = []
        at = 0
        while len(data) - at >= (EVENT.size if self._in_step else _SURE * EVENT.size):
            if not self._in_step:
                self._in_step = all(_event(data, at + i * EVENT.size) for i in range(_SURE))
                at += 0 if self._in_step else 1
            elif (event := _event(data, at)) is not None:
                found.append(event)
                at += EVENT.size
            else:
                self._in_step = False
                self.passed_over = self.passed_over or _words(data[at:])
        self._rest = data[at:]
        return found


def _event(data: bytes, at: int) -> Event | None:
    seconds, micros, kind, code, value = EVENT.unpack_from(data, at)
    is_event = 0 <= seconds < _MOST_SECONDS and 0 <= micros < _MICROSECONDS and code <= _HIGHEST.get(kind, -1)
    return (kind, code, value) if is_event else None


def _words(data: bytes) -> str:
    _, micros, kind, code, _ = _NARROW.unpack_from(data)
    narrow = micros < _MICROSECONDS and code <= _HIGHEST.get(kind, -1)
    hint = "; it looks like a 32-bit machine's, of 16 bytes" if narrow else ""
    return f"passed over: {data[:_SHOWN]!r}: no input event of a 64-bit machine, of 24 bytes{hint}"
