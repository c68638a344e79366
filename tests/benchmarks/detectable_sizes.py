"""How large an effect must be to be found: `uv run python tests/benchmarks/detectable_sizes.py` prints README's table.

One doublet, and a card of three manoeuvres (three doublets, 3-2-1-1 twice, a multisine), of 45 s each, at the bench
rig's noise; from the information of diagnosis's own likelihood, checked by the blind flights.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from station.conventions import from_si, to_si
from station.diagnosis import null_fit
from station.diagnosis.detectable import Detectable, detectable_sizes
from station.diagnosis.effects import EFFECTS
from station.diagnosis.likelihood import Problem
from station.diagnosis.manoeuvre import Manoeuvre, manoeuvre
from station.diagnosis.measured_record import manoeuvres
from station.profile import Doublet, Flight, Multisine, ThreeTwoOneOne, load_aircraft, load_card, load_rig
from station.simulation import fly

SECONDS = 45.0
DEG = math.radians(1)
AIRS = {"calm": 0.0, "3 ft/s": to_si(3, "ft/s")}


def made(shape, **values):
    return shape.model_validate(values, context="si")


def doublet(start: float, amplitude: float, width: float) -> Doublet:
    return made(Doublet, kind="doublet", start=start, amplitude=amplitude * DEG, width=width)


ONE = (doublet(12, 3, 1.0),)
THREE = (
    (doublet(6, 3, 0.6), doublet(18, -3, 1.0), doublet(30, 3, 0.8)),
    tuple(
        made(ThreeTwoOneOne, kind="3-2-1-1", start=s, amplitude=a * DEG, unit=u)
        for s, a, u in ((5.0, 2.5, 0.6), (24.0, -2.5, 0.45))
    ),
    (made(Multisine, kind="multisine", start=4.0, duration=38.0, low=0.1, high=1.9, amplitude=2.5 * DEG),),
)


def flown(inputs, sigma: float, seed: int) -> Manoeuvre:
    """One manoeuvre's record, simulated with the bench rig, and what diagnosis makes of it."""
    aircraft, rig = load_aircraft("twin_otter"), load_rig("bench")
    flight = Flight().model_copy(update={"gust_sigma": sigma, "seed": seed})
    card = load_card("bench").card.model_copy(update={"flight": flight, "manoeuvres": inputs})
    shown, truth = fly(aircraft, rig, card, SECONDS, seed)
    columns = {**shown, "thrust": truth["thrust"]}
    t_s = 0.02 * np.arange(len(shown["q"]))
    record = replace(
        manoeuvres("planned", t_s, columns, aircraft)[0], imu=rig.imu_position, stated=rig.frame_noise_si()
    )
    return manoeuvre(record, aircraft)


def cell(size: Detectable | None, unit: str) -> str:
    """Found, and in brackets the size that also tells it from its nearest rival, where that is larger."""
    if size is None:
        return "–"
    found, named = from_si(size.found, unit), from_si(size.named, unit)
    first, second = f"{float(f'{found:.2g}'):g}", f"{float(f'{named:.2g}'):g}"
    return first if named < 1.05 * found else f"{first} ({second})"


def main() -> None:
    columns: dict[str, dict[str, Detectable]] = {}
    for cards, title in (((ONE,), "one doublet"), (THREE, "three")):
        for air, sigma in AIRS.items():
            made = [flown(inputs, sigma, 40 + k) for k, inputs in enumerate(cards)]
            problem = Problem(made, load_aircraft("twin_otter"))
            sizes = detectable_sizes(problem, null_fit.null(problem))
            columns[f"{title}, {air}"] = {d.id: d for d in sizes}
    print("| effect | unit | " + " | ".join(columns) + " | nearest rival |")
    print("|---" * (3 + len(columns)) + "|")
    for term in EFFECTS:
        if any(term.id in sizes for sizes in columns.values()):
            cells = [cell(sizes.get(term.id), term.shown) for sizes in columns.values()]
            alternative = next((s[term.id].alternative for s in reversed(columns.values()) if term.id in s), "")
            unit = "" if term.shown == "1" else term.shown
            print(f"| {term.id} | {unit} | " + " | ".join(cells) + f" | {alternative} |")


if __name__ == "__main__":
    main()
