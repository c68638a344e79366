"""What one tick of all live methods costs, Python included. Printed, not asserted.

uv run pytest tests/benchmarks/bench_estimator.py --benchmark-only
"""

import itertools
import math

import numpy as np

from station.conventions import SIGNALS, TICK_NS
from station.estimation.methods import Estimator
from station.profile import load_card
from station.rows import Frame
from station.simulation.sortie import fly


def test_estimator_tick(benchmark):
    profiles = load_card("bench")
    shown, _ = fly(profiles.aircraft, profiles.rig, profiles.card, 60.0, 1)
    table = np.array([shown.get(name, np.full(3000, math.nan)) for name in SIGNALS]).T
    frames = []
    for k, row in enumerate(table):
        there = np.isfinite(row)
        ages, quality = np.where(there, 0.0, math.nan), np.where(there, 0, 3)
        frames.append(Frame(k * TICK_NS, k, tuple(row.tolist()), tuple(ages.tolist()), tuple(quality.tolist())))
    estimator = Estimator(profiles.aircraft, profiles.card, profiles.rig.imu_position, profiles.rig.noise_si())
    estimator.warm_up()
    for frame in frames[:1500]:
        estimator.step(frame)
    rest = itertools.cycle(frames[1500:])
    last = frames[1499].t_ns

    def following():
        nonlocal last
        last += TICK_NS
        f = next(rest)
        return (Frame(last, f.k, f.values, f.age_s, f.quality),), {}

    benchmark.pedantic(estimator.step, setup=following, rounds=3000)
