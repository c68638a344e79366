"""What to trust: bias of the recommended estimates and coverage of their intervals; the README's table. Run by hand.

    uv run python tests/benchmarks/trust.py [--workers 2]

Two kinds of flights. The station's own simulation, whose profile is right: both Twin Otters, doublet and multisine, in
calm air and at 5 and 10 ft/s. And the foreign flights (tests/records.toml): a program that shares no formula with the
station, aircraft that differ from their profile as real ones do, half of them under feedback. `ml` and `physical` are
held against the aircraft's own derivatives, every other method against what the manoeuvre gives in calm air with a
perfect angle of attack.
"""

from __future__ import annotations

import argparse
import gzip
import itertools
import json
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from methods_table import AIRCRAFT, INPUTS, flown, wanted

from station.conventions import LONGITUDINAL
from station.convert import import_file
from station.identification.analysis import identify
from station.identification.identification_json import as_json
from station.identification.request import Request
from station.log import table
from station.profile import load_aircraft
from tests.records import record

METHODS = ("ml", "physical", "split+gust", "split")
SEEDS = range(101, 105)
LIGHT_FPS = 5.0


@dataclass(frozen=True, slots=True)
class Flight:
    """Of the recommended method: the estimates called so, with 95 % intervals, and the truth of what it estimates."""

    kind: str
    estimates: dict[str, dict[str, Any]]
    truth: dict[str, float]


def chosen(kind: str, found: dict[str, Any], derivatives: dict[str, float], quasi_steady: dict[str, float]) -> Flight:
    name = found["recommended"]
    given = found["methods"][name]["parameters"] if name else {}
    estimated = {n: p for n, p in given.items() if p["status"] == "estimated"}
    return Flight(kind, estimated, derivatives if name in ("ml", "physical") else quasi_steady)


def own(job: tuple[str, float, str, int]) -> Flight:
    aircraft, sigma, form, _ = job
    target = wanted(aircraft, form)
    air = f"σ {sigma:g} ft/s" if sigma else "calm"
    return chosen(f"own simulation, {air}", flown(*job, METHODS), target["physical"], target["split"])


def foreign(name: str) -> Flight:
    answers = json.loads(record("flights/answers.json").read_text())[name]
    with tempfile.TemporaryDirectory() as folder:
        text, log = Path(folder, "a.csv"), Path(folder, "a.mcap")
        text.write_bytes(gzip.decompress(record(f"flights/{name}.csv.gz").read_bytes()))
        import_file(text, log, load_aircraft("twin_otter"))
        flight = table(log)
    request = Request(methods=METHODS, start_s=answers["manoeuvre_from_s"])
    found = as_json(identify(flight, flight.aircraft, request))
    air = f"to {LIGHT_FPS:g} ft/s" if answers["sigma_fps"] <= LIGHT_FPS else f"above {LIGHT_FPS:g} ft/s"
    return chosen(f"foreign aircraft, {air}", found, answers["derivatives"], answers["quasi_steady"])


def row(kind: str, flights: list[Flight]) -> str:
    cells = [kind, str(len(flights))]
    for name in LONGITUDINAL:
        pairs = [(f.estimates[name], f.truth[name]) for f in flights if name in f.estimates]
        if not pairs:
            cells.append("–")
            continue
        bias = 100 * float(np.median([p["estimate"] / truth - 1 for p, truth in pairs]))
        holds = sum(p["ci95"][0] <= truth <= p["ci95"][1] for p, truth in pairs)
        cells.append(f"{bias:+.1f}, {holds}/{len(pairs)}")
    return f"| {' | '.join(cells)} |"


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--workers", type=int, default=2)
    asked = options.parse_args()
    jobs = list(itertools.product(AIRCRAFT, (0.0, 5.0, 10.0), INPUTS, SEEDS))
    names = [f"identify_{i:02d}" for i in range(48)]
    with ProcessPoolExecutor(asked.workers) as pool:
        flights = [*pool.map(own, jobs), *pool.map(foreign, names)]
    print(f"| flights | | {' | '.join(LONGITUDINAL)} |")
    print("|---" * (len(LONGITUDINAL) + 2) + "|")
    for kind in sorted({f.kind for f in flights}, key=lambda k: ("foreign" in k, "above" in k, "10" in k, "σ" in k)):
        print(row(kind, [f for f in flights if f.kind == kind]))


if __name__ == "__main__":
    main()
