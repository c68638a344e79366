"""A nose boom's bending, as the profile has it, taken out of what its vane shows.

    shown = H_v{flow + e} + bias,   e = n H_b{c_b a + c_t qbar flow} - (L/V) d/dt H_b{...}

n is the share of the bending that turns the vane: all of a boom's, next to none of a straight wing's. `flow` is the
angle that a stiff boom's vane would stand at. Without a mode the boom bends at once (H_b = 1, L = 0) under a, the
specific force down at the CG; with one H_b is the mode's, and a that at the vane. The dynamic pressure changes little
over the vane's own lag, so that with y = H_v{flow} and the force's part of the bending taken out first

    y = shown - bias - H_b'{c_b H_v{a}} - H_b'{c_t qbar y}

where the last y, of a boom that swings, is that of one which does not: dividing by 1 + c_t qbar H_b' would be unstable
where the tip's own velocity outweighs the damping. The angular acceleration is the slope of a parabola through three
pitch rates. SI, rad.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import SIGNAL_INDEX
from station.numerics.differentiation import backward
from station.numerics.named_state import Element, Vector, blank, packed
from station.numerics.second_order import follow, second_order
from station.profile import Aircraft

Array = NDArray[np.float64]

NEEDED: Final = ("alpha_vane", "q", "az", "airspeed", "dynamic_pressure")
"""In the order of `straighten`; a missing dynamic pressure is made of the airspeed and the profile's density."""
COLUMNS: Final = tuple(SIGNAL_INDEX[n] for n in NEEDED)


class Constants(NamedTuple):
    """What `straighten` goes by."""

    dt: float
    bias: float
    """Of the vane, rad."""
    flexure: float
    """rad per m/s2."""
    load: float
    """Share of the flow angle per Pa."""
    vane_x: float
    imu_x: float
    """From the CG, m."""
    density: float
    """Of the air, kg/m3; NaN: not known."""
    vane: Annotated[Array, 8]
    """Its dynamics: second_order."""
    has_mode: bool
    mode: Annotated[Array, 8]
    mode_length: float
    """L, m."""
    mode_turn: float
    """n."""


class State:
    """What `straighten` edits."""

    count: int
    """Ticks since the start."""
    q: Vector
    """Of this tick and the two before, rad/s."""
    force: Vector
    swing: Vector
    tip: Vector
    """second_order.follow of the force's bending through the vane, of that through the mode, and of the tip load's
    bending through the mode."""


@njit(cache=True)
def _forward(m: Array, s: Array, new: float, begins: bool) -> None:
    """second_order.follow, settled on the input where it `begins`."""
    if begins:
        s[0], s[1], s[2] = new, 0.0, new
    else:
        follow(m, s, new)


@njit(cache=True)
def straighten(c: Constants, s: State, u: Array) -> float:
    """What the vane of a stiff boom would show, from NEEDED at a tick; NaN, and anew, where one is missing."""
    vane, q, az, v, pressure = u[0], u[1], u[2], u[3], u[4]
    if not pressure > 0.0:
        pressure = 0.5 * c.density * v * v
    # Only the load on the tip asks for the dynamic pressure; without any, what that does is not known.
    per_flow = c.load * pressure if c.load != 0.0 else 0.0
    if not (math.isfinite(vane + q + az + per_flow) and v > 0.0):
        s.count = 0
        return math.nan
    begins = s.count == 0
    s.q[2], s.q[1], s.q[0] = s.q[1], s.q[0], q
    turn = 0.0
    if s.count == 1:
        turn = (q - s.q[1]) / c.dt
    elif s.count > 1:
        turn = backward(q, s.q[1], s.q[2], c.dt)
    s.count += 1
    force = az + turn * (c.imu_x - (c.vane_x if c.has_mode else 0.0))
    _forward(c.vane, s.force, c.flexure * force, begins)
    bending, rise = s.force[0], c.mode_length / v
    if c.has_mode:
        _forward(c.mode, s.swing, bending, begins)
        bending = c.mode_turn * s.swing[0] - rise * s.swing[1]
    else:
        bending *= c.mode_turn
    tip = per_flow * (vane - c.bias - bending) / (1.0 + c.mode_turn * per_flow)
    if c.has_mode:
        _forward(c.mode, s.tip, tip, begins)
        tip = c.mode_turn * s.tip[0] - rise * s.tip[1]
    else:
        tip *= c.mode_turn
    return float(vane - bending - tip)


@njit(cache=True)
def _sweep(constants: Element, state: Element, u: Array, out: Array) -> None:
    """`straighten` of every row of `u` (n, NEEDED) -> `out` (n,)."""
    for k in range(u.shape[0]):
        out[k] = straighten(constants[0], state[0], u[k])


class Bending:
    """Constants and state of `straighten`, for frames at steps of dt."""

    def __init__(self, aircraft: Aircraft, imu_position: tuple[float, float, float], dt: float) -> None:
        """`imu_position`: m from the CG, by the rig."""
        boom = aircraft.boom
        assert boom is not None
        mode = boom.mode_frequency
        self._constants = packed(
            Constants(
                dt=dt,
                bias=boom.zero,
                flexure=boom.flexure,
                load=boom.tip_load / 1000.0,
                vane_x=boom.vane_x,
                imu_x=aircraft.imu_at(imu_position)[0],
                density=aircraft.air_density or math.nan,
                vane=second_order(boom.vane_frequency, boom.vane_damping, dt),
                has_mode=mode is not None,
                mode=np.zeros(8) if mode is None else second_order(mode, boom.mode_damping, dt),
                mode_length=0.0 if mode is None else boom.mode_length,
                mode_turn=boom.mode_turn,
            )
        )
        self._dt = dt
        self._state = blank(State)
        self._out = np.empty(1)
        self._last_s = -math.inf
        _sweep(self._constants, self._state, np.full((1, len(NEEDED)), math.nan), self._out)

    def step(self, t_s: float, u: Array) -> float:
        """One frame's NEEDED (5,), NaN where missing; after a gap anew."""
        if not 0.0 < t_s - self._last_s < 1.5 * self._dt:
            self._state["count"] = 0
        self._last_s = t_s
        _sweep(self._constants, self._state, u[None], self._out)
        return float(self._out[0])

    def sweep(self, columns: Mapping[str, Array]) -> Array:
        """All of a table at steps of dt, (n,); for an object of its own."""
        count = len(columns["alpha_vane"])
        u = np.column_stack([columns.get(n, np.full(count, math.nan)) for n in NEEDED])
        out = np.empty(count)
        _sweep(self._constants, self._state, u, out)
        return out
