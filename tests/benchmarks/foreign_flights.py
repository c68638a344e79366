"""Identification counted on the foreign flights: aircraft that differ from their profile as real ones do.

    uv run python tests/benchmarks/foreign_flights.py [--folder DIR] [--workers 2] [--second 60 --seed 1]

The flights and their answers (tests/records.toml) come from a simulation that shares no formula with the station, as do
those of tests/second_simulation, which has other noise, rates, spans, trims and air, and lateral flights too. Each
is imported as a user would import it, identified against the shipped profile, and the estimates are held against the
aircraft's own derivatives and the quasi-steady ones, each method's by the numbers that it gives for that definition.
Printed: mean error, share of 95 % intervals that hold the truth, share called estimated; for calm to light air (to 5
ft/s) and above apart; and the mean error below which none can go, what mass and inertia differ from the profile's.
"""

from __future__ import annotations

import argparse
import gzip
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from station.conventions import LATERAL
from station.profile import load_aircraft
from tests.records import record
from tests.second_simulation.flights import identify_case, write

DERIVATIVES = ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")
METHODS = ("recommended", "physical", "split+gust", "split")
OF_LATERAL = ("ml", "split+gust", "split", "II", "sidpac")
LIGHT_FPS = 5.0
SLUG, SLUG_FT2 = 14.5939, 1.35582
"""In kg and kg m2."""


@dataclass(frozen=True, slots=True)
class Flight:
    """A flight's answers, and what identify made of it (station.identify/1)."""

    name: str
    answers: dict
    result: dict


def identified(name: str, flights: Path, folder: Path, answers: dict) -> Flight:
    """Import and identify one flight with the command line."""
    table, log, out = (folder / f"{name}{suffix}" for suffix in (".csv", ".mcap", ".json"))
    table.write_bytes(gzip.decompress((flights / f"{name}.csv.gz").read_bytes()))
    station = [sys.executable, "-m", "station"]
    subprocess.run([*station, "import", table, "-o", log, "--aircraft", "twin_otter"], check=True, capture_output=True)
    begin = str(answers["manoeuvre_from_s"])
    subprocess.run([*station, "identify", log, "--from", begin, "--json", out], check=False, capture_output=True)
    refused = {"recommended": None, "methods": {}}
    return Flight(name, answers, json.loads(out.read_text()) if out.exists() else refused)


def row(flights: list[Flight], method: str, definition: str, derivatives: Sequence[str] = DERIVATIVES) -> str:
    """Mean error, intervals that hold, estimates called so, of each derivative."""
    cells = []
    for name in derivatives:
        errors, holds, estimated = [], 0, 0
        for flight in flights:
            chosen = flight.result["recommended"] if method == "recommended" else method
            made = flight.result["methods"].get(chosen, {}) if chosen else {}
            is_own = name in LATERAL or made.get("definition", definition) == definition
            p = made.get("parameters" if is_own else "quasi_steady", {}).get(name)
            if not is_own and definition == "derivatives":
                continue  # quasi-steady methods have no others
            if p is None or p["status"] != "estimated":
                continue
            truth = flight.answers[definition][name]
            estimated += 1
            errors.append(abs(p["estimate"] / truth - 1.0))
            holds += p["ci95"][0] <= truth <= p["ci95"][1]
        count = max(estimated, 1)
        cells.append(
            f"{100 * sum(errors) / count:5.1f} {100 * holds / count:4.0f} {100 * estimated / len(flights):4.0f}"
        )
    return " | ".join((f"{method:12s}", *cells))


def floor(flights: list[Flight]) -> str:
    """Mean error by mass and inertia alone; "" where the answers do not say them."""
    inertia = load_aircraft("twin_otter").inertia
    known = {"MASS": inertia.mass / SLUG, "IYY": (inertia.iyy or 0.0) / SLUG_FT2}
    if any(n not in f.answers.get("constants", {}) for f in flights for n in known):
        return ""
    lift, moment = (
        100 * sum(abs(f.answers["constants"][n] / value - 1) for f in flights) / len(flights)
        for n, value in known.items()
    )
    return f", at least {lift:.1f} % in CL by the mass, {moment:.1f} % in Cm by the inertia"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, help="where recordings and results are kept")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--second", type=int, default=0, help="so many flights of tests/second_simulation instead")
    parser.add_argument("--seed", type=int, default=1, help="of the second simulation")
    given = parser.parse_args()
    folder = given.folder or Path(tempfile.mkdtemp(prefix="foreign-flights-"))
    if given.second:
        flights = folder / f"flights_{given.seed}"
        sideways = range(given.second // 4)
        write([identify_case(given.seed, i) for i in range(given.second)], flights)
        write([identify_case(given.seed, i, lateral=True) for i in sideways], flights)
    else:
        flights = record("flights/answers.json").parent
    answers = json.loads((flights / "answers.json").read_text())
    folder.mkdir(parents=True, exist_ok=True)
    names = sorted(n for n in answers if n.startswith(("identify_", "lateral_")))
    with ThreadPoolExecutor(given.workers) as pool:
        done = list(pool.map(lambda n: identified(n, flights, folder, answers[n]), names))
    sideways = [f for f in done if f.name.startswith("lateral_")]
    done = [f for f in done if f.name.startswith("identify_")]
    light = [f for f in done if f.answers["sigma_fps"] <= LIGHT_FPS]
    rough = [f for f in done if f.answers["sigma_fps"] > LIGHT_FPS]
    print("of each: mean error of estimates %, 95 % intervals that hold the truth %, called estimated %")
    for definition in ("derivatives", "quasi_steady"):
        for words, chosen in ((f"to {LIGHT_FPS:g} ft/s", light), (f"above {LIGHT_FPS:g} ft/s", rough)):
            if not chosen:
                continue
            print(f"\n{definition}, {words}, {len(chosen)} flights{floor(chosen)}")
            print(" | ".join((" " * 12, *(f"{n:15s}" for n in DERIVATIVES))))
            for method in METHODS:
                print(row(chosen, method, definition))
    for words, air in (("calm", [0.0]), ("gusts", None)):
        chosen = [f for f in sideways if (f.answers["sigma_fps"] in air if air else f.answers["sigma_fps"] > 0)]
        for axis in ("CY", "Cl", "Cn") if chosen else ():
            derivatives = [n for n in LATERAL if n.startswith(axis)]
            print(f"\nlateral, {words}, {len(chosen)} flights")
            print(" | ".join((" " * 12, *(f"{n:15s}" for n in derivatives))))
            for method in OF_LATERAL:
                print(row(chosen, method, "derivatives", derivatives))


if __name__ == "__main__":
    main()
