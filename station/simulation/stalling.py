"""Flow that leaves the wing, as it is flown: Kirchhoff's lift behind Goman's and Khrabrov's law (see the profile).

In steps: the share of the chord with attached flow goes on towards what the angle of attack and, while it falls, its
rate ask for, within tau1 chords.
"""

from __future__ import annotations

import math
from typing import Final

from numba import njit

from station.profile import Separation

BRIEF: Final = 0.05
"""s: the rate of the angle of attack is that behind a lag of this length: a wing feels no change that is briefer."""


@njit(cache=True)
def attached(alpha: float, sharpness: float, alpha_star: float) -> float:
    """Share of the chord at a lasting angle of attack (rad); `sharpness`: a1, per rad."""
    return 0.5 - 0.5 * math.tanh(sharpness * (alpha - alpha_star))


@njit(cache=True, inline="always")
def lift_left(share: float) -> float:
    """Of the lift of attached flow."""
    root = math.sqrt(share)
    return 0.25 + 0.5 * root + 0.25 * share


def steady(separation: Separation, alpha: float) -> tuple[float, float]:
    """Share of the chord, and of the lift that is left, at a lasting `alpha` (rad)."""
    if separation.alpha_star is None:
        return 1.0, 1.0
    share = attached(alpha, separation.a1, separation.alpha_star)
    return share, lift_left(share)
