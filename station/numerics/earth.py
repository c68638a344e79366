"""Radii of the earth's ellipsoid."""

from __future__ import annotations

import math
from typing import Final

_EQUATOR: Final = 6378137.0
_ECCENTRICITY2: Final = 6.69437999014e-3


def radii(latitude: float) -> tuple[float, float]:
    """WGS-84's radii of curvature along the meridian and across it, m, at a latitude in rad: metres north are the first
    times the change of latitude, metres east the second times that of longitude times cos(latitude).

    Source: Stevens and Lewis 2003, eq. 1.4-3 and 1.4-5.
    """
    w2 = 1 - _ECCENTRICITY2 * math.sin(latitude) ** 2
    return _EQUATOR * (1 - _ECCENTRICITY2) / w2**1.5, _EQUATOR / math.sqrt(w2)
