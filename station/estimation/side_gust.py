"""The side gust that the vane shows, as it reaches the centre of gravity and, later, the fin.

In what a fin does, its sideslip differs from the one that the derivatives go by, which the whole aircraft has at once,

    late = g(t - k l/V) - g(t) - sigma (beta(t - l/V - T) - beta(t) - r l/V)

with g the side gust at the CG over V, l the fin's arm, k its penetration (1 where a gust meets it there), sigma its
sidewash and T the sidewash's delay: what enters CY with minus the fin's slope, and Cl and Cn by its place. SI, rad.
Source: Etkin 1972, Dynamics of Atmospheric Flight, section 13.3 (gusts as they penetrate).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.numerics.lagrange import cubic
from station.profile import Aircraft

Array = NDArray[np.float64]

RING: Final = 128
"""Values kept, ticks."""
_LEAD, _ARM, _SIDEWASH, _DELAY, _MET = range(5)


@njit(cache=True)
def _ago(ring: Array, count: int, lag: float) -> float:
    """What came `lag` ticks before the last one, cubic between ticks; NaN from before the first. `count`: how many came
    before the last."""
    n = ring.shape[0]
    back = min(max(math.ceil(lag), 2), n - 3)
    if count < back + 1:
        return math.nan
    a, b, c, d = [ring[(count - back + k) % n] for k in (-1, 0, 1, 2)]
    return float(cubic(a, b, c, d, back - lag))


@njit(cache=True)
def _advance(
    constant: Array, rings: Array, count: int, dt: float, flow: tuple[float, float, float, float]
) -> tuple[float, float, float]:
    """One tick: the gust at the CG now, the fin's `late`, and by how much a unit of sidewash more lessens it. `rings`
    (2, RING): gust at the vane, sideslip."""
    gust, inertial, r, speed = flow
    lead, arm = constant[_LEAD] / (speed * dt), constant[_ARM] / (speed * dt)
    rings[0, count % rings.shape[1]] = gust
    now = _ago(rings[0], count, lead)
    at_fin = _ago(rings[0], count, lead + arm * constant[_MET])
    beta = inertial + now
    # Before the gust at the CG is known, the sideslip is the inertial one: it is read again only after it has passed.
    rings[1, count % rings.shape[1]] = beta if math.isfinite(beta) else inertial
    wash = _ago(rings[1], count, arm + constant[_DELAY] / dt) - beta - r * constant[_ARM] / speed
    return now, at_fin - now - constant[_SIDEWASH] * wash, wash


class SideGust:
    """The gust on its way past the aircraft, a tick at a time."""

    def __init__(self, aircraft: Aircraft, dt: float) -> None:
        boom, fin = aircraft.boom, aircraft.fin
        wash = (fin.arm, fin.sidewash, fin.sidewash_delay, fin.penetration) if fin else (0.0, 0.0, 0.0, 1.0)
        self._constant = np.array([boom.vane_x if boom else 0.0, *wash])
        self._rings = np.zeros((2, RING))
        self._count = 0
        self._dt = dt
        self.force = np.zeros(3)
        """What one radian of `late` makes of CY, Cl and Cn."""
        if fin is not None:
            span = aircraft.geometry.span
            self.force[:] = -fin.lift_slope, -fin.lift_slope * fin.height / span, fin.lift_slope * fin.arm / span

    def restart(self) -> None:
        """The next tick is the first."""
        self._count = 0

    def step(self, gust: float, inertial: float, r: float, speed: float) -> tuple[float, float, float]:
        """One tick of the gust at the vane and the inertial sideslip, rad: the gust at the CG, how much later the fin's
        sideslip is, and by how much a unit of sidewash more lessens that, rad; NaN until they are known."""
        found = _advance(self._constant, self._rings, self._count, self._dt, (gust, inertial, r, speed))
        self._count += 1
        return found
