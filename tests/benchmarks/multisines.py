"""Multisines on three surfaces: how orthogonal, how peaked, and are two axes from one manoeuvre as good as from two?

    uv run python tests/benchmarks/multisines.py [--flights 6]

The card `multisine`'s inputs over one period at 50 Hz. Then flights of the profile's own aircraft, known exactly, in
its air: with all three surfaces at once, with the elevator alone and with aileron and rudder alone, each of 60 s of
input and of the same amplitudes, so that those apart take twice the time.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence

import numpy as np

from station.conventions import LATERAL, LONGITUDINAL
from station.identification.analysis import identify
from station.identification.request import Request
from station.log import Table
from station.profile import Card, Manoeuvre, load_aircraft, load_card
from station.simulation.manoeuvres import surface_input
from station.simulation.sensors import STANDARD
from station.simulation.sortie import fly

SURFACES = ("elevator", "aileron", "rudder")
METHODS = {"longitudinal": "physical", "lateral": "split+gust"}
EXACT = {"mass": 0.0, "recorded_mass": 0.0, "inertia": 0.0, "surface_scale": 0.0}
START, END, PERIOD = 30.0, 90.0, 20.0
Found = dict[str, tuple[float, float]]
"""Of each derivative estimated: its error and its standard error, over its value."""


def estimates(card: Card, inputs: Sequence[Manoeuvre], wanted: dict[str, str], seed: int) -> Found:
    """Of one flight with these inputs; `wanted`: method by derivative."""
    exact = load_aircraft("twin_otter")
    aircraft = exact.model_copy(update={"uncertainty": exact.uncertainty.model_copy(update=EXACT)})
    flown = card.model_copy(update={"manoeuvres": tuple(inputs), "lateral": True})
    shown, truth = fly(aircraft, STANDARD, flown, END, seed)
    table = Table(truth["time"], {**shown, "thrust": truth["thrust"]}, aircraft, 0)
    result = identify(table, aircraft, Request(tuple(dict.fromkeys(wanted.values())), START, card=flown))
    made: Found = {}
    for name, method in wanted.items():
        p = result.methods[method].parameter(name)
        if p is not None and p.status == "estimated":
            value = aircraft.value(name)
            made[name] = p.value / value - 1.0, p.sd / abs(value)
    return made


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--flights", type=int, default=6)
    count = options.parse_args().flights
    card = load_card("multisine").card
    t = START + np.arange(round(PERIOD * 50)) / 50
    drawn = np.array([surface_input(card.manoeuvres, t, s) for s in SURFACES])
    apart = np.abs(np.corrcoef(drawn) - np.eye(len(SURFACES))).max()
    peaks = np.ptp(drawn, axis=1) / (2 * math.sqrt(2) * drawn.std(axis=1))
    long = dict.fromkeys(LONGITUDINAL, METHODS["longitudinal"])
    side = dict.fromkeys(LATERAL, METHODS["lateral"])
    elevator = [m for m in card.manoeuvres if m.surface == "elevator"]
    others = [m for m in card.manoeuvres if m.surface != "elevator"]
    together, alone = [], []
    for seed in range(1, count + 1):
        together.append(estimates(card, card.manoeuvres, long | side, seed))
        alone.append(estimates(card, elevator, long, seed) | estimates(card, others, side, seed))
    print(
        "| derivative | one manoeuvre: rms error, % | its standard error | two: rms error, % | their standard error |"
    )
    print("|---|---|---|---|---|")
    for name in (*LONGITUDINAL, *LATERAL):
        cells = [cell for flights in (together, alone) for cell in sizes([f[name] for f in flights if name in f])]
        print(f"| {name} | {' | '.join(cells)} |")
    print(f"\nLargest correlation of two surfaces over the period: {apart:.1e}; relative peak factors: "
          f"{', '.join(f'{s} {p:.3f}' for s, p in zip(SURFACES, peaks, strict=True))}. {count} flights.")  # fmt: skip
    ratios = [
        np.sqrt(np.mean([f[n][1] ** 2 for f in together if n in f]) / np.mean([f[n][1] ** 2 for f in alone if n in f]))
        for n in (*LONGITUDINAL, *LATERAL)
        if any(n in f for f in together) and any(n in f for f in alone)
    ]
    print(f"Standard errors of one manoeuvre over those of two: {np.median(ratios):.2f} in the median, "
          f"{min(ratios):.2f} to {max(ratios):.2f}.")  # fmt: skip


def sizes(found: Sequence[tuple[float, float]]) -> tuple[str, str]:
    """Root mean squares of errors and standard errors, %."""
    if not found:
        return "–", "–"
    error, sd = (100 * math.sqrt(float(np.mean(np.square(x)))) for x in zip(*found, strict=True))
    return f"{error:.1f}", f"{sd:.1f}"


if __name__ == "__main__":
    main()
