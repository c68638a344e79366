"""Notices in flight that the aircraft is no longer the one that `station baseline` measured: ice, above all.

Two watches, each with a false alarm once in FALSE_ALARM_H of flight as it is set:
drag    CD_0 by the power that the flight shows, and CL_0, where thrust is recorded or told by the profile's engine
        (drag_watch).
slopes  the derivatives of `physical`, which forgets, each, and all of a pattern together, against the baseline over
        their joint error: without what both share, mass, inertia and the choice of the model. Of an aircraft that
        changes, the past that is not yet forgotten and the present agree with no model, and the distance to the next
        best one would hide the change.
What has changed is named by its pattern (change_patterns), with what it is not told from and what would confirm it.
What is not watched is said too: all of it without an angle of attack, drag alone where a mean of it cannot be made.

step never raises; the same rows give the same events.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence, Set
from typing import Final, NamedTuple

from scipy.stats import norm

from station.conventions import DRAG, LONGITUDINAL, SIGNAL_INDEX, TICK_HZ
from station.estimation.drag_watch import FALSE_ALARM_H, DragWatch
from station.model.airframe_error import relative_errors
from station.model.change_patterns import in_words, matches, patterns
from station.profile import Aircraft
from station.rows import AlphaEstimate, Code, Event, Frame, MethodEstimate, ParamEstimate, Status

SOURCE: Final = "aircraft"
_CONTINUOUS: Final = 4.0
"""Looks that continuous watching counts for in each time constant of what is forgotten."""
HELD_TICKS: Final = 5 * TICK_HZ
"""A derivative must stand off so long."""
BLIND_TICKS: Final = 10 * TICK_HZ
"""Without angle of attack after which it is said that nothing is noticed: a mean of drag."""
AGAIN_NS: Final = 60_000_000_000
"""At the least between two events on a change that goes on."""
_THRUST, _MASS = SIGNAL_INDEX["thrust"], SIGNAL_INDEX["mass"]


Errors = Callable[[], Mapping[str, float]]
Thrust = Callable[[], tuple[float, str]]


class SlopeWatch:
    """The derivatives of `physical` against the baseline's."""

    def __init__(self, aircraft: Aircraft, forgetting_s: float, errors: Errors) -> None:
        known = [aircraft.derivatives.get(n) for n in LONGITUDINAL]
        self._base = [(d.value, d.sd or 0.0) if d is not None and d.sd is not None else None for d in known]
        self._shares = relative_errors(aircraft, LONGITUDINAL)
        self._patterns = tuple(p for p in patterns(aircraft) if p.shares[: len(LONGITUDINAL)].any())
        tests = sum(b is not None for b in self._base) + len(self._patterns)
        looks = FALSE_ALARM_H * 3600 / min(forgetting_s, 3600.0) * _CONTINUOUS * tests
        self.limit = float(norm.isf(0.5 / max(looks, 1.0)))
        """Standard errors from which a derivative has changed."""
        self.changes: dict[str, tuple[float, float]] = {}
        """Relative, with their standard errors."""
        self._since = 0
        self._errors = errors
        self._seen: tuple[object, ...] = ()
        self._is_off = False

    @property
    def is_on(self) -> bool:
        return any(b is not None for b in self._base)

    @property
    def told(self) -> bool:
        return self._since >= HELD_TICKS

    def step(self, frame: Frame, methods: Sequence[MethodEstimate]) -> None:
        """One tick."""
        made = next((m for m in methods if m.method == "physical"), None)
        if made is None or not made.applicable:
            return
        # Estimates are renewed twice a second: until then nothing new can be made of them.
        seen = made.parameters[: len(LONGITUDINAL)], bool(frame.values[_MASS] > 0), self.told
        if seen != self._seen:
            self._seen, self._is_off = seen, self._stands_off(*seen)
        self._since = self._since + 1 if self._is_off else 0

    def _stands_off(self, parameters: Sequence[ParamEstimate], mass_recorded: bool, told: bool) -> bool:
        """Whether a derivative or a pattern does, of a renewed estimate."""
        self.changes = {}
        shares, unshared = self._shares[int(mass_recorded)].tolist(), self._errors()
        for p, base, share in zip(parameters, self._base, shares, strict=False):
            if base is None or p.status is not Status.ESTIMATED or not base[0]:
                continue
            own = unshared.get(p.name, math.sqrt(max(p.sd**2 - (share * p.value) ** 2, 0.0)))
            error = math.hypot(own, base[1])
            self.changes[p.name] = ((p.value - base[0]) / base[0], error / abs(base[0]))
        # What has been told stays until it is half back.
        limit = self.limit * (0.5 if told else 1.0)
        is_off = any(abs(v) > limit * e for v, e in self.changes.values())
        return is_off or any(m.amount > limit * m.error for m in matches(self.changes, self._patterns))


def _recorded(frame: Frame) -> tuple[float, str]:
    return frame.values[_THRUST], "thrust is not recorded"


class _Said(NamedTuple):
    """What the last event was about."""

    t_ns: int
    by: frozenset[str]
    """Which watches: drag, lift, slopes."""
    names: tuple[str, ...]
    """Of what it looks like, the likeliest first."""

    def news(self, by: Set[str], names: Set[str]) -> bool:
        """Whether more stands off, what was said first is out of the question, or one is left of several."""
        is_other = bool(self.names or names) and not set(self.names[:1]) & names
        return bool(by - self.by) or is_other or len(names) == 1 < len(self.names)


class ChangeMonitor:
    """Both watches, and what is said of them: one event when a change is noticed or looks otherwise, one when it is
    over."""

    def __init__(
        self, aircraft: Aircraft, forgetting_s: float, errors: Errors = dict, thrust: Thrust | None = None
    ) -> None:
        """Of an aircraft with `measured`; `forgetting_s`: of the estimator's `physical`; `errors`: its standard errors
        as of the last tick, by derivative, without what baseline and flight share; by its rows where it gives none.
        `thrust`: the estimator's as of the last tick, N, NaN where nothing tells it, and why; else the frame's."""
        self.drag = DragWatch(aircraft)
        self.slopes = SlopeWatch(aircraft, forgetting_s, errors)
        self._thrust = thrust
        self._aircraft = aircraft
        self._said: _Said | None = None
        self._ticks = 0
        self._without_drag = False
        """Whether it is said that drag is not watched."""
        self._blind: int | None = None
        """Ticks since the angle of attack was lost; None before there was one."""

    def step(self, frame: Frame, alpha: AlphaEstimate, methods: Sequence[MethodEstimate]) -> tuple[Event, ...]:
        """A tick's rows; at most one event on the aircraft each second, and one where it can be watched no more."""
        if self.drag.is_on and (alpha.valid or self._blind is not None):
            self.drag.step(frame, alpha, *(self._thrust() if self._thrust else _recorded(frame)))
        self.slopes.step(frame, methods)
        self._ticks += 1
        if (lost := self._sight(frame, alpha) or self._sight_of_drag(frame)) is not None:
            return (lost,)
        if self._ticks % TICK_HZ:
            return ()
        watches = {"drag": self.drag.told, "lift": self.drag.lift_told, "slopes": self.slopes.told}
        by = frozenset(name for name, told in watches.items() if told)
        if not by:
            over, self._said = self._said is not None, None
            words = "as the baseline again, within its error"
            return (Event(frame.t_ns, SOURCE, Code.UNCHANGED, 1, words),) if over else ()
        changes = dict(self.slopes.changes)
        if self.drag.is_on and self.drag.change is not None:
            changes["CD_0"] = self.drag.change
        if self.drag.is_on and self.drag.lift_change is not None:
            changes["CL_0"] = self.drag.lift_change
        found = matches(changes, patterns(self._aircraft, self.drag.lift))
        names = {m.pattern.name for m in found}
        said = self._said
        if said is not None and (not said.news(by, names) or frame.t_ns - said.t_ns < AGAIN_NS):
            return ()
        self._said = _Said(frame.t_ns, by, tuple(m.pattern.name for m in found))
        return (Event(frame.t_ns, SOURCE, Code.CHANGED, 1, self._words(changes, in_words(found))),)

    def _sight(self, frame: Frame, alpha: AlphaEstimate) -> Event | None:
        """That nothing can be noticed any more, or again."""
        if alpha.valid:
            blind, self._blind = self._blind or 0, 0
            if blind < BLIND_TICKS:
                return None
            # Of the mean that went by without it has been said.
            self.drag.begin()
            words = "the angle of attack is back: watched against the baseline again"
            return Event(frame.t_ns, SOURCE, Code.WATCHED, 0, words)
        if self._blind is None:
            return None
        self._blind += 1
        words = (
            "no angle of attack: ice, or another change, would NOT be noticed now; "
            f"{'watch power and airspeed' if self._said is None else 'what was told before stands'}"
        )
        return Event(frame.t_ns, SOURCE, Code.UNWATCHED, 1, words) if self._blind == BLIND_TICKS else None

    def _sight_of_drag(self, frame: Frame) -> Event | None:
        """That drag alone is watched no more, or again."""
        why = self.drag.lacking
        if self._without_drag and not why:
            self._without_drag = False
            return Event(frame.t_ns, DRAG, Code.WATCHED, 0, "drag is watched against the baseline again")
        # Without an angle of attack it has been said of all there is.
        if self._without_drag or not why or (self._blind or 0) >= BLIND_TICKS:
            return None
        self._without_drag = True
        left = "derivatives still are, while inputs are flown" if self.slopes.is_on else "nor is anything else"
        told = "; the rise of drag told before stands" if self.drag.told else ""
        words = f"{why}: drag is NOT watched, ice without an input would NOT be noticed; {left}{told}"
        return Event(frame.t_ns, DRAG, Code.UNWATCHED, 1, words)

    def _words(self, changes: dict[str, tuple[float, float]], like: str) -> str:
        beyond, of_level = self.slopes.limit, {"CD_0": self.drag.told, "CL_0": self.drag.lift_told}
        off = {n: c for n, c in changes.items() if of_level.get(n, abs(c[0]) > 0.5 * beyond * c[1])}
        named = ", ".join(f"{'drag' if n == 'CD_0' else n} {100 * v:+.0f}±{200 * s:.0f} %" for n, (v, s) in off.items())
        silent = "" if self.drag.is_on else "; of drag nothing is known: no baseline of it"
        return f"{named}: {like}. By chance once in {FALSE_ALARM_H:.0f} h{silent}"
