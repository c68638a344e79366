"""Chapter VI of Martos 2013: what a vane on a wing's tip, two vanes, a swept wing and stronger gusts with stall do to
the methods. Run by hand; prints, asserts nothing.

    uv run python tests/benchmarks/vanes_table.py [--flights 6] [--workers 2] [--rows PATH] [--only NAME ...]

The Twin Otter of the profile in air that varies across the span, 90 s, elevator multisine of 2 deg in the last 60 s,
noise of a good installation. Each cell is, of CL_alpha, Cm_alpha, Cm_q and Cm_de, the mean size of the bias and the
mean scatter, in per cent, and of all six derivatives how many 95 % intervals of those called estimated hold the truth:
for `physical` the profile's, for all others what split gives of three calm flights of the same aircraft with the vane
on the nose.

The tip's vane is a chord ahead of the quarter chord; its upwash, and that of the rolling wing, are a horseshoe
lattice's of a straight wing of that aspect ratio (0.149 and 0.069; on the nose it has 0.091, the profile 0.107). The
wing that bends rises by 0.1 m at the tip for each g beyond its own weight, at 4 Hz: an estimate for a strutted wing.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from station.conventions import G0, LONGITUDINAL
from station.identification.analysis import identify
from station.identification.request import Request
from station.log import Table
from station.profile import Aircraft, Card, Flight, Multisine, SecondVane, load_aircraft
from station.profile.outline import Planform
from station.simulation.sensors import STANDARD, Channel
from station.simulation.sortie import fly

METHODS: Final = ("I", "II", "III", "V", "split", "split+gust", "physical", "VI", "oe", "fe", "sidpac")
COUNTED: Final = ("CL_alpha", "Cm_alpha", "Cm_q", "Cm_de")
START, END = 30.0, 90.0
NOSE: Final = load_aircraft("twin_otter")
CALM: Final = (101, 102, 103)
"""Seeds of the flights that give what the quasi-steady methods should."""
SECOND: Final = "alpha_second"


def boom(aircraft: Aircraft, **keys: float | None) -> Aircraft:
    assert aircraft.boom is not None
    return aircraft.model_copy(update={"boom": aircraft.boom.model_copy(update=keys)})


HALF: Final = NOSE.geometry.span / 2
AT_TIP: Final = {"vane_x": 2.0, "vane_y": HALF, "upwash_body": 0.0, "upwash_wing": 0.149, "upwash_roll": 0.069}
ARM: Final = 0.7 * HALF
"""From the wing's root to the tip, over the slope there: between a beam with even (0.73) and with tapering load."""
BENDS: Final = {"flexure": -0.1 / G0 / ARM, "mode_frequency": 4.0, "mode_length": ARM, "mode_turn": 0.0}


def tip(**more: float) -> Aircraft:
    return boom(NOSE, **AT_TIP, **more)


def second(aircraft: Aircraft, averaged: bool = True, **keys: float) -> Aircraft:
    """A further vane like the first but for `keys`."""
    assert aircraft.boom is not None
    own = SecondVane.model_construct(**{**dict(aircraft.boom), **keys, "averaged": averaged})
    return aircraft.model_copy(update={"second_vane": own})


def swept(aircraft: Aircraft, degrees: float) -> Aircraft:
    return aircraft.model_copy(update={"planform": Planform.model_validate({"sweep": f"{degrees} deg"})})


def stalling(aircraft: Aircraft) -> Aircraft:
    """Flow that leaves the wing about 12 deg, 7 deg above trim's: the Twin Otter's at flaps up, by Goman's law."""
    leaving = {"alpha_star": math.radians(12.0), "CD_X": 0.05, "Cm_X": -0.05}
    return aircraft.model_copy(update={"separation": aircraft.separation.model_copy(update=leaving)})


@dataclass(frozen=True, slots=True)
class Row:
    """An installation: what is flown, and what the estimators know."""

    words: str
    sigma: float
    flown: Aircraft
    known: Aircraft
    calm: Callable[[], Aircraft] = lambda: NOSE


def row(words: str, flown: Aircraft, sigma: float = 5.0, known: Aircraft | None = None, calm: Aircraft = NOSE) -> Row:
    return Row(words, sigma, flown, known or flown, lambda: calm)


BOTH: Final = second(tip(**BENDS), vane_y=-HALF)
ROWS: Final = {
    "nose": row("nose", NOSE),
    "tip": row("wing tip", tip()),
    "bends": row("wing tip that bends", tip(**BENDS)),
    "stiff": row("wing tip that bends, taken for stiff", tip(**BENDS), known=tip()),
    "mean": row("mean of both tips, bending", BOTH),
    "mixed": row("mean of nose and tip", second(NOSE, **AT_TIP)),
    "swept": row("nose, wing swept 30 deg", swept(NOSE, 30.0)),
    "ten": row("nose", NOSE, 10.0),
    "stall": row("nose, flow leaves the wing", stalling(NOSE), 10.0, NOSE, stalling(NOSE)),
    "stall15": row("nose, flow leaves the wing", stalling(NOSE), 15.0, NOSE, stalling(NOSE)),
}
Values = dict[str, dict[str, tuple[float, float, str]]]
"""By method and derivative: estimate, half of the 95 % interval, status."""


def flown(name: str, seed: int, calm: bool = False) -> Values:
    """What identify makes of one flight."""
    row = ROWS[name]
    aircraft = row.calm() if calm else row.flown
    known = NOSE if calm else row.known
    shape = {"kind": "multisine", "start": f"{START} s", "duration": "20 s", "repeat": "20 s", "amplitude": "2 deg"}
    gusts = {"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": f"{0 if calm else row.sigma} ft/s"}
    flight = Flight.model_validate({**gusts, "field": "plane"})
    card = Card(name="t", aircraft="t", rig="", flight=flight, manoeuvres=(Multisine.model_validate(shape),))
    shown, truth = fly(aircraft, STANDARD, card, END, seed)
    vanes = {}
    if aircraft.second_vane is not None:
        at = aircraft.second_vane
        vanes = {SECOND: (at.vane_x, at.vane_y, at.vane_z)}
        shown[SECOND] = Channel(SECOND, STANDARD["alpha_vane"], 0.02, 1, seed).measure(truth["alpha_vane_2"])
    for signal in ("thrust", "mass", "pdot", "qdot", "rdot"):
        shown.pop(signal, None)
    table = Table(truth["time"], shown, known, 0)
    found = identify(table, known, Request(("split",) if calm else METHODS, START, card=card, force=True, vanes=vanes))
    return {
        m: {p.name: (p.value, 1.96 * p.sd, p.status.name.lower()) for p in r.parameters if p.name in LONGITUDINAL}
        for m, r in found.methods.items()
    }


def one(job: tuple[str, int, bool]) -> dict[str, Any]:
    return {"row": job[0], "seed": job[1], "calm": job[2], "methods": flown(*job)}


def cell(made: list[Values], wanted: dict[str, float], method: str) -> str:
    """Bias, scatter and how many intervals hold."""
    by_name = {n: [v[method][n] for v in made if n in v.get(method, {})] for n in LONGITUDINAL}
    shares = [[x / wanted[n] - 1 for x, _, _ in by_name[n] if math.isfinite(x)] for n in COUNTED if by_name.get(n)]
    shares = [s for s in shares if s]
    if not shares:
        return "–"
    bias = 100 * np.mean([abs(np.mean(s)) for s in shares])
    scatter = 100 * np.mean([np.std(s) for s in shares])
    held = [
        abs(x - wanted[n]) <= half for n, got in by_name.items() for x, half, status in got if status == "estimated"
    ]
    return f"{bias:.0f} ± {scatter:.0f}, {sum(held)}/{len(held)}"


def print_table(done: list[dict[str, Any]]) -> None:
    print(f"| vane | σ, ft/s | flights | {' | '.join(METHODS)} |")
    print("|---" * (len(METHODS) + 3) + "|")
    for name, row in ROWS.items():
        made = [d["methods"] for d in done if d["row"] == name and not d["calm"]]
        stall = name.startswith("stall")
        calm = [d["methods"]["split"] for d in done if d["calm"] and d["row"] == ("stall" if stall else "nose")]
        if not made or not calm:
            continue
        quasi = {n: float(np.mean([c[n][0] for c in calm])) for n in LONGITUDINAL}
        table = {n: NOSE.value(n) for n in LONGITUDINAL}
        cells = [cell(made, table if m == "physical" else quasi, m) for m in METHODS]
        print(f"| {row.words} | {row.sigma:g} | {len(made)} | {' | '.join(cells)} |")


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--flights", type=int, default=6)
    options.add_argument("--workers", type=int, default=2)
    options.add_argument("--rows", type=Path, help="every flight's estimates, one JSON line each; added to")
    options.add_argument("--only", nargs="*", default=[], choices=list(ROWS), help="these rows")
    asked = options.parse_args()
    jobs = [(name, seed, True) for name in ("nose", "stall") for seed in CALM]
    jobs += [(name, seed, False) for seed in range(1, asked.flights + 1) for name in asked.only or ROWS]
    done: list[dict[str, Any]] = []
    if asked.rows and asked.rows.exists():
        done = [json.loads(line) for line in asked.rows.read_text().splitlines()]
    known = {(d["row"], d["seed"], d["calm"]) for d in done}
    with ProcessPoolExecutor(asked.workers) as pool:
        for made in pool.map(one, [job for job in jobs if job not in known]):
            done.append(made)
            if asked.rows:
                with asked.rows.open("a") as file:
                    file.write(json.dumps(made) + "\n")
    print_table(done)


if __name__ == "__main__":
    main()
