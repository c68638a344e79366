"""An aircraft's outline, of which `station planform` computes unsteady lift, upwash, downwash and sidewash."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field

from station.profile.quantity import Frozen, Metres, Positive, Radians, SquareMetres


class Planform(Frozen):
    """The wing beyond its area and span, its tail and fin. The wing's quarter chord is at the CG."""

    taper: float = Field(default=1.0, ge=0.05, le=2.0)
    """Chord at the tip over that in the middle."""
    sweep: Annotated[Radians, Field(gt=-1.2, lt=1.2)] = 0.0
    """Of the wing's quarter chord, tips aft: of simulations too, in a plane of air, where gusts meet the tips later."""
    tail_area: Annotated[SquareMetres, Positive] | None = None
    """Of the tailplane, through the body; with it `tail_span` and `tail_arm` of [unsteady]."""
    tail_height: Metres = 0.0
    """Tailplane above the wing's plane."""
    fin_area: Annotated[SquareMetres, Positive] | None = None
    """Of the fin with its rudder."""
    wing_height: Metres = 0.0
    """Wing's quarter chord above the body's middle, in the plane of symmetry."""
    body_depth: Annotated[Metres, Positive] | None = None
    """Of the body at the wing."""

    def chords(self, area: float, span: float) -> tuple[float, float]:
        """Of a wing of this area, m2, and span, m: in the middle and at the tip, m."""
        middle = 2 * area / (span * (1 + self.taper))
        return middle, middle * self.taper

    def quarter_chord(self, span: float) -> float:
        """The mean chord's quarter behind that in the middle, m."""
        return span / 6 * (1 + 2 * self.taper) / (1 + self.taper) * math.tan(self.sweep)
