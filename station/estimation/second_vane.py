"""Further angle-of-attack vanes that a rig declares (`measures = "alpha_vane"`, `position`): watched, and in reserve.

A vane shows (1 + k_body)(q x - p y)/V less where it is further ahead or left, and a share of its own upwash more:
brought to the first vane's place, both show the same but for zeros, scales, and gusts that meet the one before the
other. Where their difference, over seconds, is beyond TOLERANCE it is told, with the one that the motion agrees with;
where the first vane is missing, the second stands in for it, less the difference that they last had while both agreed.
Where the profile wants both `averaged`, half of what they differ by beyond that is added to the first while they agree:
vanes on both tips then show the gust in the middle of the span.

Deterministic; step and seen never raise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from station import profile
from station.conventions import SIGNAL_INDEX, TICK_HZ, from_si
from station.profile import NO_BOOM, Aircraft, Boom
from station.rows import AlphaEstimate, Code, Event, Frame

TOLERANCE: Final = math.radians(0.5)
"""As of a vane's bias against the motion: below it nothing is told."""
BY_GUSTS: Final = 4.0
"""Standard deviations of what gusts make of the difference's mean that are no disagreement: 1 window in 16,000."""
AGREED: Final = 0.5
"""Share of that within which they agree again."""
WINDOW_S: Final = 4.0
"""Time constant of the difference's mean: a short period and the gusts of a second are gone."""
SETTLED: Final = round(2 * WINDOW_S * TICK_HZ)
KNOWN_S: Final = 60.0
"""Time constant of the difference that a stand-in is corrected by."""
MISSING: Final = TICK_HZ // 5
"""Ticks without the first vane from which it is told."""
_VANE, _P, _Q, _V = (SIGNAL_INDEX[n] for n in ("alpha_vane", "p", "q", "airspeed"))

Position = tuple[float, float, float]


class SecondVane:
    """One further vane."""

    def __init__(self, name: str, column: int, position: Position, aircraft: Aircraft) -> None:
        """`column`: its place in a frame's values; `position`: m from the CG, body axes."""
        boom = aircraft.boom or NO_BOOM
        own = aircraft.second_vane or boom
        self.name = name
        self.averaged = isinstance(own, profile.SecondVane) and own.averaged
        self._column = column
        self._first = _placed(boom, (boom.vane_x, boom.vane_y))
        self._own = _placed(own, position)
        self._apart = math.dist(position, (boom.vane_x, boom.vane_y, boom.vane_z))
        self._scale = boom.steady_calibration
        self._upwash = own.steady_calibration / boom.steady_calibration
        self._zeros = boom.zero, own.zero
        self._mean = self._known = self._motion = self._variance = 0.0
        self._count = self._alone = 0
        self._told = False
        self._limit = TOLERANCE

    def tolerance(self, rms: float, speed: float) -> float:
        """By how much the difference's mean over WINDOW_S may be off where it varies by `rms` about that, rad, at an
        airspeed (m/s): gusts that one vane meets and the other does not are gone within the way between both."""
        passing = self._apart / speed if speed > 1.0 else 0.0
        return max(TOLERANCE, BY_GUSTS * rms * math.sqrt(min(2.0 * passing / WINDOW_S, 1.0)))

    def brought(self, shown: float, p: float, q: float, speed: float) -> float:
        """What it would show at the first vane's place; without rates or airspeed what it shows."""
        p = p if math.isfinite(p) else 0.0
        first, own = (y * p - x * q for x, y in (self._first, self._own))
        if not (math.isfinite(first) and speed > 1.0):
            first, own, speed = 0.0, 0.0, 1.0
        return self._upwash * (shown - self._zeros[1] - own / speed) + self._zeros[0] + first / speed

    def seen(self, frame: Frame) -> Frame:
        """The frame with this vane in place of the first where that is missing."""
        v = frame.values
        second = self.brought(v[self._column], v[_P], v[_Q], v[_V])
        if math.isfinite(v[_VANE]):
            self._alone = 0
            if not math.isfinite(second):
                return frame
            self._compared(second - v[_VANE])
            self._limit = self.tolerance(math.sqrt(self._variance), v[_V])
            if not self.averaged or self._told:
                return frame
            mean = v[_VANE] + 0.5 * (second - self._known - v[_VANE])
            return Frame(frame.t_ns, frame.k, (*v[:_VANE], mean, *v[_VANE + 1 :]), frame.age_s, frame.quality)
        self._alone += 1
        if not math.isfinite(second):
            return frame
        values, ages, quality = list(v), list(frame.age_s), list(frame.quality)
        values[_VANE] = second - self._known
        ages[_VANE], quality[_VANE] = ages[self._column], quality[self._column]
        return Frame(frame.t_ns, frame.k, tuple(values), tuple(ages), tuple(quality))

    def _compared(self, difference: float) -> None:
        self._count += 1
        self._mean += (difference - self._mean) / min(self._count, WINDOW_S * TICK_HZ)
        self._variance += ((difference - self._mean) ** 2 - self._variance) / min(self._count, KNOWN_S * TICK_HZ)
        if not self._told:
            self._known += (difference - self._known) / min(self._count, KNOWN_S * TICK_HZ)

    def step(self, frame: Frame, alpha: AlphaEstimate) -> tuple[Event, ...]:
        """After the frame has been `seen`: what is to be told. `alpha`: made of the first vane where there is one."""
        if self._alone == MISSING and math.isfinite(frame.values[self._column]):
            known = from_si(-self._known, "deg")
            words = f"alpha_vane is missing: {self.name} stands in for it, {known:+.1f} deg by what they differed"
            return (Event(frame.t_ns, "alpha_vane.second", Code.DISAGREE, 1, words),)
        if self._alone == 0 and alpha.valid and math.isfinite(alpha.alpha_inertial):
            self._motion += (alpha.alpha - alpha.alpha_inertial - self._motion) / (WINDOW_S * TICK_HZ)
        if self._count < SETTLED or frame.k % TICK_HZ or self._alone:
            return ()
        far = abs(self._mean)
        if not self._told and far > self._limit:
            self._told = True
            return (Event(frame.t_ns, f"{self.name}.bias", Code.DISAGREE, 1, self._words()),)
        if self._told and far < AGREED * self._limit:
            self._told = False
            return (Event(frame.t_ns, f"{self.name}.bias", Code.AGREE, 1, "agrees with alpha_vane again"),)
        return ()

    def _words(self) -> str:
        way = "high" if self._mean > 0 else "low"
        first, second = abs(self._motion), abs(self._motion + self._scale * self._mean)
        right = "alpha_vane" if first < second else self.name
        by = f": the motion agrees with {right}" if abs(first - second) > AGREED * self._limit else ""
        return f"{self.name} {from_si(abs(self._mean), 'deg'):.1f} deg {way} against alpha_vane{by}"


def _placed(vane: Boom, place: tuple[float, ...]) -> tuple[float, float]:
    """Its place ahead and right of the CG, m, each by what a flow angle there shows of itself."""
    return (1 + vane.upwash_body) * place[0], (1 + vane.upwash_body) * place[1]


def second_vanes(
    places: Mapping[str, Position], index: Mapping[str, int], aircraft: Aircraft
) -> tuple[SecondVane, ...]:
    """Of a rig: by name where each is, and its column in frames."""
    return tuple(SecondVane(name, index[name], position, aircraft) for name, position in places.items())
