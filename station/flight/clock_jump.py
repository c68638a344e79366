"""A device clock that jumps by milliseconds: a change of the floor under arrival minus device time, and how it is told
from messages that are late.

A message cannot be earlier than the floor: some that are prove a clock that jumped ahead. After a jump back all are
late, by the same; held-up messages are late each by its own, and the first that gets through ends it. A station that
stalls holds all up and then has them at once: no time passes while it takes them. A clock that leaps by more than any
link is late shows in one message; others have to agree before the floor is moved, or it was a wrong stamp. Pure.
"""

from __future__ import annotations

import math
from collections import deque
from enum import Enum
from statistics import median
from typing import Final, NamedTuple

LEAST_NS: Final = 2_000_000
"""A floor moves by less than this of itself: 100 ppm of drift in the 10 s before it is known are 1 ms, and readers on a
busy machine are late by one."""
SPREAD: Final = 4
"""A jump back is looked for beyond so many times what half a second's earliest message misses the floor by (its 95 %
quantile): exponential delays go there in one such time of 160,000."""
EULER_GAMMA: Final = 0.5772156649
"""The worst of n exponential delays is ln n + γ of them in the mean (Gumbel): read off it, the limit is the same of
exponential delays and lower of those that end somewhere. The lower of both counts: a stall may be that worst one."""
RUN_NS: Final = 450_000_000
"""All messages of so long, by both clocks, are late before it is a jump: told within the second, and longer than what
mostly holds a link up."""
GAP_PERIODS: Final = 2
"""So much of a gap between two late messages counts: one in which the station or the link stood still says nothing."""
LATE_MESSAGES: Final = 4
EARLY_MESSAGES: Final = 3
EARLY_SHARE: Final = 0.1
"""Of the messages since the first early one so many must be: the others are late by more than the jump."""
FLAT_NS: Final = 1_000_000
"""Two halves of a run have their earliest message at the same height, to this and the floor's own spread."""
SCATTER: Final = 10
"""Messages of a run lie within so many times their mean lateness before it: of exponential delays, one in 20,000 does
not. The mean is taken from the median, ln 2 of it, which a stall in the middle of them does not move."""
LOOK_NS: Final = 50_000_000
MEAN_OVER: Final = 64
"""Messages over which the mean lateness is taken."""
LEAP_MESSAGES: Final = 3
"""A leap is followed once so many messages agree on it over a third of RUN_NS, or two over all of it: one of them was
then in time."""
LAW_OF_PROOF: Final = 4
"""From this clock law on a burst is one message, the median tells the usual lateness, and leaps are proven."""


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
    come_ns: int = 0
    """For how long messages had been coming, of a run."""


class JumpWatch:
    """Looks at messages one by one; `jump_ns` and `run` say what it found when it says JUMP."""

    def __init__(self, law: int, period_ns: int) -> None:
        self._proves = law >= LAW_OF_PROOF
        self._gap_ns = GAP_PERIODS * period_ns
        self._mean_ns = 0.0
        self._lateness: deque[float] = deque(maxlen=MEAN_OVER)
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

    def take(
        self, device_ns: int, arrival_ns: int, over_ns: float, spread_ns: float, doubt_ns: float, tail_ns: float
    ) -> Found:
        """`over_ns`: above the floor; `spread_ns`: by how much half a second's earliest message misses it, `tail_ns`
        the same by the worst of the window; `doubt_ns`: by how much the floor itself may be wrong."""
        least_ns = LEAST_NS + doubt_ns
        limit_ns = max(least_ns, SPREAD * (min(spread_ns, tail_ns) if self._proves else spread_ns))
        message = _Message(arrival_ns, device_ns, over_ns)
        if over_ns > limit_ns:
            return self._take_late(message, spread_ns)
        for late in (*self._late, message):
            lateness = max(late.over_ns, 0.0)
            self._mean_ns += (lateness - self._mean_ns) / MEAN_OVER
            self._lateness.append(lateness)
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
        if self._proves and late and _came_at_once(late[-1], message):
            late.pop()  # both were held up, and the second by less
        if late:
            before = late[-1]
            gap_ns = min(message.arrival_ns - before.arrival_ns, message.device_ns - before.device_ns, self._gap_ns)
            message = message._replace(come_ns=before.come_ns + gap_ns)
        late.append(message)
        while len(late) > LATE_MESSAGES and self._lasted(late, 1) >= RUN_NS:
            late.popleft()
        if message.arrival_ns < self._look_ns or len(late) < LATE_MESSAGES or self._lasted(late) < RUN_NS:
            return Found.USUAL
        self._look_ns = message.arrival_ns + LOOK_NS
        heights = [m.over_ns for m in late]
        half = len(heights) // 2
        is_flat = abs(min(heights[:half]) - min(heights[half:])) <= max(FLAT_NS, spread_ns)
        if is_flat and max(heights) - min(heights) <= FLAT_NS + SCATTER * self._usual_ns():
            return self._jump(list(late))
        return Found.USUAL

    def _lasted(self, late: deque[_Message], first: int = 0) -> int:
        """How long messages have been coming late, ns."""
        return late[-1].come_ns - late[first].come_ns if self._proves else _took(late, first)

    def _usual_ns(self) -> float:
        """Mean lateness of messages that are not of a jump."""
        if not self._proves:
            return self._mean_ns
        return median(self._lateness) / math.log(2) if self._lateness else 0.0

    def _jump(self, run: list[_Message]) -> Found:
        self.forget()
        self.run, self.jump_ns = run, min(m.over_ns for m in run)
        return Found.JUMP


def _took(messages: deque[_Message], first: int = 0) -> int:
    """How long it was from one to the last, by the clock that says less, ns."""
    a, b = messages[first], messages[-1]
    return min(b.arrival_ns - a.arrival_ns, b.device_ns - a.device_ns)


def tail(worst_ns: float, count: int) -> float:
    """What 95 % of delays lie below, by the worst of `count` that are exponential."""
    return worst_ns * math.log(20) / (math.log(count) + EULER_GAMMA)


def _came_at_once(before: _Message, message: _Message) -> bool:
    """It came sooner after the one before than it was sent: both had waited."""
    return 2 * (message.arrival_ns - before.arrival_ns) < message.device_ns - before.device_ns


class LeapWatch:
    """A device clock that leaps, until messages agree on it or tell that it was a wrong stamp."""

    def __init__(self) -> None:
        self.run: list[_Message] = []
        """Those that agree."""
        self._strays = 0

    @property
    def jump_ns(self) -> float:
        """By how much station minus device time has changed, of a clock with the old floor's slope."""
        return min(m.over_ns for m in self.run)

    def take(self, device_ns: int, arrival_ns: int, over_ns: float, *, leaps: bool) -> Found:
        """`leaps`: its increments are the clock's; `over_ns`: above the floor of before."""
        message = _Message(arrival_ns, device_ns, over_ns)
        if leaps:
            self.forget()
        elif not abs(over_ns - self.run[0].over_ns) < abs(over_ns):
            self.forget()
            return Found.USUAL
        self.run.append(message)
        took = _took(deque(self.run))
        is_proven = len(self.run) >= LEAP_MESSAGES and took >= RUN_NS // 3
        return Found.JUMP if is_proven or took >= RUN_NS else Found.EARLY

    def told(self) -> int:
        """How many device times were found to be wrong since it was asked."""
        strays, self._strays = self._strays, 0
        return strays

    def forget(self) -> None:
        """What leapt was no clock."""
        self._strays += len(self.run)
        self.run = []
