"""The aircraft against its measured baseline in numbers, for the screens: CD_0 as it is now, and by how much it and the
derivatives have changed. Events are the change monitor's, which works with the same."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from station.conventions import LONGITUDINAL, SIGNAL_INDEX
from station.model.airframe_error import relative_errors
from station.profile import Aircraft
from station.rows import AlphaEstimate, Frame, MethodEstimate, ParamEstimate, Status

if TYPE_CHECKING:
    from station.estimation.drag_watch import DragWatch
    from station.estimation.engine_thrust import EngineThrust

METHOD: Final = "physical"
"""Whose derivatives are held against the baseline, in flight as by the change monitor."""
OLD_NS: Final = 30_000_000_000
"""Without a new mean for as long as those that are shown took, three of 10 s, drag is not known any more."""


class DragNow(NamedTuple):
    """CD_0 of the last half minute and its standard error; its change, relative, with the baseline's error in it."""

    t_ns: int
    value: float
    sd: float
    change: float
    change_sd: float


class AgainstBaseline:
    """Follows a flight's rows; of an aircraft with `measured`."""

    def __init__(self, aircraft: Aircraft) -> None:
        assert aircraft.measured is not None
        self.CD_0 = aircraft.measured.CD_0
        """The baseline's; None where nothing was measured of drag."""
        self.history: list[DragNow] = []
        """A mean each, of the whole flight: one in ten seconds."""
        self._aircraft = aircraft
        self._watch: DragWatch | None = None
        self._engine: EngineThrust | None = None
        self._frame: Frame | None = None
        self._now_ns = 0
        self._base = {n: d for n in LONGITUDINAL if (d := aircraft.derivatives.get(n)) is not None and d.sd is not None}
        self._shares = relative_errors(aircraft, LONGITUDINAL)

    def take_frame(self, frame: Frame) -> None:
        self._frame = frame

    def take_alpha(self, alpha: AlphaEstimate) -> None:
        """Of the frame that was taken last."""
        self._now_ns = alpha.t_ns
        if self._frame is None or self.CD_0 is None:
            return
        if self._watch is None:  # with the first estimate: before the first bytes are recorded scipy takes too long
            from station.estimation.drag_watch import DragWatch
            from station.estimation.engine_thrust import EngineThrust

            self._watch = DragWatch(self._aircraft)
            self._engine = EngineThrust(self._aircraft) if self._aircraft.engine is not None else None
        if not self._watch.is_on:
            return
        thrust = self._frame.values[SIGNAL_INDEX["thrust"]]
        if self._engine is not None and not math.isfinite(thrust):
            thrust = self._engine.step(self._frame)
        self._watch.step(self._frame, alpha, thrust, "no thrust")
        now, change = self._watch.now, self._watch.change
        if now is not None and change is not None and len(self.history) < self._watch.means:
            self.history.append(DragNow(alpha.t_ns, *now, *change))

    @property
    def drag(self) -> DragNow | None:
        """None before the first mean, and where there has been none for a while: without thrust, or angle of attack."""
        newest = self.history[-1] if self.history else None
        return newest if newest is not None and self._now_ns - newest.t_ns <= OLD_NS else None

    def changes(self, methods: Mapping[str, MethodEstimate]) -> dict[str, tuple[float, float]]:
        """Of each derivative, relative, with its standard error: without mass and inertia, which are shared."""
        row = methods.get(METHOD)
        if row is None or not row.applicable:
            return {}
        weighed = self._frame is not None and self._frame.values[SIGNAL_INDEX["mass"]] > 0
        shares = dict(zip(LONGITUDINAL, self._shares[int(weighed)].tolist(), strict=True))
        found = ((p, self._base.get(p.name)) for p in row.parameters if p.status is Status.ESTIMATED)
        return {p.name: _change(p, b.value, b.sd or 0.0, shares[p.name]) for p, b in found if b is not None and b.value}

    def snapshot(self, methods: Mapping[str, MethodEstimate]) -> dict[str, Any]:
        """For JSON lines; changes in per cent."""
        drag = self.drag
        of_drag = {} if drag is None else {"CD_0": (drag.change, drag.change_sd)}
        return {
            "CD_0": None if drag is None else {"estimate": drag.value, "std_error": drag.sd, "baseline": self.CD_0},
            "change_percent": {
                name: {"estimate": 100 * value, "std_error": 100 * sd}
                for name, (value, sd) in {**self.changes(methods), **of_drag}.items()
            },
        }


def _change(p: ParamEstimate, base: float, base_sd: float, share: float) -> tuple[float, float]:
    own = math.sqrt(max(p.sd**2 - (share * p.value) ** 2, 0.0))
    return (p.value - base) / base, math.hypot(own, base_sd) / abs(base)
