"""Flow that leaves the wing: the share of the chord along which it is attached, and the lift that this leaves.

A thin wing whose flow leaves it at the share X of its chord has ((1 + sqrt X)/2)^2 of the lift of attached flow
(Kirchhoff's flow past a plate), from the angle of attack on at which that does not lift. X follows the angle of attack
along half a hyperbolic tangent, and late (Goman and Khrabrov 1994, Journal of Aircraft 31; Fischenberg 1995, AIAA
95-3439; Jategaonkar 2015, chapter 12, who counts the lift from the reference line on):

    tau1 c/V dX/dt + X = 0.5 (1 - tanh(a1 (alpha - tau2 c/V alphadot - alpha_star)))

Fischenberg and Jategaonkar count tau2 while alpha falls only, for flow comes back later than it left; Goman and
Khrabrov count it always. While alpha rises, tau2_rising stands for it.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from station.profile import Aircraft, Separation

BRIEF: Final = 0.05
"""s: the rate of the angle of attack is that behind a lag of this length, as it is flown."""


def attached(alpha: Any, sharpness: float, alpha_star: float) -> Any:
    """X without delay: the share of the chord, 1 well below `alpha_star` (rad); `sharpness`: a1, per rad."""
    return 0.5 * (1.0 - np.tanh(sharpness * (alpha - alpha_star)))


def lift_left(x: Any) -> Any:
    """Of the lift of attached flow."""
    return 0.25 * (1.0 + np.sqrt(x)) ** 2


def of_wing(aircraft: Aircraft) -> Any:
    """CL per angle of attack (1/rad) of the wing, whose flow leaves, without the tail: where lift has a memory, the
    profile has the tail's part by itself; where it has none, all of CL_alpha."""
    tail, whole = aircraft.unsteady, aircraft.value("CL_alpha")
    return whole - tail.tail_lift_slope * (1 - tail.downwash) if tail.memory else whole


def steady(separation: Separation, alpha: float) -> tuple[float, float]:
    """Share of the chord along which flow is attached, and of the lift that is left, at a lasting `alpha` (rad)."""
    if separation.alpha_star is None:
        return 1.0, 1.0
    x = float(attached(alpha, separation.a1, separation.alpha_star))
    return x, float(lift_left(x))
