"""What an aircraft's fin is: how much of the lateral derivatives it makes, where it meets the air, and in which."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from station.profile.quantity import Frozen, Metres, Positive, Seconds


class Fin(Frozen):
    """The fin's share of the lateral derivatives, which `field = "plane"` flies where and when the fin meets the air:
    later than the CG by its arm, and in the sidewash that wing and body made there."""

    lift_slope: float = Field(ge=0, le=10)
    """Side force per sideslip at the fin, per rad, referred to the wing area: what it takes from CY_beta."""
    arm: Annotated[Metres, Positive]
    """Aerodynamic centre behind the CG."""
    height: Metres = 0.0
    """The same above the CG."""
    penetration: float = Field(default=1.0, ge=0, le=4)
    """How far behind the CG a gust meets the fin, in its arm: 0 as if the fin were at the CG."""
    sidewash: float = Field(default=0.0, gt=-1, lt=1)
    """By how much less the fin's sideslip changes than the aircraft's, as a share: d sigma / d beta."""
    sidewash_delay: Seconds = Field(default=0.0, ge=0)
    """How much later than arm/V the sidewash reaches the fin."""
