"""Diagnoses counted on flights of two programs that share no formula with the station, each with what was hidden.

    uv run python tests/benchmarks/foreign_diagnoses.py [--only foreign|second] [--count 40] [--seed 1] [--workers 2]

`foreign`: the 20 cases of tests/records.toml. `second`: cases of tests/second_simulation, drawn wider than the station
assumes; every fifth hides nothing, every tenth two or three things. Each is imported and diagnosed with the command
line against the shipped profile, which is not that aircraft's. A name is false where nothing like it is hidden, among
its rivals either, unless it is a true difference from the profile and its interval holds it. Of the second simulation
the derived quantities (short period, phugoid, load factor per angle of attack, elevator per g) are held against how
that aircraft flies when left alone and pulled up, at the speed that the diagnosis states.
"""

from __future__ import annotations

import argparse
import gzip
import json
import math
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from tests.records import record
from tests.second_simulation.aircraft import BOOM_X, DEG, FT, LONGITUDINAL, TAIL_ARM, Drawn, G
from tests.second_simulation.flights import diagnose_cases, write
from tests.second_simulation.hidden import of_motion
from tests.second_simulation.modes import qualities
from tests.second_simulation.motion import Hidden, constants
from tests.second_simulation.scoring import Score, score, table, totals

FACTORS: Final = ("alpha_vane.scale", "q.scale", "mass.scale", "inertia.scale", "dynamic_pressure.scale")
"""That the foreign answers give as a ratio."""
UNJUDGED: Final = ("aero.icing", "cg.shift", "pot_cubic", "slosh", "elevator.delay")
"""Sizes of theirs whose definition is not stated, or not the catalogue's."""
BENT: Final = {"elevator.backlash", "aero.separation", "slosh"}
"""With these no small motion says how the aircraft flies."""
MANOEUVRES: Final = ("a", "b", "h")


def foreign_hidden(answers: dict[str, Any]) -> dict[str, float]:
    """What is hidden in a foreign case, SI."""
    given = dict(answers["hidden"])
    for name in FACTORS:
        if name in given:
            given[name] -= 1.0
    if "boom.flexure" in given:
        given["boom.flexure"] *= DEG / G
    return given


def foreign_deviations(answers: dict[str, Any]) -> dict[str, float]:
    """How the foreign aircraft differs from the profile, by the catalogue's ids."""
    c, d, hidden = answers["constants"], answers["derivatives"], foreign_hidden(answers)
    return {
        "alpha_vane.position": c["r"] * FT - BOOM_X,
        "alpha_vane.dynamics": c["WN"] / 9.0 - 1,
        "alpha_vane.scale": (1 + c["KU0"]) * (1 + hidden.get("alpha_vane.scale", 0.0)) / 1.177 - 1,
        "aero.unsteady_lift": c["mem_a"] - 1,
        "gust.tail_penetration": c["LT"] * FT / TAIL_ARM - 1,
        **{f"aero.{n}": d[n] / v - 1 for n, v in LONGITUDINAL.items()},
    }


def diagnosed(case: str, flights: Path, folder: Path) -> dict[str, Any]:
    """Import and diagnose one case; an empty result where it is refused."""
    station = [sys.executable, "-m", "station"]
    logs = []
    for m in MANOEUVRES:
        name = f"{case}_{m}"
        text, log = folder / f"{name}.csv", folder / f"{name}.mcap"
        if not log.exists():
            text.write_bytes(gzip.decompress((flights / f"{name}.csv.gz").read_bytes()))
            call = [*station, "import", text, "-o", log, "--aircraft", "twin_otter"]
            subprocess.run(call, check=True, capture_output=True)
        logs.append(log)
    out = folder / f"{case}.json"
    out.unlink(missing_ok=True)
    done = subprocess.run(
        [*station, "diagnose", *logs[:2], "--hold-out", logs[2], "--json", out], capture_output=True, text=True
    )
    (folder / f"{case}.txt").write_text(done.stdout + done.stderr)
    return json.loads(out.read_text()) if out.exists() else {}


def counted(flights: Path, folder: Path, foreign: bool, workers: int) -> list[Score]:
    answers = json.loads((flights / "answers.json").read_text())
    cases = sorted({n.rsplit("_", 1)[0] for n in answers if n.startswith("diagnose_")})
    cases = [c for c in cases if all(f"{c}_{m}" in answers for m in MANOEUVRES)]
    folder.mkdir(parents=True, exist_ok=True)
    if workers > 1:
        os.environ.setdefault("LOKY_MAX_CPU_COUNT", "1")  # of each

    def one(case: str) -> Score:
        given = answers[f"{case}_a"]
        hidden = foreign_hidden(given) if foreign else given["hidden"]
        deviations = foreign_deviations(given) if foreign else given["deviations"]
        sigma = given["sigma_fps"]
        air = f"{sigma:.3g} ft/s" if sigma else "calm"
        result = diagnosed(case, flights, folder)
        return score(case.removeprefix("diagnose_"), air, hidden, deviations, UNJUDGED if foreign else (), result)

    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(one, cases))


def derived(answers: dict[str, Any], folder: Path) -> str:
    """Of diagnoses that do not call themselves suspect: how often 95 % intervals of derived quantities hold the true
    one, how wide they are, and how far off their middle is."""
    found: dict[str, list[tuple[bool, float, float]]] = {}
    for page in sorted(folder.glob("diagnose_*.json")):
        told, given = json.loads(page.read_text()).get("derived", {}), answers[f"{page.stem}_a"]
        if told.get("status") != "ok" or told["suspect"] or BENT & given["hidden"].keys():
            continue
        aircraft = replace(Drawn(**given["constants"]), speed=told["condition"]["airspeed_mps"])
        true = qualities(aircraft, of_motion(aircraft, constants(aircraft, Hidden()).alpha, given["hidden"]))
        for name, value in true.items():
            row = told["quantities"][name]
            if row["status"] == "estimated" and math.isfinite(value):
                low, high = row["ci95"]
                found.setdefault(name, []).append(
                    (low <= value <= high, (high - low) / 2 / abs(value), row["estimate"] / value - 1)
                )
    lines = [
        "| derived quantity | flights | intervals that hold | half width | off (mean, rms) |",
        "|---|---|---|---|---|",
    ]
    for name, rows in found.items():
        held, half, off = map(np.array, zip(*rows, strict=True))
        lines.append(
            f"| {name} | {len(rows)} | {held.sum()} | {100 * np.median(half):.1f} % |"
            f" {100 * off.mean():+.1f} %, {100 * np.sqrt((off**2).mean()):.1f} % |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("foreign", "second"))
    parser.add_argument("--count", type=int, default=40, help="cases of the second simulation")
    parser.add_argument("--seed", type=int, default=1, help="of the second simulation")
    parser.add_argument("--folder", type=Path, help="where recordings and results are kept")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    folder = given.folder or Path(tempfile.mkdtemp(prefix="foreign-diagnoses-"))
    pages = {}
    if given.only != "second":
        pages["foreign"] = counted(record("flights/answers.json").parent, folder / "foreign", True, given.workers)
    flights = folder / f"flights_{given.seed}"
    if given.only != "foreign":
        if not (flights / "answers.json").exists():
            write([c for i in range(given.count) for c in diagnose_cases(given.seed, i)], flights)
        pages["second simulation"] = counted(flights, folder / f"second_{given.seed}", False, given.workers)
    for scores in pages.values():
        print(totals(scores), end="\n\n")
        print(table(scores), end="\n\n")
    if "second simulation" in pages:
        answers = json.loads((flights / "answers.json").read_text())
        print(derived(answers, folder / f"second_{given.seed}"))


if __name__ == "__main__":
    main()
