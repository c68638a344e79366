"""The limits of card and rig, watched at every tick: an alarm while one is exceeded."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Final, NamedTuple

from station.conventions import G0, SIGNAL_INDEX, TICK_HZ, from_si
from station.profile import DeclaredSignal, DerivedSignal, Limits, Rig
from station.rows import AlphaEstimate, Code, Event, Frame

LASTS_S: Final = 0.1
"""Exceeded for so long before it is told: one bad sample is none."""
OVER_S: Final = 1.0
"""Kept for so long before it is over."""


class ShownSignal(NamedTuple):
    """A signal that a rig declares or derives: its column in a frame, units, and limits (SI)."""

    name: str
    column: int
    unit: str
    """To show it in."""
    si: str
    low: float | None = None
    high: float | None = None


def shown_signals(rig: Rig) -> tuple[ShownSignal, ...]:
    """Beyond the station's own."""
    every: Mapping[str, DeclaredSignal | DerivedSignal] = {**rig.signals, **rig.derived}
    return tuple(_of(rig, n, every[n]) for n in rig.further.units)


def limited_signals(rig: Rig) -> tuple[ShownSignal, ...]:
    """All that the rig gives limits to, signals of the station, too."""
    every: Mapping[str, DeclaredSignal | DerivedSignal] = {**rig.signals, **rig.derived}
    found = (_of(rig, n, s) for n, s in every.items())
    return tuple(s for s in found if s.low is not None or s.high is not None)


def _of(rig: Rig, name: str, s: DeclaredSignal | DerivedSignal) -> ShownSignal:
    return ShownSignal(name, rig.further.index[name], s.unit, s.si, s.limit_low, s.limit_high)


class LimitWatch:
    """Tells when a limit is exceeded, and when no more."""

    def __init__(self, limits: Limits, signals: Iterable[ShownSignal] = ()) -> None:
        """`signals` with the limits of a rig."""
        self._limits, self._signals = limits, tuple(signals)
        self._beyond: dict[str, int] = {}
        """Ticks in a row that a limit has been exceeded, by name; negative once it was told, of those it has not."""

    def step(self, frame: Frame, alpha: AlphaEstimate | None) -> list[Event]:
        """Events of one tick: LIMIT of the one exceeded, FRESH when it is over."""
        told = []
        for name, value, limit, sign, unit in self._looked_at(frame, alpha):
            if not math.isfinite(value):
                continue
            beyond = sign * (value - limit) > 0
            ticks = self._beyond.get(name, 0)
            if ticks >= 0:
                ticks = ticks + 1 if beyond else 0
                if ticks > LASTS_S * TICK_HZ:
                    at, most = (f"{from_si(x, unit):+.3g} {unit}".removesuffix(" 1") for x in (value, limit))
                    told.append(Event(frame.t_ns, name, Code.LIMIT, 1, f"{at}: the limit is {most}"))
                    ticks = -1
            else:
                ticks = -1 if beyond else ticks - 1
                if ticks < -OVER_S * TICK_HZ:
                    told.append(Event(frame.t_ns, name, Code.FRESH, 1, f"{Code.LIMIT} no longer exceeded"))
                    ticks = 0
            self._beyond[name] = ticks
        return told

    def _looked_at(self, frame: Frame, alpha: AlphaEstimate | None) -> Iterator[tuple[str, float, float, int, str]]:
        """Name, value, limit, side on which it is exceeded, and unit to tell it in, of each that the card gives."""
        values, at = frame.values, self._limits

        def signal(name: str) -> float:
            return values[SIGNAL_INDEX[name]]

        bank, pitch, speed = signal("phi"), signal("theta"), signal("airspeed")
        angle = alpha.alpha if alpha is not None and alpha.valid else signal("alpha_vane")
        load, side = -signal("az") / G0, signal("beta_vane")
        for name, value, limit, sign, unit in (
            ("bank", abs(bank), at.bank, 1, "deg"),
            ("nose up", pitch, at.nose_up, 1, "deg"),
            ("nose down", pitch, None if at.nose_down is None else -at.nose_down, -1, "deg"),
            ("angle of attack", angle, at.angle_of_attack, 1, "deg"),
            ("sideslip", abs(side), at.sideslip, 1, "deg"),
            ("load factor", load, at.load_factor, 1, "1"),
            ("least load factor", load, at.least_load_factor, -1, "1"),
            ("speed", speed, at.speed, 1, "kt"),
            ("least speed", speed, at.least_speed, -1, "kt"),
        ):
            if limit is not None:
                yield name, value, limit, sign, unit
        for s in self._signals:
            # Of two limits the one that is nearer, in their middle either.
            if s.high is not None and (s.low is None or values[s.column] > 0.5 * (s.low + s.high)):
                yield s.name, values[s.column], s.high, 1, s.unit
            elif s.low is not None:
                yield s.name, values[s.column], s.low, -1, s.unit
