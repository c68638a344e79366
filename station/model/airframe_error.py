"""What a wrong mass or inertia of the profile does to a derivative: forces are mass times acceleration, moments inertia
times angular acceleration, so that all derivatives of a coefficient are wrong by the same share, and no residual shows
it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.profile import Aircraft

Array = NDArray[np.float64]

MOMENTS: Final = ("Cm", "Cl", "Cn")


def relative_errors(aircraft: Aircraft, names: Sequence[str]) -> Array:
    """Standard deviation of each derivative, over its value, where the mass is the profile's and where it is recorded,
    (2, names)."""
    u = aircraft.uncertainty
    return np.array([[u.inertia if n[:2] in MOMENTS else force for n in names] for force in (u.mass, u.recorded_mass)])
