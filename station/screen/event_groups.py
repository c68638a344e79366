"""Like events together: the tenth OVERRUN in a second tells nothing that the first has not."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

import msgspec

from station.rows import Code, Event

QUIET_NS: Final = 10_000_000_000
"""Like events are told at once, then at most once in so long, with their number."""
CREWS_OWN: Final = frozenset((Code.MARK, Code.POINT_START, Code.POINT_END, Code.STEP, Code.VERDICT))
"""Each told by itself, however many."""


class EventGate:
    """Lets the first of like events through at once and gathers those that follow."""

    def __init__(self) -> None:
        self._told_ns: dict[tuple[str, Code], int] = {}
        self._held: dict[tuple[str, Code], Event] = {}

    def passed(self, events: Iterable[Event], now_ns: int) -> Iterator[Event]:
        """What is to be told by `now_ns`, the time of the newest row, of these and of those gathered before."""
        for event in events:
            key = (event.source, event.code)
            told_ns = self._told_ns.get(key)
            if event.code in CREWS_OWN or (
                (told_ns is None or event.t_ns - told_ns >= QUIET_NS) and key not in self._held
            ):
                self._told_ns[key] = event.t_ns
                yield event
            else:
                self._held[key] = together(self._held.get(key), event)
        yield from self.rest(now_ns)

    def rest(self, now_ns: int | None = None) -> Iterator[Event]:
        """What was gathered and is due by then; all of it where no time is given."""
        for key in [k for k in self._held if now_ns is None or now_ns - self._told_ns[k] >= QUIET_NS]:
            event = self._held.pop(key)
            self._told_ns[key] = event.t_ns
            yield event


def together(before: Event | None, event: Event) -> Event:
    """Both in one: the later one's time and detail."""
    return event if before is None else msgspec.structs.replace(event, count=before.count + event.count)


def grouped(events: Iterable[Event]) -> list[Event]:
    """Like events that follow one another within `QUIET_NS`, in one each; by the time of the last."""
    found: dict[tuple[str, Code, int], Event] = {}
    newest: dict[tuple[str, Code], tuple[str, Code, int]] = {}
    for number, event in enumerate(events):
        kind = (event.source, event.code)
        key = newest.get(kind)
        if key is None or event.code in CREWS_OWN or event.t_ns - found[key].t_ns > QUIET_NS:
            key = newest[kind] = (*kind, number)
            found[key] = event
        else:
            merged = together(found.pop(key), event)
            found[key] = merged  # as the last
    return list(found.values())
