"""What comes from outside into a flight, as it holds now: the newest values; held, then faded to trim, in silence.

A value that jumps farther than a hand or an actuator moves is not flown until it has stood there for a while: a wire
that came off is not a control movement. Time is an argument, seconds of any one clock.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from station.rows import Code

STANDS_S: Final = 0.1
"""After so long at its new place a value that has jumped is believed: a loose wire chatters, a moved stop does not."""
FARTHEST: Final = 1.2
"""Of a surface's travel, or the most thrust: what is beyond is no position of it."""


@dataclass(slots=True)
class _Heard:
    value: float
    t_s: float
    jumped: float = math.nan
    """Where it has jumped to, when, and whether that has been told."""
    jumped_s: float = 0.0
    silent: bool = False
    there_s: float = -math.inf
    """When whoever says it was last there, without saying it anew."""


@dataclass(frozen=True, slots=True)
class Outside:
    """What comes from outside of some names: surfaces, rad, and thrust, N."""

    rest: Mapping[str, float]
    """By name, where each is in trim."""
    hold: float
    """Who falls silent is flown as heard last for so long, s."""
    fade: float
    """Then it goes to trim with this time constant, s."""
    jump: float = math.inf
    """Farthest that a surface moves from one value to the next, rad."""
    travel: Mapping[str, float] = field(default_factory=dict)
    """How far each surface moves from 0 at most, rad; the most thrust, N."""
    _heard: dict[str, _Heard] = field(default_factory=dict)
    _impossible: set[str] = field(default_factory=set)
    """Whose last value was no position, which has been told."""
    _gone: list[str] = field(default_factory=list)
    """Silent since this was last told,"""
    _returned: list[str] = field(default_factory=list)
    """and heard again."""
    _told: list[tuple[Code, str]] = field(default_factory=list)

    def take(self, t_s: float, name: str, value: float) -> None:
        """A value has come."""
        if not self._is_possible(name, value):
            return
        known = self._heard.get(name)
        if known is None:
            self._heard[name] = _Heard(value, t_s)
            self._told.append((Code.HEARD, f"{name}: flown from outside"))
            return
        jump = self.jump if name in self.travel else math.inf
        if abs(value - known.value) > jump and not known.silent and not self._stands(name, known, t_s, value, jump):
            return
        if known.silent:
            self._returned.append(name)
        self._heard[name] = _Heard(value, t_s)

    def _is_possible(self, name: str, value: float) -> bool:
        if math.isfinite(value) and abs(value) <= FARTHEST * self.travel.get(name, math.inf):
            self._impossible.discard(name)
            return True
        if name not in self._impossible:
            self._impossible.add(name)
            words = _newtons if name == "thrust" else _degrees
            most = "the engines give" if name == "thrust" else "the surface moves"
            limit = f", and {most} {words(self.travel[name])}" if name in self.travel else ""
            self._told.append((Code.RANGE, f"{name}: {words(value)} from outside{limit}: not flown"))
        return False

    def _stands(self, name: str, known: _Heard, t_s: float, value: float, jump: float) -> bool:
        """Whether a value that has jumped has stood at its new place for long enough."""
        if math.isnan(known.jumped) or abs(value - known.jumped) > jump:
            if math.isnan(known.jumped):
                was, now = _degrees(known.value), _degrees(value)
                self._told.append((Code.JUMP, f"{name}: from {was} to {now} at once: held until it stays there"))
            known.jumped, known.jumped_s = value, t_s
        # It is heard, though not believed: not silence.
        known.t_s = t_s
        return t_s - known.jumped_s >= STANDS_S

    def at(self, t_s: float) -> dict[str, float]:
        """What is flown now, by name; what was never heard is in trim."""
        out = dict(self.rest)
        for name, known in self._heard.items():
            silent_s = t_s - max(known.t_s, known.there_s)
            if silent_s <= self.hold:
                out[name] = known.value
                if known.silent:
                    known.silent = False
                    self._returned.append(name)
                continue
            if not known.silent:
                known.silent = True
                self._gone.append(name)
            left = math.exp(-(silent_s - self.hold) / self.fade)
            out[name] = self.rest[name] + left * (known.value - self.rest[name])
        return out

    def still(self, t_s: float) -> None:
        """Who tells changes alone is there, and has none to tell."""
        for known in self._heard.values():
            known.there_s = t_s

    def newest_s(self) -> float:
        """When the last value came; NaN before the first."""
        return max((known.t_s for known in self._heard.values()), default=math.nan)

    def told(self) -> list[tuple[Code, str]]:
        """What has happened since this was last asked."""
        said = self._told + self._silence()
        for told in (self._told, self._gone, self._returned):
            told.clear()
        return said

    def _silence(self) -> list[tuple[Code, str]]:
        """One alarm for all of them, which is over when none is silent any more."""
        silent = ", ".join(name for name, known in self._heard.items() if known.silent)
        returned = ", ".join(dict.fromkeys(self._returned))
        if silent and self._gone:
            return [(Code.STALE, f"{silent}: nothing from outside for {self.hold:g} s: fading to trim")]
        if silent and returned:
            return [(Code.STALE, f"{silent}: still nothing from outside; {returned} heard again")]
        return [(Code.FRESH, f"{Code.STALE} over: {returned} heard again")] if returned else []


def _newtons(value: float) -> str:
    return f"{value:.6g} N" if math.isfinite(value) else "no number"


def _degrees(value: float) -> str:
    return f"{math.degrees(value):.1f} deg" if math.isfinite(value) else "no number"
