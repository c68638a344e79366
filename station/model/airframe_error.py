"""What a wrong mass or inertia of the profile, or a wrong position error, does to a derivative: forces are mass times
acceleration, moments inertia times angular acceleration, and coefficients are these over the dynamic pressure, so that
all derivatives of a coefficient are wrong by the same share, and no residual shows it."""

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


def relative_errors(aircraft: Aircraft, names: Sequence[str]) -> Array:
    """Standard deviation of each derivative, over its value, where the mass is the profile's and where it is recorded,
    (2, names)."""
    u = aircraft.uncertainty
    air = [u.dynamic_pressure * (BY_RATES if n.rpartition("_")[2] in RATES else 1.0) for n in names]
    return np.array(
        [
            [math.hypot(u.inertia if n[:2] in MOMENTS else force, q) for n, q in zip(names, air, strict=True)]
            for force in (u.mass, u.recorded_mass)
        ]
    )
