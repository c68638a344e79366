"""What the operator should know now: digested from the rows of each tick, rendered by screen/terminal.py.

`update` runs in the 50 Hz loop and only writes fields; rendering happens in another thread and only reads them.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec

from station.clock import Clock
from station.conventions import LATERAL, LONGITUDINAL
from station.estimation.method_table import recommended
from station.flight.against_baseline import AgainstBaseline
from station.flight.finished_points import FinishedPoint, FinishedPoints
from station.flight.limits import limited_signals, shown_signals
from station.flight.loop import ESTIMATORS
from station.profile import Profiles
from station.rows import (
    AlphaEstimate,
    Code,
    Event,
    Frame,
    Health,
    Level,
    MethodEstimate,
    ParamEstimate,
    RawBlock,
    Row,
    Status,
    StreamHealth,
    Tick,
)

if TYPE_CHECKING:
    from station.flight.guide import Guide

CONDITIONS: Final = frozenset(
    (
        Code.STALE,
        Code.STUCK,
        Code.SLOW,
        Code.LATE,
        Code.DISCONNECT,
        Code.DISK,
        Code.DISAGREE,
        Code.CHANGED,
        Code.UNWATCHED,
        Code.LIMIT,
        Code.PROTOCOL,
        Code.HEALTH,
    )
)
"""Events that hold until another ends them; all others are over when told."""
RECENT_NS: Final = 3_000_000_000
_MAX_EVENTS: Final = 200


class Recommendation:
    """Which method to believe first for the longitudinal derivatives: it follows the data, looked at once a second.

    The one rule for whoever shows it, the terminal, the JSON lines and the page.
    """

    def __init__(self, derivatives: tuple[str, ...] = LONGITUDINAL) -> None:
        self.method = "split"
        self._derivatives = derivatives
        self._given: dict[str, MethodEstimate] = {}
        self._turbulence = "unknown"

    def update(self, row: Row) -> None:
        """Take an estimate, or health, which comes once a second."""
        if isinstance(row, MethodEstimate):
            self._given[row.method] = row
        elif isinstance(row, AlphaEstimate):
            self._turbulence = row.turbulence
        elif isinstance(row, Health):
            given = {
                name: sum(p.status is Status.ESTIMATED and p.name in self._derivatives for p in method.parameters)
                for name, method in self._given.items()
                if method.applicable
            }
            self.method = recommended(given, self._turbulence) or "split"


class Board:
    """The newest of everything, for the terminal screen, the plain lines and the JSON lines."""

    def __init__(self, profiles: Profiles | None, clock: Clock, *, address: str = "") -> None:
        self.title = f"{profiles.card.name}: {profiles.aircraft.name} on {profiles.rig.name}" if profiles else "station"
        self.accuracy = profiles.card.accuracy if profiles else 0.0
        """2 sd below this share of a derivative's value is enough; 0 where no card says so."""
        measured = profiles.aircraft.measured if profiles is not None else None
        self.has_baseline = measured is not None
        """Whether the flight is held against a measured baseline."""
        self.has_baseline_of_drag = measured is not None and measured.CD_0 is not None
        self.against = AgainstBaseline(profiles.aircraft) if profiles and self.has_baseline else None
        """What of it has changed, in numbers."""
        self.derivatives: tuple[str, ...] = LONGITUDINAL
        self.lateral: tuple[str, ...] = ()
        """Lateral derivatives, where a method gives any."""
        self.lateral_method = "split"
        """The method to believe first for them; looked at once a second."""
        self.address = address
        self.glance_address = ""
        self.signals = shown_signals(profiles.rig) if profiles else ()
        """What the rig declares or derives."""
        self.limits = limited_signals(profiles.rig) if profiles else ()
        """What it gives limits to."""
        self.frame: Frame | None = None
        self.start_ns: int | None = None
        self.tick_ns = 0
        """Of the newest tick."""
        self.alpha: AlphaEstimate | None = None
        self.methods: dict[str, MethodEstimate] = {}
        self.health: Health | None = None
        self.conditions: dict[tuple[str, Code], Event] = {}
        """What holds now, by source and code."""
        self.counted: dict[tuple[str, Code], Event] = {}
        """The last of each kind of event that is over when told."""
        self.point: Event | None = None
        """The start of the open test point."""
        self.points = FinishedPoints()
        """Those that are over, with what they found."""
        self.estimators = "ready"
        """ready, preparing, or failed."""
        self.ever_complete = False
        """Whether all streams were alive at once at some time."""
        self.absent = ""
        """Streams that are not alive now."""
        self.log_path = Path()
        self.log_bytes = 0
        self.view_dropped = 0
        self.view_behind_s = 0.0
        """Age of the oldest tick that the page was handed and has not taken; what a browser is behind is beside it."""
        self._recommendation = Recommendation()
        self.clock = clock
        self.guide: Guide | None = None
        """Who leads through the card's steps, where it has any."""
        self._events: deque[tuple[int, Event]] = deque(maxlen=_MAX_EVENTS)
        self._told = 0
        self._take: dict[type, Callable[[Any], None]] = {
            AlphaEstimate: self._take_alpha,
            MethodEstimate: self._take_method,
            Health: self._take_health,
            Event: self._take_event,
            Tick: self._take_tick,
            Frame: self._take_frame,
            RawBlock: self._take_first,
        }
        self._heard = threading.Event()

    def update(self, rows: Iterable[Row]) -> None:
        """Digest the rows of a tick."""
        take = self._take
        for row in rows:
            handler = take.get(type(row))
            if handler is not None:
                handler(row)

    def recording(self, path: Path, size: int, view_dropped: int, view_behind_s: float = 0.0) -> None:
        """What the recording and the page say of themselves: file, bytes, ticks not shown, seconds behind."""
        self.log_path, self.log_bytes, self.view_dropped = path, size, view_dropped
        self.view_behind_s = view_behind_s

    def wait_for_first(self, timeout_s: float) -> None:
        """Until a device has been heard, but no longer than this."""
        self._heard.wait(timeout_s)

    def _take_first(self, _: RawBlock) -> None:
        self._heard.set()
        del self._take[RawBlock]

    def _take_tick(self, row: Tick) -> None:
        self.tick_ns = row.t_ns
        if self.start_ns is None:
            self.start_ns = row.t_ns

    def _take_frame(self, row: Frame) -> None:
        self.frame = row
        if self.against is not None:
            self.against.take_frame(row)

    @property
    def recommended(self) -> str:
        """The method to believe first."""
        return self._recommendation.method

    def _take_alpha(self, row: AlphaEstimate) -> None:
        self.alpha = row
        if self.against is not None:
            self.against.take_alpha(row)
        if self.point is not None:
            self.points.take(row)
        self._recommendation.update(row)

    def _take_method(self, row: MethodEstimate) -> None:
        self.methods[row.method] = row
        self._recommendation.update(row)

    def _take_health(self, row: Health) -> None:
        self.health = row
        self._choose_lateral()
        self._recommendation.update(row)
        self.ever_complete = self.ever_complete or (bool(row.streams) and all(s.alive for s in row.streams))
        self.absent = ", ".join(s.stream for s in row.streams if not s.alive)

    def _choose_lateral(self) -> None:
        """split+gust, which gusts across the span do not mislead; split, or II, where they give more."""
        given = {}
        for name, row in self.methods.items():
            lateral = [p for p in row.parameters if p.name in LATERAL]
            if lateral:
                self.lateral = tuple(p.name for p in lateral)
                given[name] = sum(p.status is Status.ESTIMATED for p in lateral) if row.applicable else 0
        order = [name for name in ("split+gust", "split", "II") if name in given]
        self.lateral_method = max(order, key=lambda name: given[name], default="split")

    def _take_event(self, row: Event) -> None:
        if row.source == ESTIMATORS:
            self.estimators = {Code.PREPARING: "preparing", Code.READY: "ready"}.get(row.code, "failed")
        if row.code not in (Code.MARK, Code.START):
            self._settle(row)
        self._told += 1
        self._events.append((self._told, row))

    def _settle(self, row: Event) -> None:
        source, code = row.source, row.code
        if code is Code.FRESH:
            # The detail begins with the code of what is over.
            ended = row.detail.partition(" ")[0]
            for key in list(self.conditions):
                if key[0] == source and key[1] not in (Code.DISCONNECT, Code.DISK) and ended in ("", key[1]):
                    del self.conditions[key]
        elif code in (Code.CONNECT, Code.RECONNECT):
            self.conditions.pop((source, Code.DISCONNECT), None)
        elif code is Code.AGREE:
            self.conditions.pop((source, Code.DISAGREE), None)
        elif code is Code.UNCHANGED:
            self.conditions.pop((source, Code.CHANGED), None)
        elif code is Code.WATCHED:
            self.conditions.pop((source, Code.UNWATCHED), None)
        elif code is Code.DISK and row.detail.startswith("recording again"):
            self.conditions.pop((source, code), None)
        elif code in CONDITIONS:
            self.conditions[source, code] = row
        elif code is Code.POINT_START:
            self.point = row
            self.points.begin(row)
        elif code is Code.POINT_END:
            self.point = None
            self.points.end(row, self.recommended, self._found)
        elif row.level is not Level.INFO:
            self.counted[source, code] = row

    def _found(self) -> tuple[ParamEstimate | None, ...]:
        return tuple(self.parameter(self.recommended, name) for name in self.derivatives)

    @property
    def alarms(self) -> list[Event]:
        """Conditions that hold now and must not be missed, oldest first."""
        return sorted((e for e in list(self.conditions.values()) if e.level is Level.ALARM), key=lambda e: e.t_ns)

    @property
    def disagreements(self) -> list[Event]:
        """Where instruments, they and the model, or the aircraft and its baseline disagree now, or nothing tells
        whether they do; oldest first."""
        codes = (Code.DISAGREE, Code.CHANGED, Code.UNWATCHED)
        return sorted((e for e in list(self.conditions.values()) if e.code in codes), key=lambda e: e.t_ns)

    def flags(self, stream: str, device: str, now_ns: int) -> list[Code]:
        """What is or was just now the matter with a stream or its device."""
        sources = (stream, device)
        found = [code for source, code in list(self.conditions) if source in sources]
        for event in list(self.counted.values()):
            if event.source in sources and now_ns - event.t_ns < RECENT_NS and event.code not in found:
                found.append(event.code)
        return found

    def events_after(self, number: int) -> list[tuple[int, Event]]:
        """Events told after the one so numbered (0: all that are kept), oldest first."""
        return [(n, event) for n, event in list(self._events) if n > number]

    def elapsed_s(self, t_ns: int | None = None) -> float:
        """Seconds since the first tick, now or at `t_ns`."""
        if self.start_ns is None:
            return 0.0
        return ((self.clock.now_ns() if t_ns is None else t_ns) - self.start_ns) * 1e-9

    def parameter(self, method: str, name: str) -> ParamEstimate | None:
        """A method's estimate of a derivative; None before there is one. Not applicable reads as invalid."""
        row = self.methods.get(method)
        if row is None:
            return None
        for p in row.parameters:
            if p.name == name:
                return p if row.applicable else ParamEstimate(name, p.value, p.sd, Status.INVALID, row.why)
        return None

    def target(self, name: str) -> float:
        """2 sd over its value that a derivative is wanted to: by the step under way, else by the card."""
        wanted = self.guide.step.accept.get(name) if self.guide is not None else None
        return self.accuracy if wanted is None else wanted

    def is_enough(self, p: ParamEstimate) -> bool:
        """Whether a derivative is known as well as the step or the card asks."""
        return p.status is Status.ESTIMATED and 2 * p.sd < self.target(p.name) * abs(p.value)

    def snapshot(self, events: Iterable[tuple[int, Event]] = ()) -> dict[str, Any]:
        """Schema "station.run/1": SI and radians, null for unknown; with `events` as `events_after` gives them."""
        a, health, point = self.alpha, self.health, self.point
        return {
            "schema": "station.run/1",
            "elapsed_s": round(self.elapsed_s(), 3),
            "alpha": None if a is None else _alpha(a),
            "turbulence": None
            if a is None
            else {"level": a.turbulence, "w_std_2_7hz_mps": _number(a.turbulence_level)},
            "estimators": self.estimators,
            "recommended": self.recommended,
            "derivatives": {m: self._method(row) for m, row in list(self.methods.items())},
            "baseline": None if self.against is None else self.against.snapshot(dict(self.methods)),
            "signals": self._signals(),
            "links": {} if health is None else {s.stream: _link(s) for s in health.streams},
            "overruns": 0 if health is None else health.overruns,
            "dropped": 0 if health is None else health.dropped,
            "step": None if self.guide is None else self.guide.snapshot(),
            "test_point": None if point is None else point.count,
            "alarms": [_event(e, self.elapsed_s(e.t_ns)) for e in self.alarms],
            "disagreements": [_event(e, self.elapsed_s(e.t_ns)) for e in self.disagreements],
            "events": [_event(e, self.elapsed_s(e.t_ns)) for _, e in events],
            "log": {"path": str(self.log_path), "bytes": self.log_bytes},
            "view": {"address": self.address, "dropped": self.view_dropped, "behind_s": round(self.view_behind_s, 1)},
            "points": [self._point(p) for p in self.points.ended],
        }

    def _point(self, p: FinishedPoint) -> dict[str, Any]:
        found = zip(self.derivatives, p.found, strict=True)
        return {
            "number": p.number,
            "note": p.note,
            "begun_s": round(self.elapsed_s(p.begun_ns), 3),
            "ended_s": round(self.elapsed_s(p.ended_ns), 3),
            "turbulence": p.air,
            "alpha_valid_share": _number(p.valid_share),
            "method": p.method,
            "derivatives": {name: None if q is None else _estimate(q) for name, q in found},
        }

    def _signals(self) -> dict[str, Any]:
        """What the rig declares or derives, SI."""
        now = self.frame
        return {
            s.name: {"value": None if now is None else _number(now.values[s.column]), "unit": s.si}
            for s in self.signals
        }

    def _method(self, row: MethodEstimate) -> dict[str, Any]:
        found = ((p.name, self.parameter(row.method, p.name) or p) for p in row.parameters)
        return {name: _estimate(p) for name, p in found}


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _estimate(p: ParamEstimate) -> dict[str, Any]:
    return {"estimate": _number(p.value), "std_error": _number(p.sd), "status": p.status.value, "why": p.why}


def _alpha(a: AlphaEstimate) -> dict[str, Any]:
    values = msgspec.structs.asdict(a)
    left_out = ("t_ns", "turbulence_level", "turbulence")
    return {k: _number(v) if isinstance(v, float) else v for k, v in values.items() if k not in left_out}


def _link(s: StreamHealth) -> dict[str, Any]:
    values = msgspec.structs.asdict(s)
    return {k: _number(v) if isinstance(v, float) else v for k, v in values.items() if k != "stream"}


def _event(e: Event, elapsed_s: float) -> dict[str, Any]:
    level = e.level.name.lower()
    return {
        "elapsed_s": round(elapsed_s, 3),
        "source": e.source,
        "code": e.code.value,
        "level": level,
        "count": e.count,
        "detail": e.detail,
    }
