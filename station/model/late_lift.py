"""What of lift and pitching moment follows the motion late, and what else it depends on beside the derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from station.numerics.indicial import Response, response
from station.profile import Aircraft
from station.profile.profile_changes import SLOWEST


class Late(NamedTuple):
    """What of lift and moment follows late: the wing's indicial response and the downwash at the tail."""

    wing: Response
    chord: float
    """m, that the response counts in."""
    tail_slope: Any
    tail_arm: Any
    """m."""
    downwash: Any
    delay: Any
    """s, of the downwash beyond tail_arm/V."""
    amplitude: Any = 1.0
    """Of the wing's response, over its own."""
    rate: Any = 1.0

    def grown(self, share: float, speed: float) -> Late:
        """With this share of its lags."""
        on_the_way = self.tail_arm / speed
        return self._replace(delay=share * (on_the_way + self.delay) - on_the_way, amplitude=share * self.amplitude)

    def drawn(self, constants: Mapping[str, Any]) -> Late:
        """With those of LAGS in place of its own; none is less than nothing, and no response stands still."""
        own = {name: constants[key] for name, key in zip(self._fields[2:], LAGS, strict=True) if key in constants}
        least = {"delay": -np.inf, "rate": SLOWEST}
        return self._replace(**{name: np.maximum(x, least.get(name, 0.0)) for name, x in own.items()})


LAGS: Final = ("late tail slope", "late tail arm", "late downwash", "late delay", "late amplitude", "late rate")
"""Constants of Late beside the derivatives, by name."""
MASS: Final = "mass over"
"""Over what the condition has."""
IYY: Final = "iyy over"
"""The same of the pitch inertia."""
ZERO_LIFT_DRAG: Final = "CD_0 beyond"
"""Drag coefficient without lift, less the aircraft's."""
INDUCED_DRAG: Final = "induced drag over"
"""Drag over the square of CL, over the aircraft's."""


def constants_of(aircraft: Aircraft, about: Aircraft) -> dict[str, float]:
    """LAGS, MASS, IYY and drag of an aircraft; but for the first four LAGS over, or beyond, those of another."""
    u, v = aircraft.unsteady, about.unsteady
    own, other = aircraft.inertia, about.inertia
    made = {MASS: own.mass / other.mass}
    if own.iyy and other.iyy:
        made[IYY] = own.iyy / other.iyy
    if aircraft.drag is not None and about.drag is not None:
        made[ZERO_LIFT_DRAG] = aircraft.drag.zero_lift - about.drag.zero_lift
        if about.drag.induced:
            made[INDUCED_DRAG] = aircraft.drag.induced / about.drag.induced
    if u.memory:
        made |= dict(zip(LAGS[:4], (u.tail_lift_slope, u.tail_arm, u.downwash, u.downwash_delay), strict=True))
    if u.lift_motion is not None and v.lift_motion is not None and sum(v.lift_motion.a) > 0:
        made[LAGS[4]] = sum(u.lift_motion.a) / sum(v.lift_motion.a)
        made[LAGS[5]] = u.lift_motion.b[0] / v.lift_motion.b[0]
    return made


def late_of(aircraft: Aircraft) -> Late | None:
    """As the profile has it; None for a quasi-steady aircraft."""
    u = aircraft.unsteady
    if not u.memory:
        return None
    chord = u.reference_chord or aircraft.geometry.chord
    return Late(response(u.lift_motion), chord, u.tail_lift_slope, u.tail_arm, u.downwash, u.downwash_delay)
