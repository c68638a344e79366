"""Flights per second of a campaign, what a flight costs from few flights to many, memory; and the same 20 s flight by
the plain path and in JSBSim.

OPENBLAS_NUM_THREADS=1 uv run python tests/benchmarks/bench_campaign.py [FLIGHTS...]        by default 100 1000 10000
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import jsbsim
import numpy as np

from station.campaign.case import fly_case, prepare
from station.campaign.flown_scenario import flight_of, flown_aircraft, known_aircraft, manoeuvres_of
from station.campaign.spec import load_plan
from station.conventions import SIGNALS, TICK_NS
from station.estimation.methods import Estimator
from station.profile import Card, profiles_dir
from station.rows import Frame
from station.simulation import fly

CAMPAIGN = "chapter4_condition2"
STEPS = 4000
"""Of a flight: 20 s at 200 Hz."""
LEVELS = 4


def campaign(folder: Path, flights: int) -> tuple[float, float, float]:
    """Fly so many; seconds, CPU seconds of all its processes, and MiB of the largest."""
    text = (profiles_dir() / "campaigns" / f"{CAMPAIGN}.toml").read_text(encoding="utf-8")
    head = text.split("[[claims]]")[0]
    spec = folder / f"flights_{flights}.toml"
    spec.write_text(
        head.replace("runs = 200", f"runs = {flights // LEVELS}").replace('figures = ["estimates"]', "figures = []"),
        encoding="utf-8",
    )
    begin = time.perf_counter()
    child = subprocess.Popen(
        [sys.executable, "-m", "station", "campaign", str(spec), "-o", str(folder / str(flights))],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    _, status, used = os.wait4(child.pid, 0)
    if status:
        raise SystemExit(f"the campaign of {flights} flights failed")
    return time.perf_counter() - begin, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def fastest(call: Callable[[], object], times: int) -> float:
    """Seconds of CPU of the fastest of some calls, the first not counted: what else runs matters less."""
    call()
    seconds = []
    for _ in range(times):
        begin = time.process_time()
        call()
        seconds.append(time.process_time() - begin)
    return min(seconds)


def compiled_flight() -> float:
    """Seconds of one flight on one core: random numbers, flight, sensors, estimates."""
    plan = load_plan(CAMPAIGN)
    setup = prepare(plan, plan.cases[-1])
    return fastest(lambda: list(fly_case(setup, range(16))), 5) / 16


def plain_flight() -> float:
    """The same flight by fly() and the Estimator's ticks."""
    plan = load_plan(CAMPAIGN)
    setting, scenario = plan.campaign, plan.cases[-1].scenario
    flown = flown_aircraft(scenario)
    card = Card.model_validate({"name": "t", "aircraft": "t", "rig": "t"}).model_copy(
        update={
            "flight": flight_of(setting, scenario),
            "manoeuvres": manoeuvres_of(setting, scenario),
            "warm_up": 0.0,
        }
    )
    known, nothing, fresh = known_aircraft(scenario, flown), (0.0,) * len(SIGNALS), (0,) * len(SIGNALS)
    Estimator(known, card, methods=("II",), axes="body").warm_up()

    def flight() -> None:
        shown, _ = fly(flown, {}, card, 20.0)
        estimator = Estimator(known, card, methods=("II",), axes="body")
        unknown = np.full(len(shown["q"]), np.nan)
        for k, row in enumerate(np.stack([shown.get(name, unknown) for name in SIGNALS], axis=1).tolist()):
            estimator.step(Frame(k * TICK_NS, k, tuple(row), nothing, fresh))

    return fastest(flight, 3)


def jsbsim_flight() -> float:
    """As many steps of JSBSim's DHC6: six degrees of freedom, no sensors, no estimates."""
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

    def flight() -> None:
        for _ in range(STEPS):
            sim.run()

    return fastest(flight, 3)


def main(sizes: list[int]) -> None:
    one, plain, other = compiled_flight(), plain_flight(), jsbsim_flight()
    print(f"one core: {one * 1e3:.2f} ms a flight, {1 / one:.0f} flights/s, {STEPS / one:,.0f} steps/s")
    print(f"plain path: {plain * 1e3:.0f} ms a flight: {plain / one:.0f} times as long")
    print(
        f"JSBSim: {STEPS / other:,.0f} steps/s, without sensors and estimates: {other / one:.0f} times as long a flight"
    )
    with tempfile.TemporaryDirectory() as name:
        campaign(Path(name), LEVELS)  # compiles
        start, idle, _ = campaign(Path(name), 2 * LEVELS)
        print(f"start and end of a campaign: {start:.1f} s, {idle:.1f} s of CPU; on {os.cpu_count()} cores:")
        for flights in sizes:
            seconds, cpu, memory = campaign(Path(name), flights)
            each = (cpu - idle) / flights * 1e3
            print(
                f"{flights:7,} flights: {seconds:6.1f} s in all, {each:5.2f} ms of CPU a flight beyond the start, "
                f"{memory:4.0f} MiB in the largest process"
            )


if __name__ == "__main__":
    main([int(n) for n in sys.argv[1:]] or [100, 1_000, 10_000])
