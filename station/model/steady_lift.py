"""The lift of a stretch of flight and the CL_0 that the profile's slopes leave of it: what a vane's zero shows in.

    CL_0 = CL - CL_alpha alpha - CL_q q c/2V - CL_de de, of means

A vane that shows the angle of attack too large by e turns the axes of lift and drag, and the slope takes it for lift:

    CL_0 -(CL_alpha + CD) e,     CD +CL e and, less the induced drag, CD_0 +CL (1 + 2 k CD) e

(from CL = CX sin a - CZ cos a and CD = -CX cos a - CZ sin a: dCL/da = -CD, dCD/da = CL). SI and radians.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from station.conventions import G0
from station.profile import Aircraft


class SteadyLift(NamedTuple):
    """Means of a stretch of flight."""

    lift: float
    """CL"""
    alpha: float
    rate: float
    """q c/2V"""
    elevator: float
    mass_recorded: bool = False
    density: float = math.nan
    """Of the air, kg/m^3."""

    def at_zero(self, aircraft: Aircraft) -> float:
        """CL_0 with the profile's slopes; NaN where a signal is missing."""
        slopes = (aircraft.value(n) for n in ("CL_alpha", "CL_q", "CL_de"))
        return self.lift - math.fsum(s * x for s, x in zip(slopes, (self.alpha, self.rate, self.elevator), strict=True))

    def by_mass(self, aircraft: Aircraft) -> float:
        """Standard deviation of CL by what the mass may have changed since another flight: fuel and load."""
        u = aircraft.uncertainty
        return (u.recorded_mass if self.mass_recorded else u.mass) * abs(self.lift)

    def by_slope(self, aircraft: Aircraft, outside: float) -> float:
        """Standard deviation of CL_0 by the slope's own, `outside` of the lift at which the baseline's was told: there
        an error of the slope is in both."""
        slope = aircraft.derivatives.get("CL_alpha")
        return outside * abs(_share(slope.sd or 0.0, slope.value)) if slope else 0.0


def outside(lift: float, between: tuple[float, float]) -> float:
    """How far a lift coefficient is from those between a least and a largest; 0 among them."""
    return max(lift - between[1], between[0] - lift, 0.0)


def induced_doubt(aircraft: Aircraft, lift: float, between: tuple[float, float]) -> float:
    """Standard deviation of CD_0 by the induced drag of a lift that is not among those of the baseline."""
    if aircraft.drag is None or not outside(lift, between):
        return 0.0
    end = between[1] if lift > between[1] else between[0]
    return aircraft.uncertainty.induced_drag * aircraft.drag.induced * abs(lift**2 - end**2)


def level_lift(aircraft: Aircraft, density: float) -> tuple[float, float]:
    """The least and the largest CL of level flight at the speeds of a measured baseline, in air of a density, kg/m^3;
    all there are where either is unknown."""
    measured = aircraft.measured
    if measured is None or not density > 0:
        return -math.inf, math.inf
    load = aircraft.inertia.mass * G0 / (0.5 * density * aircraft.geometry.wing_area)
    speeds = measured.lowest_speed, measured.highest_speed
    return load / max(speeds) ** 2, load / min(speeds) ** 2


def _share(part: float, whole: float) -> float:
    return part / whole if whole else 0.0
