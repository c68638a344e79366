"""Air data of blocks made by hand: what gusts in the readings do to the airspeed's scale."""

from __future__ import annotations

import math

import numpy as np

from station.conventions import G0
from station.model.air_data_calibration import Blocks, Place, solve

SLOPE = 0.03
BLOCK_S = 4.0
RUN = 15
"""Blocks of a run: a minute."""
SPEEDS = (45.0, 45.0, 55.0, 55.0, 65.0, 65.0)
HEADINGS = (0.0, math.pi, 0.5 * math.pi, -0.5 * math.pi, 0.0, math.pi)


def flown(seed: int) -> Blocks:
    """Level runs at three speeds on reverse headings, in gusts along the path of 0.8 m/s that pass in 8 s. The pilot
    holds the speed through the mean air: the readings have the gusts, the motion has nothing of them."""
    rng = np.random.default_rng(seed)
    v = np.repeat(SPEEDS, RUN)
    n, fall = len(v), math.exp(-BLOCK_S / 8.0)
    gust = np.zeros(n)
    gust[0] = 0.8 * rng.standard_normal()
    for k in range(1, n):
        gust[k] = fall * gust[k - 1] + 0.8 * math.sqrt(1 - fall**2) * rng.standard_normal()
    heading = np.repeat(HEADINGS, RUN)
    alpha = 0.1 * (55.0 / v) ** 2
    airspeed = (1 + SLOPE) * (v + gust)
    still = np.zeros(n)
    columns = {
        "airspeed": airspeed,
        "dynamic_pressure": 0.5 * 1.2 * airspeed**2 + 0.5 * rng.standard_normal(n),
        "alpha_vane": alpha + 0.003 * rng.standard_normal(n),
        "theta": alpha,
        "psi": heading,
        "v_north": v * np.cos(heading),
        "v_east": v * np.sin(heading),
        "ax": G0 * np.sin(alpha) + 0.01 * rng.standard_normal(n),
        "az": -G0 * np.cos(alpha) + 0.01 * rng.standard_normal(n),
        **dict.fromkeys(("phi", "p", "q", "r", "v_down", "v_north_dot", "v_east_dot", "v_down_dot"), still),
    }
    columns["swept"] = still
    runs = np.repeat(airspeed.reshape(-1, RUN).mean(axis=1), RUN)
    whole = np.ones(n, dtype=bool)
    return Blocks(np.arange(n) * BLOCK_S, columns, np.full(n, 1.2), whole, runs)


def test_gusts_that_pass_make_no_scale_of_the_airspeed() -> None:
    """With each block's own reading as the regressor it came out 0.016 high on average."""
    made = [solve(flown(seed), Place(5.0, 0.0, 0.0, 0.0)) for seed in range(6)]
    errors = np.array([m.value("airspeed_slope") - SLOPE for m in made])
    # Of a mean of six: a run's mean gust, 0.8 m/s sqrt(2 8/60), over six runs at 55 m/s, is 0.3 % of the speed.
    assert abs(errors.mean()) < 3 * 0.003 / math.sqrt(6)
    assert all(abs(e) < 3 * m.sd("airspeed_slope") for e, m in zip(errors, made, strict=True))
