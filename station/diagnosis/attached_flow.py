"""Flow that leaves the wing, along a manoeuvre: what the residuals compare with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.processing import Setting, back, transform
from station.diagnosis.stacked import some
from station.numerics.separation import BRIEF, attached
from station.profile import Separation

Array = NDArray[np.float64]


def attached_along(alpha: Array, leaving: Separation, alpha_star: float, passage: Array, s: Setting) -> Array:
    """Share (..., n) of the chord along which the flow is attached; `passage`: s that a chord takes to pass."""
    w = 1j * s.omega
    felt = alpha
    if some(leaving.tau2) or some(leaving.tau2_rising):
        turning = back(transform(alpha, s) * w / (1 + BRIEF * w), s)
        late = leaving.tau2 * np.minimum(turning, 0.0) + leaving.tau2_rising * np.maximum(turning, 0.0)
        felt = alpha - passage * late
    x = attached(felt, leaving.a1, alpha_star)
    if some(leaving.tau1):
        x = np.clip(back(transform(x, s) / (1 + leaving.tau1 * passage * w), s), 0.0, 1.0)
    return np.asarray(x)
