"""A second-order instrument: its sampled transition, and how late it shows what is slow."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
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


@njit(cache=True)
def follow(transition: Array, s: Array, new: float) -> float:
    """The output for a new input, the input straight between ticks; edits `s` (3,): output, its rate, last input.

    `transition` (8,): what second_order gives.
    """
    m, angle, swing, old = transition, s[0], s[1], s[2]
    s[0] = m[0] * angle + m[1] * swing + m[4] * old + m[6] * new
    s[1] = m[2] * angle + m[3] * swing + m[5] * old + m[7] * new
    s[2] = new
    return float(s[0])
