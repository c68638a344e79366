"""The aircraft's attitude, for the page's 3-D view, and the lines that stand for the aircraft."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from station.conventions import SIGNAL_INDEX
from station.numerics.angles import quaternion
from station.rows import Frame

Array = NDArray[np.float64]

_PHI, _THETA = SIGNAL_INDEX["phi"], SIGNAL_INDEX["theta"]
_PALE, _RED, _GREEN = 0xD8DDE2FF, 0xFF5050FF, 0x2BD9A5FF


def attitude(frame: Frame) -> tuple[float, float, float, float] | None:
    """Bank and pitch as a quaternion x y z w, from body axes to those of the level aircraft; None where not known."""
    phi, theta = frame.values[_PHI], frame.values[_THETA]
    if not math.isfinite(phi + theta):
        return None
    w, x, y, z = quaternion(phi, theta, 0.0)
    return x, y, z, w


def airframe() -> tuple[list[Array], Array]:
    """A small twin in lines, body axes, m; with their colours: port red, starboard green."""
    lines = (
        ([[5, 0, 0], [3, 0, -0.6], [-5, 0, -0.2], [3, 0, 0.6], [5, 0, 0]], _PALE),
        ([[0.8, 0, -0.6], [0.6, -7, -0.8], [-0.7, -7, -0.8], [-1, 0, -0.6]], _RED),
        ([[0.8, 0, -0.6], [0.6, 7, -0.8], [-0.7, 7, -0.8], [-1, 0, -0.6]], _GREEN),
        ([[-4.2, 0, -1], [-4.6, -2.6, -1], [-5.2, -2.6, -1], [-5.2, 2.6, -1], [-4.6, 2.6, -1], [-4.2, 0, -1]], _PALE),
        ([[-3.8, 0, -0.3], [-5, 0, -2.6], [-5.6, 0, -2.6], [-5.2, 0, -0.2]], _PALE),
    )
    return [np.array(points, dtype=float) for points, _ in lines], np.array([c for _, c in lines], dtype=np.uint32)
