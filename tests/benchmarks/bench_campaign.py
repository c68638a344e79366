"""Seconds of the compiled pass, of the plain path and of JSBSim for the same 20 s flights. Printed, not asserted.

uv run pytest tests/benchmarks/bench_campaign.py --benchmark-only
"""

import jsbsim
import numpy as np

from station.campaign.case import flight_of, flown_aircraft, fly_case, known_aircraft, manoeuvres_of, prepare
from station.campaign.spec import load_plan
from station.conventions import SIGNALS, TICK_NS
from station.estimation.methods import Estimator
from station.profile import Card
from station.rows import Frame
from station.simulation import fly

CAMPAIGN = "chapter4_condition2_map"


def test_compiled_flights(benchmark):
    """16 flights a round: 20 s, simulated at 200 Hz, estimated at 50 Hz."""
    plan = load_plan(CAMPAIGN)
    setup = prepare(plan, plan.cases[-1])
    benchmark(lambda: list(fly_case(setup, range(16))))


def test_plain_flight(benchmark):
    """One of the same flights by fly() and the Estimator's ticks."""
    plan = load_plan(CAMPAIGN)
    campaign, scenario = plan.campaign, plan.cases[-1].scenario
    flown = flown_aircraft(scenario)
    card = Card.model_validate({"name": "t", "aircraft": "t", "rig": "t"}).model_copy(
        update={
            "flight": flight_of(campaign, scenario),
            "manoeuvres": manoeuvres_of(campaign, scenario),
            "warm_up": 0.0,
        }
    )
    known, nothing, fresh = known_aircraft(scenario, flown), (0.0,) * len(SIGNALS), (0,) * len(SIGNALS)
    Estimator(known, card, methods=("II",), axes="body").warm_up()

    def flight():
        shown, _ = fly(flown, {}, card, 20.0)
        estimator = Estimator(known, card, methods=("II",), axes="body")
        for k, row in enumerate(np.stack([shown[name] for name in SIGNALS], axis=1).tolist()):
            estimator.step(Frame(k * TICK_NS, k, tuple(row), nothing, fresh))

    benchmark.pedantic(flight, rounds=5, warmup_rounds=1)


def test_jsbsim_flight(benchmark):
    """4,000 steps of JSBSim's DHC6: 20 s at 200 Hz, six degrees of freedom, no sensors, no estimates."""
    sim = jsbsim.FGFDMExec(None)
    sim.set_debug_level(0)
    sim.load_model("DHC6")
    sim.set_dt(1 / 200)
    settings = {"ic/h-sl-ft": 2500.0, "ic/vt-kts": 110.0, "propulsion/set-running": -1}
    for engine in (0, 1):
        settings |= {f"fcs/throttle-cmd-norm[{engine}]": 0.5, f"fcs/mixture-cmd-norm[{engine}]": 0.9}
    for name, value in settings.items():
        sim[name] = value
    sim.run_ic()

    def flight():
        for _ in range(4000):
            sim.run()

    benchmark.pedantic(flight, rounds=5, warmup_rounds=1)
