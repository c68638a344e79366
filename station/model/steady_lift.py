"""The lift of a stretch of flight and the CL_0 that the profile's slopes leave of it: what a vane's zero shows in.

    CL_0 = CL - CL_alpha alpha - CL_q q c/2V - CL_de de, of means

A vane that shows the angle of attack too large by e turns the axes of lift and drag, and the slope takes it for lift:

    CL_0 -(CL_alpha + CD) e,     CD +CL e and, less the induced drag, CD_0 +CL (1 + 2 k CD) e

(from CL = CX sin a - CZ cos a and CD = -CX cos a - CZ sin a: dCL/da = -CD, dCD/da = CL). SI and radians.
"""

from __future__ import annotations

import math
from typing import NamedTuple

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

    def at_zero(self, aircraft: Aircraft) -> float:
        """CL_0 with the profile's slopes; NaN where a signal is missing."""
        slopes = (aircraft.value(n) for n in ("CL_alpha", "CL_q", "CL_de"))
        return self.lift - math.fsum(s * x for s, x in zip(slopes, (self.alpha, self.rate, self.elevator), strict=True))

    def by_mass(self, aircraft: Aircraft) -> float:
        """Standard deviation of CL by what the mass may have changed since another flight: fuel and load."""
        u = aircraft.uncertainty
        return (u.recorded_mass if self.mass_recorded else u.mass) * abs(self.lift)
