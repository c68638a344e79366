"""A device clock that jumps by milliseconds: a change of the floor under arrival minus device time, and how it is told
from messages that are late.

A message cannot be earlier than the floor: some that are prove a clock that jumped ahead. After a jump back all are
late, by the same; held-up messages are late each by its own, and the first that gets through ends it. A station that
stalls holds all up and then has them at once: no time passes while it takes them. Pure.
"""

from __future__ import annotations

from collections import deque
from enum import Enum
from typing import Final, NamedTuple

LEAST_NS: Final = 2_000_000
"""A floor moves by less than this of itself: 100 ppm of drift in the 10 s before it is known are 1 ms, and readers on a
busy machine are late by one."""
SPREAD: Final = 4
"""A jump back is looked for beyond so many times what half a second's earliest message misses the floor by (its 95 %
quantile): exponential delays go there in one such time of 160,000."""
RUN_NS: Final = 450_000_000
"""All messages of so long, by both clocks, are late before it is a jump: told within the second, and longer than what
mostly holds a link up."""
LATE_MESSAGES: Final = 4
EARLY_MESSAGES: Final = 3
EARLY_SHARE: Final = 0.1
"""Of the messages since the first early one so many must be: the others are late by more than the jump."""
FLAT_NS: Final = 1_000_000
"""Two halves of a run have their earliest message at the same height, to this and the floor's own spread."""
SCATTER: Final = 10
"""Messages of a run lie within so many times their mean lateness before it: of exponential delays, one in 20,000 does
not."""
LOOK_NS: Final = 50_000_000
MEAN_OVER: Final = 64
"""Messages over which the mean lateness is taken."""


class Found(Enum):
    """What a message is: as the floor has it, below it, or one that proves a jump."""

    USUAL = "usual"
    EARLY = "early"
    JUMP = "jump"


class _Message(NamedTuple):
    arrival_ns: int
    device_ns: int
    over_ns: float
    """Above the floor as it was."""


class JumpWatch:
    """Looks at messages one by one; `jump_ns` and `run` say what it found when it says JUMP."""

    def __init__(self) -> None:
        self._mean_ns = 0.0
        self.forget()

    def forget(self) -> None:
        """What was seen so far says nothing of a jump."""
        self._late: deque[_Message] = deque()
        self._early: deque[_Message] = deque()
        self._since_early = 0
        self._look_ns = 0
        self.run: list[_Message] = []
        self.jump_ns = 0.0
        """By how much station minus device time has changed."""

    def take(self, device_ns: int, arrival_ns: int, over_ns: float, spread_ns: float, doubt_ns: float) -> Found:
        """`over_ns`: above the floor; `spread_ns`: by how much half a second's earliest message misses it;
        `doubt_ns`: by how much the floor itself may be wrong."""
        least_ns = LEAST_NS + doubt_ns
        limit_ns = max(least_ns, SPREAD * spread_ns)
        message = _Message(arrival_ns, device_ns, over_ns)
        if over_ns > limit_ns:
            return self._take_late(message, spread_ns)
        for late in (*self._late, message):
            self._mean_ns += (max(late.over_ns, 0.0) - self._mean_ns) / MEAN_OVER
        self._late.clear()
        if over_ns < -max(least_ns, spread_ns):
            return self._take_early(message)
        if self._early:
            self._since_early += 1
            if arrival_ns - self._early[0].arrival_ns > 2 * RUN_NS:
                self._early.clear()
        return Found.USUAL

    def _take_early(self, message: _Message) -> Found:
        early = self._early
        while early and message.arrival_ns - early[0].arrival_ns > 2 * RUN_NS:
            early.popleft()
        self._since_early = self._since_early + 1 if early else 1
        early.append(message)
        enough = max(EARLY_MESSAGES, EARLY_SHARE * self._since_early)
        if len(early) >= enough and _took(early) >= RUN_NS // 3:
            return self._jump(list(early))
        return Found.EARLY

    def _take_late(self, message: _Message, spread_ns: float) -> Found:
        late = self._late
        late.append(message)
        while len(late) > LATE_MESSAGES and _took(late, 1) >= RUN_NS:
            late.popleft()
        if message.arrival_ns < self._look_ns or len(late) < LATE_MESSAGES or _took(late) < RUN_NS:
            return Found.USUAL
        self._look_ns = message.arrival_ns + LOOK_NS
        heights = [m.over_ns for m in late]
        half = len(heights) // 2
        is_flat = abs(min(heights[:half]) - min(heights[half:])) <= max(FLAT_NS, spread_ns)
        if is_flat and max(heights) - min(heights) <= FLAT_NS + SCATTER * self._mean_ns:
            return self._jump(list(late))
        return Found.USUAL

    def _jump(self, run: list[_Message]) -> Found:
        self.forget()
        self.run, self.jump_ns = run, min(m.over_ns for m in run)
        return Found.JUMP


def _took(messages: deque[_Message], first: int = 0) -> int:
    """How long it was from one to the last, by the clock that says less, ns."""
    a, b = messages[first], messages[-1]
    return min(b.arrival_ns - a.arrival_ns, b.device_ns - a.device_ns)
