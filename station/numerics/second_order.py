"""A second-order instrument: its sampled transition, and how late it shows what is slow."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]


def second_order(frequency: float, damping: float, dt: float) -> Array:
    """A system wn^2/(s^2 + 2 zeta wn s + wn^2) sampled every dt, its input linear between ticks: of the output and its
    rate the transition (4,), what the last input adds (2,) and the new one (2,). `frequency` in Hz."""
    omega = 2.0 * math.pi * frequency
    # Exponential of the system with its input and the input's slope.
    system = np.zeros((4, 4))
    system[0, 1] = system[2, 3] = 1.0
    system[1] = (-(omega**2), -2.0 * damping * omega, omega**2, 0.0)
    system[2, 3] = 1.0 / dt
    whole = expm(system * dt)
    hold, ramp = whole[:2, 2], whole[:2, 3]
    return np.array((*whole[:2, :2].ravel(), *(hold - ramp), *ramp))


def vane_lag(frequency: float, damping: float) -> float:
    """How late a second-order vane (Hz) shows what is slow, s."""
    return damping / (math.pi * frequency)
