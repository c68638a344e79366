"""Scale of what measures aileron and rudder, by what the profile says that they do.

No instrument is another's witness for a surface's scale. A pot 20 % short makes the derivatives by its surface 25 %
large; a wrong moment of inertia or airspeed makes all derivatives of the moment large by the same share. Over the
profile's values, those by motion give that share, and the surface's own beside it the scale. That a control has lost
its effect looks the same, and the words say so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from station.estimation.results import LATERAL_DOF, LATERAL_FORCES
from station.identification.by_input import Shown
from station.profile import Aircraft

SURE: Final = 4.0
"""Standard deviations of a scale from 1 that contradict the profile, as for its other derivatives."""
SHOWN_BY: Final = {"aileron": ("Cl_da", ("Cl_beta", "Cl_p")), "rudder": ("Cn_dr", ("Cn_beta", "Cn_r"))}
"""The derivative that shows a surface best, and those by motion that the same moment has most of."""
BY: Final = dict(zip(LATERAL_DOF, ("", "", "", "aileron", "rudder"), strict=True))


@dataclass(frozen=True, slots=True)
class SurfaceScale:
    """What a surface's sensor shows, times what the surface does by the profile; `ratio`: its derivative's, `name`,
    over the profile's."""

    scale: float
    name: str
    ratio: float

    def worded(self, surface: str) -> str:
        if self.scale < 0:
            return f"{surface} of the wrong sign ({self.name} is {self.ratio:.2g} times the profile's)"
        return f"{surface} scale {self.scale:.2g} ({self.name} is {self.ratio:.2g} times the profile's, or has changed)"


def contradicted(aircraft: Aircraft, shown: Mapping[str, Shown]) -> dict[str, SurfaceScale]:
    """Each surface whose scale is not 1 beyond doubt, by derivatives as the input shows them."""
    found = {}
    for surface, (own, others) in SHOWN_BY.items():
        ratio = _over_profile(aircraft, shown, own)
        beside = [r for name in others if (r := _over_profile(aircraft, shown, name)) is not None]
        if ratio is None or not beside:
            continue
        weights = [1.0 / sd**2 for _, sd in beside]
        moment = sum(w * x for w, (x, _) in zip(weights, beside, strict=True)) / sum(weights)
        # Two derivatives that differ by more than their errors know the share no better than they differ.
        apart = max(abs(x - moment) for x, _ in beside)
        known = math.hypot(1.0 / math.sqrt(sum(weights)), apart)
        scale = moment / ratio[0]
        sd = scale * math.hypot(ratio[1] / ratio[0], known / moment, aircraft.uncertainty.surface_scale)
        if abs(scale - 1.0) > SURE * abs(sd):
            found[surface] = SurfaceScale(scale, own, ratio[0])
    return found


def wrong_by(scales: Mapping[str, SurfaceScale], values: Mapping[str, float]) -> dict[str, float]:
    """By how much each derivative by these surfaces is wrong."""
    return {
        name: abs(values[name] * (scales[surface].scale - 1.0))
        for coefficient in LATERAL_FORCES
        for mark, surface in BY.items()
        if surface in scales and (name := f"{coefficient}_{mark}") in values
    }


def _over_profile(aircraft: Aircraft, shown: Mapping[str, Shown], name: str) -> tuple[float, float] | None:
    """A derivative over the profile's and the standard deviation of that; None where either is not known or nought."""
    stated = aircraft.derivatives.get(name)
    found = shown.get(name)
    if stated is None or stated.sd is None or not stated.value or found is None or not found.value:
        return None
    ratio = found.value / stated.value
    return ratio, math.hypot(found.error / stated.value, ratio * stated.sd / stated.value)
