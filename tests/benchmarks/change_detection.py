"""How soon is ice told, how often is there a false alarm, and is ice on wing and tail told apart?

    uv run python tests/benchmarks/change_detection.py [--flights 2] [--minutes 30] [--seen logs/change_detection]

A baseline of three calm points with recorded thrust; then flights of the bench's Twin Otter by rig boom_thrust, each
with its own gusts and noise. Ice, CL_alpha and Cm_de -10 %, CD_0 +50 %, builds up from 120 to 420 s; times are counted
from 420 s, so that a negative one came while it built up. Flights without it burn 0.06 kg/s of fuel, unrecorded, and
change speed by long elevator pulses; half of them are flown with throttle movements that nobody records.

What a monitor sees of a flight is kept in a folder, by kind, air and number: slices add up, and a monitor that changes
is counted anew without flying. FLIGHTS with ice of each kind in each air; without it three for every ten, of 20 minutes
each. The table holds all that the folder has.
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from programme_flights import flown

from station.conventions import LONGITUDINAL, SIGNAL_INDEX, SIGNALS, TICK_HZ, TICK_NS
from station.estimation.change_monitor import ChangeMonitor
from station.estimation.methods import Estimator
from station.flight.chain import FORGETTING_S
from station.profile import Aircraft, Card, load_aircraft, load_rig
from station.profile.profile_text import write_profile
from station.programme.measured_baseline import measured_baseline
from station.programme.programme import programme
from station.rows import AlphaEstimate, Code, Frame, MethodEstimate, ParamEstimate, Quality, Status
from station.simulation import fly

SIGMAS = (0, 3, 5, 10)
BEGINS_S, GROWN_S, END_S, QUIET_S = 120.0, 420.0, 600.0, 1200.0
MONITORED = ("airspeed", "dynamic_pressure", "ax", "az", "q", "elevator", "thrust", "mass")
STATUSES = list(Status)


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


@dataclass(frozen=True)
class Kind:
    """Of flights."""

    truth: Mapping[str, object]
    inputs: tuple[Mapping[str, str], ...]
    seconds: float
    seed: int
    """Of the first."""
    thrust_recorded: bool = True
    sigmas: tuple[int, ...] = SIGMAS
    share: float = 1.0
    """Of the flights asked."""


KINDS = {
    "inputs": Kind(ICE, INPUTS, END_S, 100),
    "drag": Kind(ICE, (), END_S, 200),
    "clean": Kind({}, (*INPUTS, *SLOWLY), QUIET_S, 300, share=0.3),
    "unrecorded": Kind({}, (*INPUTS, *SLOWLY), QUIET_S, 600, thrust_recorded=False, share=0.3),
    "wing": Kind(WING, INPUTS, END_S, 400, sigmas=(3,)),
    "tail": Kind(TAIL, INPUTS, END_S, 500, sigmas=(3,)),
}


def baseline(folder: Path) -> Aircraft:
    """Of three calm points of a minute; a profile in the folder."""
    kept = folder / "baseline.toml"
    if not kept.exists():
        points = [
            {"name": f"TP {i}", "condition": "baseline", "start": f"{60 * i - 35} s", "end": f"{60 * i + 25} s"}
            for i in (1, 2, 3)
        ]
        with TemporaryDirectory() as made_in:
            log = flown(Path(made_in), points, 210.0)
            own = load_aircraft("twin_otter")
            made = programme([log], [], own, ("split", "split+gust", "physical"), lambda _: None)
            write_profile(measured_baseline(made.flights, made.points, made.aircraft).aircraft, kept, "baseline")
    return load_aircraft(str(kept))


def see(aircraft: Aircraft, name: str, sigma: int, number: int, kept: Path, until: float) -> None:
    """Flies one and keeps what a monitor sees of it: its signals and the angle of attack at every tick, `physical` each
    second. Nothing after `until`."""
    kind = KINDS[name]
    if time.monotonic() > until:
        return
    flight = {"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": f"{sigma} ft/s", "truth": {**FUEL, **kind.truth}}
    card = Card.model_validate(
        {"name": "t", "aircraft": "", "rig": "", "flight": flight, "manoeuvres": [dict(m) for m in kind.inputs]}
    )
    rig = load_rig("boom_thrust")
    shown, _ = fly(load_aircraft("twin_otter"), rig, card, kind.seconds, kind.seed + number)
    if not kind.thrust_recorded:
        del shown["thrust"]
    estimator = Estimator(
        aircraft, card, rig.imu_position, rig.frame_noise_si(), ("split+gust", "physical"), forgetting_s=FORGETTING_S
    )
    count = len(shown["q"])
    rows = np.column_stack([shown.get(n, np.full(count, np.nan)) for n in SIGNALS])
    quality = tuple(int(Quality.FRESH if n in shown else Quality.MISSING) for n in SIGNALS)
    ages = tuple(0.0 if n in shown else float("nan") for n in SIGNALS)
    angles, estimates = np.empty((count, 2)), []
    for k, row in enumerate(rows.tolist()):
        alpha, methods = estimator.step(Frame(k * TICK_NS, k, tuple(row), ages, quality))
        angles[k] = alpha.alpha, alpha.valid
        if k % TICK_HZ == TICK_HZ - 1:
            made = next(m for m in methods if m.method == "physical")
            own = estimator.within_model()
            parameters = [(p.value, p.sd, STATUSES.index(p.status), own.get(p.name, math.nan)) for p in made.parameters]
            estimates.append([*parameters, (made.applicable, 0.0, 0.0, 0.0)])
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], stdout=subprocess.PIPE, text=True).stdout.strip()
    signals = rows[:, [SIGNAL_INDEX[n] for n in MONITORED]].astype(np.float32)
    part = kept.with_suffix(f".{os.getpid()}.part")
    with part.open("wb") as file:
        np.savez_compressed(file, signals=signals, angles=angles, physical=np.array(estimates), commit=commit)
    part.replace(kept)


def told(aircraft: Aircraft, kept: Path) -> list[tuple[float, Code, str]]:
    """Seconds of flight, code and words of every event that a monitor makes of a flight."""
    seen = np.load(kept)
    errors: dict[str, float] = {}
    monitor = ChangeMonitor(aircraft, FORGETTING_S, lambda: errors)
    nan, found = math.nan, []
    rows = np.full((len(seen["signals"]), len(SIGNALS)), nan)
    rows[:, [SIGNAL_INDEX[n] for n in MONITORED]] = seen["signals"]
    ages, quality, methods = (0.0,) * len(SIGNALS), (int(Quality.FRESH),) * len(SIGNALS), ()
    physical = seen["physical"].tolist()
    for k, (row, (angle, valid)) in enumerate(zip(rows.tolist(), seen["angles"].tolist(), strict=True)):
        if k % TICK_HZ == TICK_HZ - 1:
            *values, (applicable, *_) = physical[k // TICK_HZ]
            parameters = tuple(
                ParamEstimate(n, v, sd, STATUSES[int(s)], "")
                for n, (v, sd, s, _) in zip(LONGITUDINAL, values, strict=True)
            )
            errors |= {n: own for n, (*_, own) in zip(LONGITUDINAL, values, strict=True)}
            methods = (MethodEstimate(k * TICK_NS, "physical", parameters, bool(applicable), ""),)
        alpha = AlphaEstimate(k * TICK_NS, angle, nan, *(nan,) * 10, "", nan, nan, nan, bool(valid), "")
        events = monitor.step(Frame(k * TICK_NS, k, tuple(row), ages, quality), alpha, methods)
        found += [(k * TICK_NS * 1e-9, e.code, e.detail) for e in events]
    return found


Told = Sequence[tuple[float, Code, str]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin no flight later")
    parser.add_argument("--seen", type=Path, default=Path("logs/change_detection"))
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    given.seen.mkdir(parents=True, exist_ok=True)
    until = time.monotonic() + 60 * given.minutes
    aircraft = baseline(given.seen)
    wanted = [
        (name, sigma, number)
        for number in range(given.flights)
        for name, kind in KINDS.items()
        for sigma in kind.sigmas
        if number < given.flights * kind.share
    ]
    with ProcessPoolExecutor(given.processes) as pool:
        missing = [(case, path) for case in wanted if not (path := place(given.seen, *case)).exists()]
        for made in [pool.submit(see, aircraft, *case, path, until) for case, path in missing]:
            made.result()
        paths = sorted(p for name in KINDS for p in given.seen.glob(f"{name}_*.npz"))
        found = dict(zip(paths, pool.map(told, [aircraft] * len(paths), paths), strict=True))
        slopes = [p for p in paths if p.name.startswith("inputs_")]
        blind = without_drag(aircraft)
        by_slopes = dict(zip(slopes, pool.map(told, [blind] * len(slopes), slopes), strict=True))
    table(found, by_slopes)
    print(f"\nFlown by commit {', '.join(sorted({str(np.load(p)['commit']) for p in paths}))}.")


def place(folder: Path, name: str, sigma: int, number: int) -> Path:
    return folder / f"{name}_{sigma}_{number}.npz"


def without_drag(aircraft: Aircraft) -> Aircraft:
    """With a baseline that knows nothing of drag."""
    assert aircraft.measured is not None
    return aircraft.model_copy(update={"measured": aircraft.measured.model_copy(update={"CD_0": None})})


def table(found: Mapping[Path, Told], by_slopes: Mapping[Path, Told]) -> None:
    def of(name: str, sigma: int, all_of: Mapping[Path, Told] = found) -> list[Told]:
        return [r for p, r in all_of.items() if p.name.startswith(f"{name}_{sigma}_")]

    print("| gusts, ft/s | told with inputs each 20 s | these, by derivatives alone | without inputs, by drag alone "
          "| false alarms, thrust recorded | not recorded |")  # fmt: skip
    print("|---|---|---|---|---|---|")
    for sigma in SIGMAS:
        cells = [soon(of("inputs", sigma)), soon(of("inputs", sigma, by_slopes)), soon(of("drag", sigma))]
        cells += [false_alarms(of(name, sigma)) for name in ("clean", "unrecorded")]
        print(f"| {sigma} | {' | '.join(cells)} |")
    print(
        "\nSeconds after full size: median (earliest to latest), how many of how many. False alarms: in hours flown.\n"
    )
    for kind, name, other in (("wing", "ice on the wing", "tail"), ("tail", "ice on the tail", "wing")):
        flights = of(kind, 3)
        last = [words_of(r) for r in flights]
        right = sum(f"as by {name}" in w for w in last)
        among = sum(name in w for w in last) - right
        apart = sum(name in w and f"ice on the {other}" not in w for w in last)
        print(f"{name} (3 ft/s), told {soon(flights)}: at the end named first in {right} of {len(last)}, not told from "
              f"the first in {among}; that it is not ice on the {other} alone is said in {apart}")  # fmt: skip


def words_of(events: Told) -> str:
    """The last that is said of a change."""
    changed = [words for _, code, words in events if code is Code.CHANGED]
    return changed[-1] if changed else ""


def alarms(events: Told) -> list[float]:
    """When one began: what is said again of the same is no other."""
    codes = [None, *(code for _, code, _ in events)]
    return [
        t for (t, code, _), before in zip(events, codes, strict=False) if code is Code.CHANGED and before is not code
    ]


def soon(flights: Sequence[Told]) -> str:
    """Median, earliest and latest of the first told after the ice began, of those told."""
    first = [t[0] - GROWN_S for r in flights if (t := [t for t in alarms(r) if t >= BEGINS_S])]
    if not first:
        return f"0 of {len(flights)}"
    early = sum(t < BEGINS_S for r in flights for t in alarms(r))
    words = f"{np.median(first):+.0f} ({min(first):+.0f} to {max(first):+.0f}), {len(first)} of {len(flights)}"
    return words + (f", {early} before it began" if early else "")


def false_alarms(flights: Sequence[Told]) -> str:
    return f"{sum(len(alarms(r)) for r in flights)} in {len(flights) * QUIET_S / 3600:.1f} h"


if __name__ == "__main__":
    main()
