"""Every method on the same simulated flights: the README's table, and the picture of one flight. Run by hand; prints,
asserts nothing.

    uv run python tests/benchmarks/methods_table.py [--seeds 8] [--workers 2] [--rows PATH]   the table
    uv run python tests/benchmarks/methods_table.py --picture PATH                            the picture

Flights of 150 s, the manoeuvre in the last 30 s; IV measures its spectra on all of each. III, IV and V are forced in
calm air. Errors are mean RMSE in per cent over CL_alpha, Cm_alpha, Cm_q, Cm_de: of `physical` from the tabulated
derivatives, of all others from what the manoeuvre gives in calm air with a perfect angle of attack (as campaign
monte_carlo has it).
"""

from __future__ import annotations

import argparse
import itertools
import json
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from station.campaign.case import prepare, reference
from station.campaign.spec import METHODS as SLOTS
from station.campaign.spec import Case, load_plan
from station.conventions import LONGITUDINAL
from station.identification.analysis import identify
from station.identification.identification_json import as_json
from station.identification.request import Request
from station.log import Table
from station.profile import Card, Doublet, Flight, Multisine, load_aircraft, load_rig
from station.simulation.sortie import fly

METHODS = ("I", "II", "III", "IV", "V", "VI", "split", "split+gust", "physical")
AIRCRAFT = {"A": "twin_otter_martos", "B": "twin_otter"}
SIGMAS = (0.0, 2.5, 5.0, 10.0)
INPUTS = ("doublet", "multisine")
COUNTED = ("CL_alpha", "Cm_alpha", "Cm_q", "Cm_de")
SECONDS, START = 150.0, 120.0
Values = dict[str, tuple[float, float]]


def card(sigma: float, kind: str) -> Card:
    gusts = Flight.model_validate({"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": f"{sigma} ft/s"})
    doublet = {"kind": "doublet", "start": f"{START + 2} s", "amplitude": "3.5 deg", "width": "1.3 s"}
    multisine = {"kind": "multisine", "start": f"{START} s", "duration": "30 s", "amplitude": "2 deg"}
    wave = Doublet.model_validate(doublet) if kind == "doublet" else Multisine.model_validate(multisine)
    return Card(name="table", aircraft="", rig="bench", flight=gusts, manoeuvres=(wave,))


def flown(aircraft: str, sigma: float, kind: str, seed: int, methods: tuple[str, ...]) -> dict[str, Any]:
    """What identify makes of one flight."""
    profile, rig, test = load_aircraft(AIRCRAFT[aircraft]), load_rig("bench"), card(sigma, kind)
    shown, _ = fly(profile, rig, test, SECONDS, seed)
    for name in ("thrust", "mass", "pdot", "qdot", "rdot"):
        shown.pop(name, None)
    table = Table(np.arange(len(shown["q"])) * 0.02, shown, profile, 0)
    request = Request(methods, START, card=test, imu_position=rig.imu_position, noise=rig.noise_si(), force=True)
    return as_json(identify(table, profile, request))


def values(found: dict[str, Any]) -> dict[str, Values]:
    return {
        method: {n: (p["estimate"], p["std_error"]) for n, p in made["parameters"].items() if n in LONGITUDINAL}
        for method, made in found["methods"].items()
    }


@cache
def wanted(aircraft: str, kind: str) -> dict[str, dict[str, float]]:
    """For each method the six derivatives that it should give."""
    plan = load_plan("monte_carlo")
    case = next(
        c
        for c in plan.cases
        if (c.scenario.aircraft, c.scenario.lift, c.scenario.input) == (AIRCRAFT[aircraft], "unsteady", kind)
    )
    target = reference(plan, prepare(plan, Case(case.number, case.levels, case.scenario)))
    calm, table = target[SLOTS.index("II")].ravel(), target[SLOTS.index("physical")].ravel()
    return {m: dict(zip(LONGITUDINAL, table if m == "physical" else calm, strict=True)) for m in (*METHODS, "oe", "fe")}


def one(job: tuple[str, float, str, int], methods: tuple[str, ...]) -> dict[str, Any]:
    aircraft, sigma, kind, seed = job
    found = values(flown(*job, methods))
    return {"aircraft": aircraft, "sigma": sigma, "input": kind, "seed": seed, "methods": found}


def rmse(rows: list[dict[str, Any]], method: str, aircraft: str, kind: str) -> float:
    target = wanted(aircraft, kind)[method]
    errors = [[r["methods"][method][n][0] / target[n] - 1 for n in COUNTED] for r in rows]
    return 100 * float(np.sqrt(np.mean(np.square(errors), axis=0)).mean())


def print_table(rows: list[dict[str, Any]]) -> None:
    print(f"| {' / '.join(AIRCRAFT)} | {' | '.join(METHODS)} |")
    print("|---" * (len(METHODS) + 1) + "|")
    for kind, sigma in itertools.product(INPUTS, SIGMAS):
        cells = []
        for method in METHODS:
            both = []
            for aircraft in AIRCRAFT:
                mine = [r for r in rows if (r["aircraft"], r["input"], r["sigma"]) == (aircraft, kind, sigma)]
                both.append(f"{rmse(mine, method, aircraft, kind):.1f}" if mine else "")
            cells.append(" / ".join(both))
        print(f"| {f'σ {sigma:g} ft/s' if sigma else 'calm'}, {kind} | {' | '.join(cells)} |")


def picture(path: Path) -> None:
    """All methods on one flight of set A in light turbulence, beside what three flights give in calm air."""
    found = values(flown("A", 5.0, "doublet", 1, METHODS))
    calm = [values(flown("A", 0.0, "doublet", seed, ("split",)))["split"] for seed in (6, 7, 8)]
    figure = Figure(figsize=(10, 5.8), layout="constrained")
    for axes, name in zip(figure.subplots(2, 3).flat, LONGITUDINAL, strict=True):
        level = [c[name][0] for c in calm]
        table = wanted("A", "doublet")["physical"][name]
        axes.axhspan(min(level), max(level), color="#009e73", alpha=0.25, lw=0)
        axes.plot(np.full(3, -1.0), level, "D", color="#009e73", ms=5, mec="white", mew=0.6)
        axes.axhline(table, color="#8a92a0", lw=1, ls=(0, (4, 3)))
        shown = [*level, table]
        for i, method in enumerate(METHODS):
            value, error = found[method][name]
            colour = "#d55e00" if method == "physical" else "#0072b2" if method.startswith("split") else "#4a5160"
            axes.errorbar(i, value, yerr=2 * error, fmt="none", ecolor=colour, alpha=0.55, lw=1.5, capsize=3)
            axes.plot(i, value, "o", color=colour, ms=6, mec="white", mew=0.8, zorder=3)
            shown += [value]
            if method == "split+gust":
                shown += [value - 2 * error, value + 2 * error]
        # Bounds of the methods that gusts mislead are wide: they run out of the frame.
        margin = 0.25 * (max(shown) - min(shown))
        axes.set_ylim(min(shown) - margin, max(shown) + margin)
        axes.set_xlim(-1.6, len(METHODS) - 0.4)
        axes.set_xticks(range(-1, len(METHODS)), ["calm", *METHODS], fontsize=8, rotation=50, ha="right")
        axes.set_title(name, fontsize=11, loc="left")
        axes.tick_params(labelsize=8, length=2)
        axes.grid(axis="y", color="#eceef2")
        axes.set_axisbelow(True)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    figure.suptitle(
        "One flight in light turbulence (σ 5 ft/s, elevator doublet) by every method, ± 2 standard errors.\n"
        "Green: the same doublet in calm air, three flights. Dashed: the profile's table, which physical is after.",
        fontsize=10,
        x=0.01,
        ha="left",
    )
    FigureCanvasAgg(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--seeds", type=int, default=8)
    options.add_argument("--workers", type=int, default=2)
    options.add_argument("--rows", type=Path, help="every flight's estimates, one JSON line each; added to")
    options.add_argument("--also", nargs="*", default=[], help="more methods: oe fe")
    options.add_argument("--picture", type=Path, help="draw one flight instead")
    options.add_argument("--only", nargs="*", default=[], help="aircraft: A B")
    asked = options.parse_args()
    if asked.picture:
        picture(asked.picture)
        return
    jobs = list(itertools.product(asked.only or AIRCRAFT, SIGMAS, INPUTS, range(1, asked.seeds + 1)))
    done: list[dict[str, Any]] = []
    if asked.rows and asked.rows.exists():
        done = [json.loads(line) for line in asked.rows.read_text().splitlines()]
    known = {(r["aircraft"], r["sigma"], r["input"], r["seed"]) for r in done}
    left = [job for job in jobs if job not in known]
    with ProcessPoolExecutor(asked.workers) as pool:
        for row in pool.map(partial(one, methods=(*METHODS, *asked.also)), left):
            done.append(row)
            if asked.rows:
                with asked.rows.open("a") as file:
                    file.write(json.dumps(row) + "\n")
    print_table(done)


if __name__ == "__main__":
    main()
