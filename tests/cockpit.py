"""An aircraft for the guide of a card's steps: it flies what it is asked for, and estimates as well as it is told."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from station.clock import ManualClock
from station.conventions import LONGITUDINAL, SIGNALS
from station.flight.board import Board
from station.flight.guide import Guide
from station.flight.point_marks import Points
from station.profile import Card, Manoeuvre, load_aircraft
from station.rows import AlphaEstimate, Code, Event, Frame, Health, MethodEstimate, ParamEstimate, Status
from station.simulation.legs import without_legs
from station.simulation.manoeuvres import elevator_input

TRIM = -0.02
LEVEL = {"airspeed": 56.6, "altitude": 762.0, "az": -9.81, "phi": 0.0, "theta": 0.06, "q": 0.0, "alpha_vane": 0.05}
STEP = {
    "name": "short period",
    "repeats": 3,
    "accept": {"Cm_q": "20 %"},
    "condition": {"speed": "110 kt", "speed_tolerance": "5 kt", "air": "light", "configuration": "flaps up"},
    "inputs": [{"kind": "doublet", "start": "0 s", "amplitude": "2 deg", "width": "1 s"}],
}


class Cockpit:
    """An aircraft that flies what it is asked for, `share` of it, and estimates whose error is `sd`."""

    def __init__(self, *steps: dict, auto: bool = False) -> None:
        self.clock = ManualClock(1_000_000_000)
        self.board = Board(None, self.clock)
        self.told: list[Event] = []
        self.asked: Sequence[Manoeuvre] = ()
        self.changed: dict[str, float] = {}
        self.share, self.sd, self.air, self.k = 1.0, 2.0, "calm", 0
        card = Card.model_validate({"name": "x", "aircraft": "", "rig": "", "warm_up": "0 s", "steps": list(steps)})
        points = Points(self.told.append, self.clock)
        self.guide = Guide(card, load_aircraft("twin_otter"), self.board, points, self._tell, self._ask, auto=auto)

    def _tell(self, event: Event) -> None:
        self.told.append(event)
        self.board.update([event])

    def _ask(self, manoeuvres: Sequence[Manoeuvre]) -> None:
        self.asked = tuple(without_legs(manoeuvres))

    def fly(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        for _ in range(round(seconds * 50)):
            if until():
                return
            self.clock.advance_s(0.02)
            now = self.clock.now_ns()
            moved = float(elevator_input(self.asked, np.array([now * 1e-9]))[0])
            values = {**LEVEL, "elevator": TRIM + self.share * moved, **self.changed}
            row = tuple(values.get(name, math.nan) for name in SIGNALS)
            frame = Frame(now, self.k, row, (0.0,) * len(row), (0,) * len(row))
            alpha = AlphaEstimate(now, *[0.05] * 11, 0.1, self.air, 0.0, 0.0, 0.0, True, "")
            found = tuple(ParamEstimate(n, -35.0, self.sd, Status.ESTIMATED, "") for n in LONGITUDINAL)
            self.board.update([alpha, MethodEstimate(now, "split", found), Health(now, ())])
            self.guide.update([frame, alpha])
            self.k += 1

    def press(self, key: str) -> None:
        self.guide.press(key)
        self.fly(0.02)

    def words(self, code: Code) -> list[str]:
        return [event.detail for event in self.told if event.code is code]
