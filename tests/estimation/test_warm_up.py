"""Compiling takes seconds: all of it must happen before the loop starts."""

import subprocess
import sys

FLIGHT = """
import gc
from numba.core.dispatcher import Dispatcher
from station.conventions import SIGNALS, TICK_NS
from station.estimation.methods import Estimator
from station.profile import load_card
from station.rows import Frame
from station.simulation.sortie import fly

profiles = load_card("lateral")
estimator = Estimator(profiles.aircraft, profiles.card, profiles.rig.imu_position, profiles.rig.frame_noise_si())
shown, _ = fly(profiles.aircraft, profiles.rig, profiles.card, 75.0)

def compiled():
    kernels = [d for d in gc.get_objects() if isinstance(d, Dispatcher) and d.py_func.__module__.startswith("station")]
    return {(d.py_func.__qualname__, str(s)) for d in kernels for s in d.signatures}

estimator.warm_up()
before = compiled()
asked, made = set(), set()
for k in range(len(shown["q"])):
    values = tuple(float(shown[n][k]) if n in shown else float("nan") for n in SIGNALS)
    there = [v == v for v in values]
    ages = tuple(0.0 if t else float("nan") for t in there)
    _, methods = estimator.step(Frame(k * TICK_NS, k, values, ages, tuple(0 if t else 3 for t in there)))
    asked |= {(m.method, p.name) for m in methods for p in m.parameters}
    # Significant or not: the profile's inertias leave some of them too uncertain.
    made |= {(m.method, p.name) for m in methods for p in m.parameters if p.status != "invalid" and p.sd > 0}
print(len(asked), len(made), sorted(compiled() - before))
"""


def test_no_kernel_is_compiled_in_flight():
    done = subprocess.run([sys.executable, "-c", FLIGHT], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    asked, made, late = done.stdout.split(maxsplit=2)
    assert int(asked) > 50
    assert made == asked  # the flight went through every method's estimate of everything
    assert late.strip() == "[]"
