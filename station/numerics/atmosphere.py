"""The standard atmosphere: ISO 2533."""

from __future__ import annotations

import math
from typing import Final

from numba import njit

GAS_CONSTANT: Final = 287.05287
"""Dry air, J/(kg K)."""


@njit(cache=True)
def standard_density(height: float) -> float:
    """kg/m3 at a height (m) in the standard atmosphere below 20 km. ISO 2533."""
    if height > 11_000.0:
        return 0.363918 * math.exp((11_000.0 - height) / 6341.62)
    return float(1.225 * (1.0 - 2.25577e-5 * height) ** 4.25588)
