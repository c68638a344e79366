"""Test points that are over: what each found, kept for whoever shows it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from station.profile import AIR
from station.rows import AlphaEstimate, Event, ParamEstimate


@dataclass(frozen=True, slots=True)
class FinishedPoint:
    """What a test point found by its end."""

    number: int
    note: str
    """Name, semicolon, condition."""
    begun_ns: int
    ended_ns: int
    method: str
    """The one to believe first when it ended."""
    found: tuple[ParamEstimate | None, ...]
    """That method's estimates, in the order of the derivatives asked for."""
    air: str
    """Worst class of turbulence while it was open; unknown where none was told."""
    valid_share: float
    """Of its ticks, those with a valid angle of attack; NaN where there were none."""


class FinishedPoints:
    """Follows the open test point; `ended` holds those that are over, oldest first."""

    def __init__(self) -> None:
        self.ended: tuple[FinishedPoint, ...] = ()
        self._begun: Event | None = None
        self._worst = 0
        self._ticks = self._valid = 0

    def begin(self, event: Event) -> None:
        self._begun = event
        self._worst = self._ticks = self._valid = 0

    def take(self, row: AlphaEstimate) -> None:
        """An estimate while a point is open."""
        self._ticks += 1
        self._valid += row.valid
        if row.turbulence in AIR:
            self._worst = max(self._worst, 1 + AIR.index(row.turbulence))

    def end(self, event: Event, method: str, found: Callable[[], tuple[ParamEstimate | None, ...]]) -> None:
        """`found`: the estimates as they are now."""
        begun, self._begun = self._begun, None
        if begun is None:
            return
        self.ended += (
            FinishedPoint(
                number=event.count,
                note=event.detail or begun.detail,
                begun_ns=begun.t_ns,
                ended_ns=event.t_ns,
                method=method,
                found=found(),
                air=("unknown", *AIR)[self._worst],
                valid_share=self._valid / self._ticks if self._ticks else math.nan,
            ),
        )
