"""Angles that wrap, and attitudes."""

from __future__ import annotations

import math
from typing import Final

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


_UNIT_LENGTH2: Final = (0.8, 1.25)
"""Square of a quaternion's length that is still taken for one."""


def euler_angles(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Roll, pitch and yaw (3-2-1), rad, of the quaternion that turns the earth's axes into the body's.

    NaN if it is far from unit length, which no attitude is. Source: Stevens and Lewis 2003, eq. 1.3-33 and 1.3-34.
    """
    norm2 = w * w + x * x + y * y + z * z
    if not _UNIT_LENGTH2[0] < norm2 < _UNIT_LENGTH2[1]:
        return math.nan, math.nan, math.nan
    return (
        math.atan2(2 * (w * x + y * z), w * w - x * x - y * y + z * z),
        math.asin(max(-1.0, min(1.0, 2 * (w * y - x * z) / norm2))),
        math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z),
    )
