"""How soon is ice told, how often is there a false alarm, and is ice on wing and tail told apart?

uv run python tests/benchmarks/change_detection.py [FLIGHTS]

A baseline of three calm points with recorded thrust; then flights of the bench's Twin Otter by rig boom_thrust, each
with its own gusts and noise. Ice, CL_alpha and Cm_de -10 %, CD_0 +50 %, builds up from 120 to 420 s; times are counted
from 420 s, so that a negative one came while it built up. Flights without it burn 0.06 kg/s of fuel, unrecorded, and
change speed by long elevator pulses. FLIGHTS (2) a cell; of those without ice twice as many.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from programme_flights import flown

from station.conventions import SIGNALS, TICK_NS
from station.estimation.change_monitor import ChangeMonitor
from station.estimation.methods import Estimator
from station.flight.chain import FORGETTING_S
from station.profile import Aircraft, Card, load_aircraft, load_rig
from station.programme.measured_baseline import measured_baseline
from station.programme.programme import programme
from station.rows import Code, Frame, Quality
from station.simulation import fly

SIGMAS = (0, 3, 5, 10)
GROWN_S, END_S, QUIET_S = 420.0, 600.0, 1200.0


def ramp(last: float) -> dict[str, object]:
    return {"at": ["120 s", "420 s"], "factor": [1.0, last]}


ICE = {"derivatives.CL_alpha": ramp(0.9), "derivatives.Cm_de": ramp(0.9), "drag.zero_lift": ramp(1.5)}
WING = {"derivatives.CL_alpha": ramp(0.9), "drag.zero_lift": ramp(1.45)}
TAIL = {
    "derivatives.CL_de": ramp(0.905), "derivatives.Cm_alpha": ramp(0.901), "derivatives.Cm_q": ramp(0.965),
    "derivatives.Cm_de": ramp(0.9), "drag.zero_lift": ramp(1.05),
}  # fmt: skip
"""The reference icing condition (Bragg et al. 2002) by the surface whose derivatives they are."""
FUEL = {"inertia.mass": {"at": ["0 s", "1200 s"], "value": ["4962 kg", "4890 kg"]}}
INPUTS = (
    {"kind": "doublet", "start": "25 s", "repeat": "40 s", "amplitude": "3.5 deg", "width": "0.6 s"},
    {"kind": "3-2-1-1", "start": "45 s", "repeat": "40 s", "amplitude": "-2.5 deg", "unit": "0.5 s"},
)
SLOWLY = (
    {"kind": "pulse", "start": "200 s", "repeat": "300 s", "amplitude": "0.4 deg", "width": "80 s"},
    {"kind": "pulse", "start": "350 s", "repeat": "300 s", "amplitude": "-0.4 deg", "width": "80 s"},
)


def baseline() -> Aircraft:
    """Of three calm points of a minute."""
    points = [
        {"name": f"TP {i}", "condition": "baseline", "start": f"{60 * i - 35} s", "end": f"{60 * i + 25} s"}
        for i in (1, 2, 3)
    ]
    with TemporaryDirectory() as folder:
        log = flown(Path(folder), points, 210.0)
        made = programme([log], [], load_aircraft("twin_otter"), ("split", "split+gust", "physical"), lambda _: None)
        return measured_baseline(made.flights, made.points, made.aircraft).aircraft


def told(
    aircraft: Aircraft, truth: Mapping[str, object], inputs: tuple[Mapping[str, str], ...], sigma: float, seed: int,
    seconds: float,
) -> list[tuple[float, str]]:  # fmt: skip
    """Seconds of flight and words of every change that is told."""
    flight = {"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": f"{sigma} ft/s", "truth": {**FUEL, **truth}}
    card = Card.model_validate(
        {"name": "t", "aircraft": "", "rig": "", "flight": flight, "manoeuvres": [dict(m) for m in inputs]}
    )
    rig = load_rig("boom_thrust")
    shown, _ = fly(load_aircraft("twin_otter"), rig, card, seconds, seed)
    estimator = Estimator(
        aircraft, card, rig.imu_position, rig.frame_noise_si(), ("split+gust", "physical"), forgetting_s=FORGETTING_S
    )
    monitor = ChangeMonitor(aircraft, FORGETTING_S)
    columns = [shown[n] if n in shown else np.full(len(shown["q"]), np.nan) for n in SIGNALS]
    rows = np.column_stack(columns).tolist()
    quality = tuple(int(Quality.FRESH if n in shown else Quality.MISSING) for n in SIGNALS)
    ages = tuple(0.0 if n in shown else float("nan") for n in SIGNALS)
    found = []
    for k, row in enumerate(rows):
        frame = Frame(k * TICK_NS, k, tuple(row), ages, quality)
        alpha, methods = estimator.step(frame)
        found += [(k * TICK_NS * 1e-9, e.detail) for e in monitor.step(frame, alpha, methods) if e.code is Code.CHANGED]
    return found


def main() -> None:
    flights = int(sys.argv[1]) if len(sys.argv) > 1 else 2
    aircraft = baseline()
    cases: list[tuple[object, ...]] = []
    for sigma in SIGMAS:
        cases += [("inputs", sigma, ICE, INPUTS, END_S, 100 + s) for s in range(flights)]
        cases += [("drag", sigma, ICE, (), END_S, 200 + s) for s in range(flights)]
        cases += [("clean", sigma, {}, (*INPUTS, *SLOWLY), QUIET_S, 300 + s) for s in range(2 * flights)]
    cases += [("wing", 3, WING, INPUTS, END_S, 400 + s) for s in range(2 * flights)]
    cases += [("tail", 3, TAIL, INPUTS, END_S, 500 + s) for s in range(2 * flights)]
    with ProcessPoolExecutor(2) as pool:
        made = [pool.submit(told, aircraft, c[2], c[3], c[1], c[5], c[4]) for c in cases]  # type: ignore[arg-type]
        results = [m.result() for m in made]
    table(cases, results)


def table(cases: list[tuple[object, ...]], results: list[list[tuple[float, str]]]) -> None:
    by = {kind: [(c[1], r) for c, r in zip(cases, results, strict=True) if c[0] == kind] for kind in
          ("inputs", "drag", "clean", "wing", "tail")}  # fmt: skip
    print("| gusts, ft/s | told with inputs each 20 s, s after full size | without inputs | false alarms |")
    print("|---|---|---|---|")
    for sigma in SIGMAS:
        cells = [soon([r for s, r in by[kind] if s == sigma]) for kind in ("inputs", "drag")]
        clean = [r for s, r in by["clean"] if s == sigma]
        print(f"| {sigma} | {' | '.join(cells)} | {sum(map(len, clean))} in {len(clean) * QUIET_S / 3600:.1f} h |")
    print()
    for kind, name in (("wing", "ice on the wing"), ("tail", "ice on the tail")):
        last = [r[-1][1] if r else "" for _, r in by[kind]]
        right = sum(f"as by {name}" in w for w in last)
        among = sum(name in w for w in last)
        print(f"{name} (3 ft/s): first named in {right} of {len(last)}, first or not told from the first in {among}, "
              f"nothing told in {last.count('')}.")  # fmt: skip


def soon(flights: list[list[tuple[float, str]]]) -> str:
    """Median and latest of the first told, of those told."""
    first = [r[0][0] - GROWN_S for r in flights if r]
    early = sum(t < 120.0 - GROWN_S for t in first)
    words = f"{np.median(first):+.0f} (latest {max(first):+.0f}), {len(first)} of {len(flights)}" if first else "none"
    return words + (f", {early} before it began" if early else "")


if __name__ == "__main__":
    main()
