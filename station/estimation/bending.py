"""A nose boom's bending, as the profile has it, taken out of what its vane shows.

    shown = H_v{flow + bend} + zero,   bend = H_b{c_b a + c_t qbar flow} - (L/V) d/dt H_b{...}

`flow` is the angle that a stiff boom's vane would stand at. Without a mode the boom bends at once (H_b = 1, L = 0)
under a, the specific force down at the CG; with one H_b is the mode's, and a that at the vane. The dynamic pressure
changes little over the vane's own lag, so that with y = H_v{flow} and the force's part of the bending taken out first

    y = shown - zero - H_b'{c_b H_v{a}} - H_b'{c_t qbar y}

where the last y, of a boom that swings, is that of one which does not: dividing by 1 + c_t qbar H_b' would be unstable
where the tip's own velocity outweighs the damping. The angular acceleration is the slope of a parabola through three
pitch rates. SI, rad.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import SIGNAL_INDEX
from station.numerics.differentiation import backward
from station.numerics.second_order import follow, second_order
from station.profile import Aircraft

Array = NDArray[np.float64]

NEEDED: Final = ("alpha_vane", "q", "az", "airspeed", "dynamic_pressure")
"""In the order of `straighten`; a missing dynamic pressure is made of the airspeed and the
profile's density."""
COLUMNS: Final = tuple(SIGNAL_INDEX[n] for n in NEEDED)
_ZERO, _FLEXURE, _LOAD, _X, _IMU, _LENGTH, _HAS_MODE, _DENSITY, _DT, _VANE, _MODE, PARAMETERS = *range(10), 17, 25
_COUNT, _Q1, _Q2, _SEEN, _BENT, _TIP, STATE = 0, 1, 2, 3, 6, 9, 12


@njit(cache=True)
def _forward(m: Array, s: Array, new: float, begins: bool) -> None:
    """second_order.follow, settled on the input where it `begins`."""
    if begins:
        s[0], s[1], s[2] = new, 0.0, new
    else:
        follow(m, s, new)


@njit(cache=True)
def straighten(par: Array, s: Array, u: Array) -> float:
    """What the vane of a stiff boom would show, from NEEDED at a tick; NaN, and anew, where one is missing."""
    vane, q, az, v, pressure = u[0], u[1], u[2], u[3], u[4]
    if not pressure > 0.0:
        pressure = 0.5 * par[_DENSITY] * v * v
    # Only the load on the tip asks for the dynamic pressure; without any, what that does is not known.
    per_flow = par[_LOAD] * pressure if par[_LOAD] != 0.0 else 0.0
    if not (math.isfinite(vane + q + az + per_flow) and v > 0.0):
        s[_COUNT] = 0.0
        return math.nan
    begins = s[_COUNT] == 0.0
    if begins:
        turn = 0.0
    elif s[_COUNT] == 1.0:
        turn = (q - s[_Q1]) / par[_DT]
    else:
        turn = backward(q, s[_Q1], s[_Q2], par[_DT])
    s[_COUNT], s[_Q2], s[_Q1] = s[_COUNT] + 1.0, s[_Q1], q
    force = az + turn * (par[_IMU] - par[_HAS_MODE] * par[_X])
    _forward(par[_VANE : _VANE + 8], s[_SEEN : _SEEN + 3], par[_FLEXURE] * force, begins)
    bend = s[_SEEN]
    mode, rise = par[_MODE : _MODE + 8], par[_LENGTH] / v
    if par[_HAS_MODE] > 0.0:
        _forward(mode, s[_BENT : _BENT + 3], bend, begins)
        bend = s[_BENT] - rise * s[_BENT + 1]
    tip = per_flow * (vane - par[_ZERO] - bend) / (1.0 + per_flow)
    if par[_HAS_MODE] > 0.0:
        _forward(mode, s[_TIP : _TIP + 3], tip, begins)
        tip = s[_TIP] - rise * s[_TIP + 1]
    return float(vane - bend - tip)


@njit(cache=True)
def _sweep(par: Array, s: Array, u: Array, out: Array) -> None:
    for k in range(u.shape[0]):
        out[k] = straighten(par, s, u[k])


class Bending:
    """The state of `straighten`, for frames at steps of dt."""

    def __init__(self, aircraft: Aircraft, imu_position: tuple[float, float, float], dt: float) -> None:
        """`imu_position`: m from the CG, by the rig."""
        boom = aircraft.boom
        assert boom is not None
        par = self._par = np.zeros(PARAMETERS)
        par[_ZERO], par[_FLEXURE], par[_LOAD] = boom.zero, boom.flexure, boom.tip_load / 1000.0
        par[_X], par[_IMU] = boom.vane_x, aircraft.imu_at(imu_position)[0]
        par[_DENSITY], par[_DT] = aircraft.air_density or math.nan, dt
        par[_VANE : _VANE + 8] = second_order(boom.vane_frequency, boom.vane_damping, dt)
        if boom.mode_frequency is not None:
            par[_HAS_MODE], par[_LENGTH] = 1.0, boom.mode_length
            par[_MODE : _MODE + 8] = second_order(boom.mode_frequency, boom.mode_damping, dt)
        self._dt = dt
        self._state = np.zeros(STATE)
        self._last_s = -math.inf
        straighten(self._par, self._state, np.full(len(NEEDED), math.nan))

    def step(self, t_s: float, u: Array) -> float:
        """One frame's NEEDED (5,), NaN where missing; after a gap anew."""
        if not 0.0 < t_s - self._last_s < 1.5 * self._dt:
            self._state[_COUNT] = 0.0
        self._last_s = t_s
        return float(straighten(self._par, self._state, u))

    def sweep(self, columns: Mapping[str, Array]) -> Array:
        """All of a table at steps of dt, (n,); for an object of its own."""
        count = len(columns["alpha_vane"])
        u = np.column_stack([columns.get(n, np.full(count, math.nan)) for n in NEEDED])
        out = np.empty(count)
        _sweep(self._par, self._state, u, out)
        return out


def bends(aircraft: Aircraft) -> bool:
    return aircraft.boom is not None and bool(aircraft.boom.flexure or aircraft.boom.tip_load)
