"""Angles that wrap, and attitudes."""

from __future__ import annotations

import math

from numba import njit


@njit(cache=True)
def wrap(angle: float) -> float:
    """The same direction within -pi..pi, rad."""
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


def quaternion(phi: float, theta: float, psi: float) -> tuple[float, float, float, float]:
    """Attitude from north, east, down to body axes, w x y z, of Euler angles in rad, order 3-2-1. Source: Stevens and
    Lewis 2003, eq. 1.3-34."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a / 2), math.sin(a / 2)) for a in (phi, theta, psi))
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
