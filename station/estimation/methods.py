"""Methods of estimation, one table, and the estimator that runs the live ones at every tick."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, Literal

from station.conventions import LONGITUDINAL, LONGITUDINAL_BODY
from station.profile import Aircraft, Card
from station.rows import AlphaEstimate, Frame, MethodEstimate, ParamEstimate, Status

LIVE: Final = ("II", "III", "V", "split", "split+gust")


class Estimator:
    """Angle of attack and derivatives, one 50 Hz frame at a time. Never raises; all state inside."""

    def __init__(
        self,
        aircraft: Aircraft,
        card: Card,
        imu_position: tuple[float, float, float] = (0.0, 0.0, 0.0),
        noise: Mapping[str, float] | None = None,
        methods: tuple[str, ...] = LIVE,
        *,
        axes: Literal["wind", "body"] = "wind",
        force: bool = False,
        forgetting_s: float = math.inf,
    ) -> None:
        self._methods = methods
        self._names = LONGITUDINAL if axes == "wind" else LONGITUDINAL_BODY

    def warm_up(self) -> None:
        """Compile every kernel, so that no tick of a flight has to."""

    def reset(self) -> None:
        """Open a new transform (at a test point); the filters stay warm."""

    def step(self, frame: Frame) -> tuple[AlphaEstimate, tuple[MethodEstimate, ...]]:
        """One tick."""
        nan = math.nan
        alpha = AlphaEstimate(
            frame.t_ns, nan, nan, nan, nan, nan, nan, nan, nan, nan, nan, nan, nan, "unknown", nan, nan, nan, False,
            "warming up",
        )
        parameters = tuple(ParamEstimate(n, nan, nan, Status.UNESTIMATED, "warming up") for n in self._names)
        return alpha, tuple(MethodEstimate(frame.t_ns, m, parameters, False, "warming up") for m in self._methods)
