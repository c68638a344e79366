"""Numbered test points of a flight, begun and ended by the crew or by the card's steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from station.clock import Clock
from station.rows import Code, Event


class Points:
    """One is open at a time; its number is the count of the events that it is begun and ended by, its note their
    detail: name, semicolon, condition."""

    def __init__(self, put: Callable[[Event], None], clock: Clock, planned: Sequence[str] = ()) -> None:
        """`planned`: notes of the points that the crew begins, in their order."""
        self._put, self._clock, self._planned = put, clock, tuple(planned)
        self._number, self._open, self._note = 0, False, ""

    def toggle(self) -> int | None:
        """Begins or ends one: the number of the open one, None when it was ended."""
        if self._open:
            self.end()
            return None
        number = self._number + 1
        return self.begin(self._planned[number - 1] if number <= len(self._planned) else f"test point {number}")

    def begin(self, note: str) -> int:
        """Ends the open one, if there is one; the number of the new."""
        self.end()
        self._number, self._open, self._note = self._number + 1, True, note
        self._say(Code.POINT_START)
        return self._number

    def end(self) -> None:
        """Ends the open one, if there is one."""
        if self._open:
            self._open = False
            self._say(Code.POINT_END)

    def _say(self, code: Code) -> None:
        self._put(Event(self._clock.now_ns(), "operator", code, self._number, self._note))
