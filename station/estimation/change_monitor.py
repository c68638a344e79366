"""Notices in flight that the aircraft is no longer the one that `station baseline` measured: ice, above all.

Two watches, each with a false alarm once in FALSE_ALARM_H of flight as it is set:
drag    CD_0 by the power that the flight shows, means of 10 s, in a cumulative sum (Page 1954) set for a rise by
        DRAG_TOLD, its limit by Siegmund's approximation of the time between false alarms. Only with recorded thrust.
slopes  the derivatives of `physical`, which forgets, each, and all of a pattern together, against the baseline over
        their joint error: without what both share, mass, inertia and the choice of the model. Of an aircraft that
        changes, the past that is not yet forgotten and the present agree with no model, and the distance to the next
        best one would hide the change.
What has changed is named by its pattern (change_patterns), with what it is not told from and what would confirm it.

step never raises; the same rows give the same events.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence, Set
from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm

from station.conventions import G0, LONGITUDINAL, SIGNAL_INDEX, TICK_HZ
from station.model.airframe_error import relative_errors
from station.model.change_patterns import in_words, matches, patterns
from station.profile import Aircraft
from station.rows import AlphaEstimate, Code, Event, Frame, MethodEstimate, ParamEstimate, Status

SOURCE: Final = "aircraft"
FALSE_ALARM_H: Final = 20.0
"""Hours between false alarms of either watch: together one in ten."""
BLOCK_S: Final = 10.0
"""Over which drag is a mean."""
DRAG_TOLD: Final = 0.2
"""Rise of CD_0, of itself, that the sum is set for: two fifths of the reference icing condition's."""
KNOWN_WITHIN: Final = 2.0
"""Standard deviations that the baseline's CD_0 is allowed to be off before a rise counts."""
LEAST_SIGMA: Final = 0.25
"""Of DRAG_TOLD, that a mean is taken to scatter at least: a single mean that is off is no alarm."""
FIRST_SIGMA: Final = 0.5
FIRST_BLOCKS: Final = 6
"""The scatter that is taken before it is seen, of DRAG_TOLD, and how many means it counts for."""
SEEN_BLOCKS: Final = 30
"""Over which the scatter is seen."""
RECENT_BLOCKS: Final = 3
"""Whose mean is what drag is now."""
_CONTINUOUS: Final = 4.0
"""Looks that continuous watching counts for in each time constant of what is forgotten."""
HELD_TICKS: Final = 5 * TICK_HZ
"""A derivative must stand off so long."""
BLIND_TICKS: Final = 10 * TICK_HZ
"""Without angle of attack after which it is said that nothing is noticed: a mean of drag."""
AGAIN_NS: Final = 60_000_000_000
"""At the least between two events on a change that goes on."""
_V, _QBAR, _AX, _AZ, _THRUST, _MASS = (
    SIGNAL_INDEX[n] for n in ("airspeed", "dynamic_pressure", "ax", "az", "thrust", "mass")
)


Errors = Callable[[], Mapping[str, float]]


def limit_of_sum(shift: float, blocks: float) -> float:
    """Of a cumulative sum of values of variance 1 less `shift`, reached by chance once in so many of them on average
    (Siegmund 1985: (exp(2 d b) - 2 d b - 1)/(2 d^2), b = h + 1.166)."""

    def excess(b: float) -> float:
        return math.expm1(2 * shift * b) - 2 * shift * b - 2 * shift**2 * blocks

    return max(float(brentq(excess, 1e-6, 40.0 / max(2 * shift, 1e-3))) - 1.166, 0.1)


class DragWatch:
    """CD_0 against the baseline's."""

    def __init__(self, aircraft: Aircraft) -> None:
        measured = aircraft.measured
        self._base = measured.CD_0 if measured else None
        self._allowed = KNOWN_WITHIN * measured.CD_0_sd if measured else 0.0
        self._area, self._mass = aircraft.geometry.wing_area, aircraft.inertia.mass
        self._cos, self._sin = math.cos(aircraft.thrust_angle), math.sin(aircraft.thrust_angle)
        self._induced = aircraft.drag.induced if aircraft.drag else 0.0
        self._doubt = aircraft.uncertainty.induced_drag * self._induced
        speeds = (measured.lowest_speed, measured.highest_speed) if measured else (1.0, 1.0)
        self._speeds = (min(speeds), max(speeds))
        self._sum = self._sum_of_squares = 0.0
        self._count = self._ticks = 0
        self._lift = self._pressure = 0.0
        self._last = math.nan
        step = (self._base or 0.0) * DRAG_TOLD
        self._step = step
        self._variance = (FIRST_SIGMA * step) ** 2
        self._blocks = FIRST_BLOCKS
        self.cumulated = 0.0
        self.limit = math.inf
        self._recent: list[float] = []
        self._by_lift = 0.0

    @property
    def is_on(self) -> bool:
        return self._base is not None and self._base > 0

    @property
    def told(self) -> bool:
        return self.cumulated > self.limit

    @property
    def change(self) -> tuple[float, float] | None:
        """Relative, with its standard error, told or not: that drag has not risen tells one change from another too."""
        if not self._recent or not self._base:
            return None
        error = math.sqrt(self._variance / len(self._recent)) + 0.5 * self._allowed + abs(self._by_lift)
        return float(np.mean(self._recent)) / self._base - 1.0, error / self._base

    def step(self, frame: Frame, alpha: AlphaEstimate) -> None:
        """One tick."""
        self._ticks += 1
        v = frame.values
        if alpha.valid and all(math.isfinite(v[i]) for i in (_QBAR, _AX, _AZ, _THRUST)) and v[_QBAR] > 0:
            mass = v[_MASS] if v[_MASS] > 0 else self._mass
            force = v[_QBAR] * self._area
            cx = (mass * v[_AX] - v[_THRUST] * self._cos) / force
            cz = (mass * v[_AZ] + v[_THRUST] * self._sin) / force
            sin, cos = math.sin(alpha.alpha), math.cos(alpha.alpha)
            lift = cx * sin - cz * cos
            self._sum += -cx * cos - cz * sin - self._induced * lift * lift
            self._lift += lift
            self._pressure += v[_QBAR] / max(v[_V], 1.0) ** 2 if math.isfinite(v[_V]) else math.nan
            self._count += 1
        if self._ticks >= BLOCK_S * TICK_HZ:
            if self._count > 0.5 * self._ticks:
                self._block(self._sum / self._count, self._lift / self._count, 2 * self._pressure / self._count)
            self._sum = self._lift = self._pressure = 0.0
            self._count = self._ticks = 0

    def _block(self, drag: float, lift: float, density: float) -> None:
        """A mean of BLOCK_S: CD_0, CL, and the air's density."""
        assert self._base is not None
        if math.isfinite(self._last):
            seen = 0.5 * (drag - self._last) ** 2
            weight = 1.0 / min(self._blocks, SEEN_BLOCKS)
            self._variance += weight * (seen - self._variance)
            self._blocks += 1
        self._last = drag
        sigma = max(math.sqrt(self._variance), LEAST_SIGMA * self._step)
        shift = 0.5 * self._step / sigma
        self.limit = limit_of_sum(shift, FALSE_ALARM_H * 3600 / BLOCK_S)
        self._by_lift = self._of_lift(lift, density)
        excess = (drag - self._base - self._allowed - self._by_lift) / sigma
        self.cumulated = min(max(0.0, self.cumulated + excess - shift), 2 * self.limit)
        self._recent = [*self._recent[1 - RECENT_BLOCKS :], drag]

    def _of_lift(self, lift: float, density: float) -> float:
        """What the doubt of the induced drag makes of a lift coefficient that the baseline did not have."""
        if not math.isfinite(density) or density <= 0:
            return 0.0
        slow, fast = (self._mass * G0 / (0.5 * density * v * v * self._area) for v in self._speeds)
        beyond = max(lift - slow, fast - lift, 0.0)
        return self._doubt * beyond * (lift + slow)


class SlopeWatch:
    """The derivatives of `physical` against the baseline's."""

    def __init__(self, aircraft: Aircraft, forgetting_s: float, errors: Errors) -> None:
        known = [aircraft.derivatives.get(n) for n in LONGITUDINAL]
        self._base = [(d.value, d.sd or 0.0) if d is not None and d.sd is not None else None for d in known]
        self._shares = relative_errors(aircraft, LONGITUDINAL)
        tests = sum(b is not None for b in self._base) + len(patterns(aircraft))
        looks = FALSE_ALARM_H * 3600 / min(forgetting_s, 3600.0) * _CONTINUOUS * tests
        self.limit = float(norm.isf(0.5 / max(looks, 1.0)))
        """Standard errors from which a derivative has changed."""
        self.changes: dict[str, tuple[float, float]] = {}
        """Relative, with their standard errors."""
        self._since = 0
        self._errors = errors
        self._patterns = patterns(aircraft)
        self._seen: tuple[object, ...] = ()
        self._is_off = False

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


class _Said(NamedTuple):
    """What the last event was about."""

    t_ns: int
    by_drag: bool
    by_slopes: bool
    names: tuple[str, ...]
    """Of what it looks like, the likeliest first."""

    def news(self, by_drag: bool, by_slopes: bool, names: Set[str]) -> bool:
        """Whether more stands off, what was said first is out of the question, or one is left of several."""
        more = (by_drag and not self.by_drag) or (by_slopes and not self.by_slopes)
        is_other = bool(self.names or names) and not set(self.names[:1]) & names
        return more or is_other or len(names) == 1 < len(self.names)


class ChangeMonitor:
    """Both watches, and what is said of them: one event when a change is noticed or looks otherwise, one when it is
    over."""

    def __init__(self, aircraft: Aircraft, forgetting_s: float, errors: Errors = dict) -> None:
        """Of an aircraft with `measured`; `forgetting_s`: of the estimator's `physical`; `errors`: its standard errors
        as of the last tick, by derivative, without what baseline and flight share; by its rows where it gives none."""
        self.drag = DragWatch(aircraft)
        self.slopes = SlopeWatch(aircraft, forgetting_s, errors)
        self._patterns = patterns(aircraft)
        self._said: _Said | None = None
        self._ticks = 0
        self._blind: int | None = None
        """Ticks since the angle of attack was lost; None before there was one."""

    def step(self, frame: Frame, alpha: AlphaEstimate, methods: Sequence[MethodEstimate]) -> tuple[Event, ...]:
        """A tick's rows; at most one event on the aircraft each second, and one where it can be watched no more."""
        if self.drag.is_on:
            self.drag.step(frame, alpha)
        self.slopes.step(frame, methods)
        self._ticks += 1
        if (lost := self._sight(frame, alpha)) is not None:
            return (lost,)
        if self._ticks % TICK_HZ:
            return ()
        by_drag, by_slopes = self.drag.is_on and self.drag.told, self.slopes.told
        if not (by_drag or by_slopes):
            over, self._said = self._said is not None, None
            words = "as the baseline again, within its error"
            return (Event(frame.t_ns, SOURCE, Code.UNCHANGED, 1, words),) if over else ()
        changes = dict(self.slopes.changes)
        if self.drag.is_on and self.drag.change is not None:
            changes["CD_0"] = self.drag.change
        found = matches(changes, self._patterns)
        names = {m.pattern.name for m in found}
        said = self._said
        if said is not None and (not said.news(by_drag, by_slopes, names) or frame.t_ns - said.t_ns < AGAIN_NS):
            return ()
        self._said = _Said(frame.t_ns, by_drag, by_slopes, tuple(m.pattern.name for m in found))
        return (Event(frame.t_ns, SOURCE, Code.CHANGED, 1, self._words(changes, by_drag, in_words(found))),)

    def _sight(self, frame: Frame, alpha: AlphaEstimate) -> Event | None:
        """That nothing can be noticed any more, or again."""
        if alpha.valid:
            blind, self._blind = self._blind or 0, 0
            words = "the angle of attack is back: watched against the baseline again"
            return Event(frame.t_ns, SOURCE, Code.WATCHED, 0, words) if blind >= BLIND_TICKS else None
        if self._blind is None:
            return None
        self._blind += 1
        words = (
            "no angle of attack: ice, or another change, would NOT be noticed now; "
            f"{'watch power and airspeed' if self._said is None else 'what was told before stands'}"
        )
        return Event(frame.t_ns, SOURCE, Code.UNWATCHED, 1, words) if self._blind == BLIND_TICKS else None

    def _words(self, changes: dict[str, tuple[float, float]], by_drag: bool, like: str) -> str:
        beyond = self.slopes.limit
        off = {n: c for n, c in changes.items() if (by_drag if n == "CD_0" else abs(c[0]) > 0.5 * beyond * c[1])}
        named = ", ".join(f"{'drag' if n == 'CD_0' else n} {100 * v:+.0f}±{200 * s:.0f} %" for n, (v, s) in off.items())
        silent = "" if self.drag.is_on else "; of drag nothing is known: no baseline of it"
        return f"{named}: {like}. By chance once in {FALSE_ALARM_H:.0f} h{silent}"
