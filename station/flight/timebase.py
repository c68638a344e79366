"""A device's clock seen from the station's: offset and drift from the lower envelope of arrival minus device time.

A message can be late but never early, so arrival minus device time touches its floor now and then; the floor is a
straight line whose slope is the drift (Moon, Skelly and Towsley 1999, "Estimation and removal of clock skew from
network delay measurements": the line below all points that minimises the summed distance is the edge of the lower
convex hull above the mean abscissa). Pure: arrival and device times in, station times out.
"""

from __future__ import annotations

import itertools
from collections import deque
from typing import Final, NamedTuple

from station.conventions import CLOCK_LAW
from station.flight.clock_jump import LAW_OF_PROOF, LEAST_NS, Found, JumpWatch, LeapWatch, tail

BIN_NS: Final = 500_000_000
"""One lowest point is kept of each bin, and the floor drawn anew at its end."""
WINDOW_NS: Final = 40_000_000_000
SYNCED_AFTER_NS: Final = 4_000_000_000
DRIFT_AFTER_NS: Final = 10_000_000_000
"""Before this the floor is taken as level: 100 ppm is then 1 ms at most."""
MAX_DRIFT: Final = 1e-3
USUAL_DRIFT: Final = 1e-4
"""Of crystals, and seldom more."""
STEP_NS: Final = 20_000_000
"""A jump of the device clock against arrival beyond any jitter of a working link."""
MAX_ROUND_TRIP_NS: Final = 10_000_000
EXCHANGES: Final = 8
"""Of the last two seconds, at MAVLink's four a second: any of them and a new one may prove a jump."""
PROVEN_NS: Final = 1_000_000_000
"""A larger jump shows in the messages' increments; exchanges of a clock that wraps seem to jump by days."""
LAW_OF_EXCHANGES: Final = 6
LEAP_SETTLES_NS: Final = 1_000_000_000
NEWEST: Final = 2
OVERTAKEN: Final = 2
"""A message may come so many periods after one that was sent later."""
STANDSTILLS: Final = 3
"""So many equal device times in a row are a clock that stands still."""


class Mapped(NamedTuple):
    """A device time on the station's clock, and how late the message was over the floor."""

    t_ns: int
    late_ns: int
    stepped: bool
    """The device clock leapt, and is synchronised anew."""
    jump_ns: int = 0
    """By how much station minus device time has changed; the floor has been moved with it."""
    strays: int = 0
    """Device times before this one that were wrong: what they showed was no clock's."""


class Exchange(NamedTuple):
    """Station minus device clock at a moment of the station's, good to half the round trip."""

    offset_ns: int
    round_trip_ns: int
    t_ns: int

    def moved_ns(self, later: Exchange) -> int:
        """By how much the difference of the clocks has changed since, if by more than the journeys and any drift
        explain; else 0."""
        moved = later.offset_ns - self.offset_ns
        return moved if self._doubt_ns(later) < abs(moved) < PROVEN_NS else 0

    def denies(self, jump_ns: float, later: Exchange) -> bool:
        """Whether the difference of the clocks has not changed by that much between the two."""
        return abs(later.offset_ns - self.offset_ns - jump_ns) > self._doubt_ns(later)

    def _doubt_ns(self, later: Exchange) -> float:
        journeys_ns = (self.round_trip_ns + later.round_trip_ns) / 2
        return journeys_ns + MAX_DRIFT * (later.t_ns - self.t_ns) + LEAST_NS


class ClockMap:
    """Maps one stream's device times to station time. `state` is none, unsynced, converging, synced or rejected."""

    def __init__(self, period_ns: int, phase_ns: int = 0, law: int = CLOCK_LAW) -> None:
        """`phase_ns` moves the bins' ends, so that many streams do not all draw their floors at one tick. `law`: as
        conventions.CLOCK_LAW has it."""
        self._watch = JumpWatch(law, period_ns) if law > 1 else None
        self._leap = LeapWatch() if law >= LAW_OF_PROOF else None
        self._period_ns = period_ns
        self._phase_ns = phase_ns
        self._last: tuple[int, int] | None = None
        self._stuck = 0
        self._best_exchange: Exchange | None = None
        self._exchanges: deque[Exchange] = deque(maxlen=EXCHANGES)
        self._uses_exchanges = law >= LAW_OF_EXCHANGES
        self._settles_ns = 0
        """Until then the floor is the few messages' that proved a leap, and exchanges will tell it better."""
        self._proven_ns = 0
        """A jump that exchanges have proven, until the next message is mapped by it."""
        self.state = "none"
        self._reset()

    def _reset(self) -> None:
        self._points: deque[tuple[int, int]] = deque()
        self._bin: tuple[int, int, int] | None = None
        self._first_ns: int | None = None
        self._x0_ns = 0
        self._floor_ns = 0.0
        self._slope = 0.0
        self._settled_ns = 0.0
        """The floor but for its newest points, which a jump may have put there."""
        self._spread_ns = 0.0
        """By how much a bin's lowest point misses the floor, but for one bin in 20: those of a stall."""
        self._tail_ns = 0.0
        """The same by the worst bin: of delays that end somewhere it is less."""
        if self._leap is not None:
            self._leap.run = []

    @property
    def offset_s(self) -> float:
        """Station minus device time at the last message, s."""
        return 1e-9 * self._offset(self._last[0]) if self._last else 0.0

    @property
    def drift_ppm(self) -> float:
        """How much faster station time runs than device time, parts per million."""
        return 1e6 * self._slope

    def exchange(self, offset_ns: int, round_trip_ns: int, t_ns: int) -> None:
        """A two-way exchange: station minus device clock, good to half its round trip. The shortest rules, while it is
        the best by that and by how far clocks drift meanwhile.

        Two that differ by more than both their journeys can are of two clocks: the device's has jumped, or it has
        started anew since.
        """
        if round_trip_ns > MAX_ROUND_TRIP_NS:
            return
        best, new = self._best_exchange, Exchange(offset_ns, round_trip_ns, t_ns)
        if self._uses_exchanges and self._proves(new):
            return
        # The clocks have drifted apart since the best, which a longer journey may be worth.
        aged_ns = 2 * USUAL_DRIFT * (t_ns - best.t_ns) if best is not None and self._uses_exchanges else 0
        if (
            best is None
            or round_trip_ns <= best.round_trip_ns + aged_ns
            or t_ns - best.t_ns > WINDOW_NS
            or abs(offset_ns - best.offset_ns) > MAX_ROUND_TRIP_NS
        ):
            self._best_exchange = new

    def _proves(self, new: Exchange) -> bool:
        """Whether this exchange and one shortly before are of a clock that has jumped between them, by which messages
        are stamped as well: their floor lies a journey above it."""
        shortest = min((e for e in self._exchanges if e.moved_ns(new)), key=lambda e: e.round_trip_ns, default=None)
        is_theirs = shortest is not None and self._is_of(shortest)
        if shortest is not None:
            self._exchanges.clear()
        self._exchanges.append(new)
        if shortest is None or not is_theirs:
            return False
        self._proven_ns, self._best_exchange = shortest.moved_ns(new), new
        return True

    def _is_of(self, exchange: Exchange) -> bool:
        """Whether the messages' clock is the one that answers: the floor, but for its newest points, lies no more than
        a journey from its offset."""
        if self._last is None or self.state not in ("converging", "synced"):
            return False
        settled_ns = self._floor_line(self._last[0]) + self._settled_ns - self._floor_ns
        return abs(settled_ns - exchange.offset_ns) <= MAX_ROUND_TRIP_NS

    def _is_denied(self, watch: JumpWatch) -> bool:
        """Whether exchanges before and after show that no clock has jumped so: messages wait for longer than before."""
        before = [e for e in self._exchanges if e.t_ns < watch.run[0].arrival_ns]
        after = [e for e in self._exchanges if e.t_ns > watch.run[0].arrival_ns]
        return any(self._is_of(a) and a.denies(watch.jump_ns, b) for a in before for b in after)

    def update(self, t_device_ns: int, arrival_ns: int) -> Mapped:
        """Take one message's times and say when it was measured on the station's clock."""
        if self._last is None:
            self.state = "unsynced"
            stepped = False
        else:
            stepped = self._steps(t_device_ns, arrival_ns, *self._last)
        leap = self._leap
        if leap is not None and self.state == "synced" and (stepped or leap.run):
            found = leap.take(t_device_ns, arrival_ns, self._over(t_device_ns, arrival_ns), leaps=stepped)
            stepped = False
        else:
            found = Found.USUAL
        if self._proven_ns:
            stepped, found = False, Found.USUAL
            self._begin_anew()
        if stepped:
            self._reset()
        proven_ns, self._proven_ns = self._proven_ns, 0
        self._last = (t_device_ns, arrival_ns)
        if self.state == "rejected":
            return Mapped(arrival_ns, 0, stepped)
        watch: JumpWatch | LeapWatch | None = leap
        if self._watch is not None and self._first_ns is not None and found is Found.USUAL:
            watch, found = self._watch, self._seen(self._watch, t_device_ns, arrival_ns)
        strays = leap.told() if leap is not None else 0
        if found is Found.EARLY:  # before its time: one wrong stamp, or the first after a jump
            return Mapped(arrival_ns, 0, stepped=False, strays=strays)
        jump_ns = proven_ns
        if watch is not None and found is Found.JUMP:
            # The new device times lie so far along the floor's slope as well.
            jump_ns = round(watch.jump_ns / (1.0 + self._slope) if watch is leap else watch.jump_ns)
            self._move(watch, jump_ns)
        t_ns = self._measured(t_device_ns, arrival_ns)
        return Mapped(t_ns, arrival_ns - t_ns, stepped, jump_ns, strays)

    def _begin_anew(self) -> None:
        """After a jump that exchanges have proven: the answer that did was a message, too, the first of the floor."""
        self._reset()
        if self._watch is not None:
            self._watch.forget()
        if (answer := self._best_exchange) is not None:
            journey_ns = answer.round_trip_ns // 2
            self._next_bin(answer.t_ns - answer.offset_ns - journey_ns, answer.t_ns)

    def _measured(self, t_device_ns: int, arrival_ns: int) -> int:
        """When, on the station's clock, by a floor that this message may lower."""
        difference = arrival_ns - t_device_ns
        lowest = self._bin
        if lowest is None or lowest[0] != (arrival_ns + self._phase_ns) // BIN_NS:
            self._next_bin(t_device_ns, arrival_ns)
        elif difference < lowest[2]:
            self._bin = (lowest[0], t_device_ns, difference)
        floor = self._floor_line(t_device_ns)
        if difference < floor:  # an earlier message than any before: the floor is at least this low
            self._floor_ns += difference - floor
            floor = float(difference)
        return min(t_device_ns + round(self._offset(t_device_ns)), arrival_ns)

    def _steps(self, t_device_ns: int, arrival_ns: int, last_device_ns: int, last_arrival_ns: int) -> bool:
        """The device clock jumped, not a late or bunched message: those have a plausible increment of their own."""
        device, arrived = t_device_ns - last_device_ns, arrival_ns - last_arrival_ns
        if device == 0 or self._stuck or self.state == "rejected":
            self._note_standstill(device)
        fits = -STEP_NS <= device - arrived <= STEP_NS or not (
            abs(device - self._period_ns) > abs(arrived - self._period_ns) or device < -self._period_ns
        )
        return not fits and (self._watch is None or self._is_leap(t_device_ns, arrival_ns, device, arrived))

    def _is_leap(self, t_device_ns: int, arrival_ns: int, device: int, arrived: int) -> bool:
        """Whether increments that do not fit are the device clock's: a message on the floor is in time, whatever was
        held up or lost before it, and one that was overtaken on the way is only late."""
        limit = STEP_NS + MAX_DRIFT * arrived
        over = self._over(t_device_ns, arrival_ns)
        if device > arrived:
            return over < -limit
        was_overtaken = -OVERTAKEN * self._period_ns <= device < 0 and over <= (OVERTAKEN + 1) * self._period_ns
        return over > limit and not was_overtaken

    def _seen(self, watch: JumpWatch, t_device_ns: int, arrival_ns: int) -> Found:
        over = self._over(t_device_ns, arrival_ns) + self._floor_ns - self._settled_ns
        span = arrival_ns - (self._first_ns or arrival_ns)
        doubt = 0.0 if span >= DRIFT_AFTER_NS + BIN_NS else MAX_DRIFT * span
        if span < SYNCED_AFTER_NS or arrival_ns < self._settles_ns:  # the floor is still being found
            return Found.USUAL
        found = watch.take(t_device_ns, arrival_ns, over, self._spread_ns, doubt, self._tail_ns)
        if found is Found.JUMP and self._uses_exchanges and self._is_denied(watch):
            return Found.USUAL
        # A larger jump back has shown in the increments: what is late by as much and did not was held up.
        return Found.USUAL if found is Found.JUMP and watch.jump_ns > STEP_NS else found

    def _move(self, watch: JumpWatch | LeapWatch, jump_ns: int) -> None:
        """Put the floor where the clock has jumped to; its drift is still the same oscillator's."""
        since = watch.run[0].arrival_ns
        # A point's arrival is its device time and difference together; what came since the jump is in `run`.
        before = [(x - jump_ns, d + jump_ns) for x, d in self._points if x + d < since]
        lowest = min(watch.run, key=lambda m: m.arrival_ns - m.device_ns)
        self._points = deque(before)
        self._x0_ns -= jump_ns
        self._settled_ns += jump_ns
        difference = lowest.arrival_ns - lowest.device_ns
        self._floor_ns = difference - self._slope * (lowest.device_ns - self._x0_ns)
        self._bin = ((lowest.arrival_ns + self._phase_ns) // BIN_NS, lowest.device_ns, difference)
        if isinstance(watch, LeapWatch) and self._exchanges:
            self._settles_ns = watch.run[-1].arrival_ns + LEAP_SETTLES_NS
        self._best_exchange = None
        self._exchanges.clear()
        if isinstance(watch, LeapWatch):
            watch.run = []
            if self._watch is not None:
                self._watch.forget()

    def _note_standstill(self, device: int) -> None:
        """A device clock that stands still cannot be used until it goes again."""
        self._stuck = self._stuck + 1 if device == 0 else 0
        if self._stuck >= STANDSTILLS:
            self.state = "rejected"
        elif self.state == "rejected" and device > 0:
            self.state = "unsynced"
            self._reset()

    def _next_bin(self, t_device_ns: int, arrival_ns: int) -> None:
        difference = arrival_ns - t_device_ns
        if self._bin is not None:
            self._points.append(self._bin[1:])
            while self._points and t_device_ns - self._points[0][0] > WINDOW_NS:
                self._points.popleft()
            if not self._points:  # silent for longer than the window: no line is left
                self._reset()
        if self._first_ns is None:
            self._first_ns = arrival_ns
            self._x0_ns = t_device_ns
            self._floor_ns = float(difference)
            self._slope = 0.0
            self.state = "unsynced"
        if self._points:
            self._fit(arrival_ns - self._first_ns)
        self._bin = ((arrival_ns + self._phase_ns) // BIN_NS, t_device_ns, difference)

    def _fit(self, span_ns: int) -> None:
        slope = 0.0
        if span_ns >= DRIFT_AFTER_NS:
            slope = _hull_slope(self._points)
            if abs(slope) > MAX_DRIFT:
                self.state = "rejected"
                return
        self._slope = slope
        heights = [d - slope * (x - self._x0_ns) for x, d in self._points]
        self._floor_ns = min(heights)
        settled = heights[:-NEWEST] or heights
        self._settled_ns = min(settled)
        self._spread_ns = sorted(settled)[round(0.95 * (len(settled) - 1))] - self._settled_ns
        self._tail_ns = tail(max(settled) - self._settled_ns, len(settled))
        self.state = "synced" if span_ns >= SYNCED_AFTER_NS else "converging"

    def _over(self, t_device_ns: int, arrival_ns: int) -> float:
        """How late a message is over the floor, ns."""
        return arrival_ns - t_device_ns - self._floor_line(t_device_ns)

    def _floor_line(self, t_device_ns: int) -> float:
        return self._floor_ns + self._slope * (t_device_ns - self._x0_ns)

    def _offset(self, t_device_ns: int) -> float:
        """Station minus device time, ns: the floor, less the shortest journey where an exchange has measured it."""
        floor_ns, best = self._floor_line(t_device_ns), self._best_exchange
        if best is None:
            return floor_ns
        # Nothing comes before it is sent, but a floor may be drawn too low.
        least_ns = -MAX_ROUND_TRIP_NS if self._uses_exchanges else 0
        return best.offset_ns if least_ns < floor_ns - best.offset_ns <= MAX_ROUND_TRIP_NS else floor_ns


def _hull_slope(points: deque[tuple[int, int]]) -> float:
    """Slope of the lower convex hull's edge above the mean abscissa."""
    hull: list[tuple[int, int]] = []
    for x, y in sorted(points):
        while len(hull) >= 2:
            (x1, y1), (x2, y2) = hull[-2], hull[-1]
            if (y2 - y1) * (x - x1) < (y - y1) * (x2 - x1):
                break
            hull.pop()
        if not hull or x > hull[-1][0]:
            hull.append((x, y))
    mean = sum(x for x, _ in points) / len(points)
    for (x1, y1), (x2, y2) in itertools.pairwise(hull):
        if x1 <= mean <= x2:
            return (y2 - y1) / (x2 - x1)
    return 0.0
