"""Pitch attitude of a record that has none: the integral of the pitch rate, level as the airspeed says.

    theta = integral of q cos(phi) - r sin(phi), and a slow d(t)
    u     = u_0 + integral of ax - q w - g sin(theta),           u, w: airspeed along body x and z, by the vane

d is the polynomial, one degree a minute, by which the second line fits best: the attitude at the start, the gyro's zero
and its drift. In the band of identification it is nil, and a constant in theta is of no account to any derivative.
Gusts along the path tilt it by less than a degree. Wings level where no bank is recorded. SI, rad.

Source: Klein and Morelli 2006, equations 3.29 and 3.32 (kinematics of rotation and translation).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from station.conventions import G0
from station.log import Table

Array = NDArray[np.float64]

NEEDED: Final = ("q", "ax", "airspeed", "alpha_vane")
RECONSTRUCTED: Final = "no pitch attitude recorded: integrated from the pitch rate, level as ax and airspeed say"
SHORTEST_S: Final = 5.0
"""Shorter, gusts along the path are taken for a tilt of degrees."""
BEND_S: Final = 60.0
"""In which a gyro's zero changes too little for another degree."""
ITERATIONS: Final = 3
"""Of Gauss-Newton, for the sine: from level flight, the second changes a pitch of 20 deg by 0.01 deg."""


def with_pitch(table: Table) -> Table:
    """The table with `theta` (n,), rad, where it has none and what it takes; else as it is. NaN where q is."""
    columns = table.columns
    if np.isfinite(columns.get("theta", np.empty(0))).any():
        return table
    t = table.t_s
    if not len(t) or t[-1] - t[0] < SHORTEST_S:
        return table
    x = {n: _filled(t, columns[n]) for n in (*NEEDED, "phi", "r") if np.isfinite(columns.get(n, np.empty(0))).any()}
    if not set(NEEDED) <= set(x):
        return table
    phi, r = (x.get(n, np.zeros(len(t))) for n in ("phi", "r"))
    turned = _integral(x["q"] * np.cos(phi) - r * np.sin(phi), t)
    forward, down = x["airspeed"] * np.cos(x["alpha_vane"]), x["airspeed"] * np.sin(x["alpha_vane"])
    gained = forward - _integral(x["ax"] - x["q"] * down, t)
    degree = 1 + int((t[-1] - t[0]) / BEND_S)
    shapes = chebyshev.chebvander(2 * (t - t[0]) / (t[-1] - t[0]) - 1, degree)
    theta = turned - turned.mean()
    for _ in range(ITERATIONS):
        slopes = np.column_stack([_integral(np.cos(theta) * shape, t) for shape in shapes.T])
        sides = (gained + G0 * _integral(np.sin(theta), t)) / -G0
        found = np.linalg.lstsq(np.column_stack([slopes, np.ones(len(t))]), sides, rcond=None)[0]
        theta = theta + shapes @ found[:-1]
    return replace(table, columns={**columns, "theta": np.where(np.isfinite(columns["q"]), theta, np.nan)})


def _integral(rate: Array, t: Array) -> Array:
    return np.concatenate(([0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))))


def _filled(t: Array, column: Array) -> Array:
    good = np.isfinite(column)
    return np.asarray(np.interp(t, t[good], column[good]))
