"""What every fit estimates beside the effects, within a prior: derivatives, biases and trim."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import G0, to_si
from station.diagnosis.profile_changes import Extend, bias, derivative, zero_lift_drag
from station.profile import Aircraft

DERIVATIVES: Final = ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")
PRIOR_SHARE: Final = 0.10
"""Standard deviation of a derivative, as a share of it, where the profile states none."""


@dataclass(frozen=True, slots=True)
class Nuisance:
    """A quantity with a Gaussian prior of standard deviation `sd` about the profile's value."""

    name: str
    sd: float
    extend: Extend
    relinear: bool = False
    relative: bool = False
    """Whether moving it multiplies."""
    step: float = 1.0
    """Over what share of the standard deviation its slope is taken."""


BIASES: Final = (
    Nuisance("theta bias", to_si(0.1, "deg"), bias("theta")),
    Nuisance("az bias", 0.005 * G0, bias("az")),
    Nuisance("ax bias", 0.003 * G0, bias("ax")),
    Nuisance("q bias", to_si(0.05, "deg/s"), bias("q")),
)
TRIM: Final = (
    Nuisance("CL_0", 0.01, derivative("CL_0")),
    Nuisance("Cm_0", 0.005, derivative("Cm_0")),
    Nuisance("CD_0", 0.003, zero_lift_drag),
)


def nuisance_priors(aircraft: Aircraft) -> tuple[Nuisance, ...]:
    """The derivatives with the profile's standard deviations, the biases of instruments and trim."""
    found = []
    for name in DERIVATIVES:
        stated = aircraft.derivatives.get(name)
        if stated is not None and stated.value:
            share = (stated.sd or PRIOR_SHARE * abs(stated.value)) / abs(stated.value)
            found.append(Nuisance(name, share, derivative(name, relative=True), True, True))
    return (*found, *BIASES, *TRIM)


def moved_by(aircraft: Aircraft, nuisances: Sequence[Nuisance], moved: NDArray[np.float64]) -> Aircraft:
    """The aircraft with nuisances moved, in standard deviations; what comes after them in `moved` is not of the
    aircraft."""
    for nuisance, x in zip(nuisances, moved, strict=False):
        if x:
            aircraft = nuisance.extend(aircraft, nuisance.sd * float(x))
    return aircraft
