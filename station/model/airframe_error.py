"""What a wrong mass or inertia of the profile, or a wrong position error, does to a derivative: forces are mass times
acceleration, moments inertia times angular acceleration, and coefficients are these over the dynamic pressure, so that
all derivatives of a coefficient are wrong by the same share, and no residual shows it. So with the scale of what
measures a surface, and all derivatives by that surface."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.profile import Aircraft

Array = NDArray[np.float64]

MOMENTS: Final = ("Cm", "Cl", "Cn")
RATES: Final = ("q", "p", "r")
BY_RATES: Final = 0.5
"""Share of the dynamic pressure's error in derivatives by rates: these are multiplied by the root of it, q c/2V."""
BY_SURFACES: Final = ("de", "da", "dr")


def relative_errors(aircraft: Aircraft, names: Sequence[str]) -> Array:
    """Standard deviation of each derivative, over its value, where the mass is the profile's and where it is recorded,
    (2, names)."""
    u = aircraft.uncertainty

    def error(name: str, force: float) -> float:
        to = name.rpartition("_")[2]
        air = u.dynamic_pressure * (BY_RATES if to in RATES else 1.0)
        surface = u.surface_scale if to in BY_SURFACES else 0.0
        return math.hypot(u.inertia if name[:2] in MOMENTS else force, air, surface)

    return np.array([[error(n, force) for n in names] for force in (u.mass, u.recorded_mass)])
