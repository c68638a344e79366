"""A second-order instrument, H = wn^2/(s^2 + 2 zeta wn s + wn^2): a vane on its boom, or the boom's bending mode.

Sampled, its input is linear between ticks. `frequency`: wn/2 pi, Hz; `damping`: zeta.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from station.numerics.products import exponential

Array = NDArray[np.float64]


def second_order(frequency: float, damping: float, dt: float) -> Array:
    """Sampled every dt: of the output and its rate the transition (4,), what the last input adds (2,) and the new one
    (2,)."""
    return np.array(_sampled(frequency, damping, dt))


@lru_cache(maxsize=256)
def _sampled(frequency: float, damping: float, dt: float) -> tuple[float, ...]:
    omega = 2.0 * math.pi * frequency
    # Exponential of the system with its input and the input's slope.
    system = np.zeros((4, 4))
    system[0, 1] = system[2, 3] = 1.0
    system[1] = (-(omega**2), -2.0 * damping * omega, omega**2, 0.0)
    system[2, 3] = 1.0 / dt
    whole = exponential(system * dt)
    hold, ramp = whole[:2, 2], whole[:2, 3]
    return tuple(np.concatenate((whole[:2, :2].ravel(), hold - ramp, ramp)).tolist())


@register_jitable
def follow(transition: Array, s: Array, new: float) -> float:
    """The output for a new input, the input straight between ticks; edits `s` (3,): output, its rate, last input.

    `transition` (8,): what second_order gives.
    """
    m, angle, swing, old = transition, s[0], s[1], s[2]
    s[0] = m[0] * angle + m[1] * swing + m[4] * old + m[6] * new
    s[1] = m[2] * angle + m[3] * swing + m[5] * old + m[7] * new
    s[2] = new
    return float(s[0])


@njit(cache=True)
def _sweep(transition: Array, x: Array, out: Array) -> None:
    s = np.array([x[0], 0.0, x[0]])
    for k in range(x.shape[0]):
        out[k] = follow(transition, s, x[k])


def shown(x: Array, frequency: float, damping: float, dt: float) -> Array:
    """What the instrument shows of a series x (n,), settled on its first value."""
    out = np.empty(len(x))
    _sweep(second_order(frequency, damping, dt), np.ascontiguousarray(x, dtype=np.float64), out)
    return out


def second_order_inverse(frequency: float, damping: float, s: Any) -> Any:
    """1/H at s = j omega, rad/s."""
    omega = 2.0 * math.pi * frequency
    return (s * s + 2.0 * damping * omega * s) / omega**2 + 1.0


def second_order_response(frequency: float, damping: float, s: Any) -> Any:
    """H at s = j omega, rad/s."""
    return 1.0 / second_order_inverse(frequency, damping, s)


def inverse_terms(frequency: float, damping: float) -> tuple[float, float]:
    """1/H = 1 + a s + b s^2: a (s) and b (s2)."""
    omega = 2.0 * math.pi * frequency
    return 2.0 * damping / omega, omega**-2


def vane_lag(frequency: float, damping: float) -> float:
    """How late the instrument shows what is slow, s."""
    return damping / (math.pi * frequency)
