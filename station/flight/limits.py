"""The card's limits, watched at every tick: an alarm while one is exceeded."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from station.conventions import G0, SIGNAL_INDEX, TICK_HZ, from_si
from station.profile import Limits
from station.rows import AlphaEstimate, Code, Event, Frame

LASTS_S: Final = 0.1
"""Exceeded for so long before it is told: one bad sample is none."""
OVER_S: Final = 1.0
"""Kept for so long before it is over."""


class LimitWatch:
    """Tells when a limit is exceeded, and when no more."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
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
