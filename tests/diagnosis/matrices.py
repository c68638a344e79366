"""The blind matrices: which cases are flown, and how their scores are told."""

from __future__ import annotations

import math
import os
import secrets
from collections import Counter, defaultdict
from collections.abc import Sequence

import numpy as np
from blind import DETECTABLE, KINDS, SIGMAS, Case, covered, draw, planted, score, size

from station.diagnosis.procedure import Diagnosis

SEED = int(os.environ.get("BLIND_SEED", secrets.randbelow(1 << 24))) * 1000
"""Of the slow matrices: fresh each time, printed with the result; BLIND_SEED repeats one."""

OUTSIDE = (
    {"periodic": 0.002}, {"periodic": 0.004}, {"g_sensitivity": 0.006}, {"g_sensitivity": -0.008},
    {"Cm_alpha3": 60.0}, {"Cm_alpha3": -60.0}, {"az_tone": 0.01}, {"vane_quadratic": 4.0}, {"q_quadratic": -0.6},
    {"velocity_filter": 0.5},
)  # fmt: skip
"""Effects that the catalogue does not have: a periodic moment (Cm at 0.8 Hz), g-sensitivity of the gyro (rad/s per g),
a cubic moment, a tone of 1.3 Hz in az (g), a vane whose error goes with alpha2 (per rad), a gyro whose error goes with
q |q| (s/rad), velocities through a second-order filter (s)."""


def pair(i: int) -> tuple[str, str]:
    """Two manoeuvre kinds in turn."""
    return KINDS[i % 3], KINDS[(i + 1) % 3]


def clean(count: int, noise: float = 1.0, derivative_sd: float = 0.0) -> list[Case]:
    return [
        Case(seed=SEED + i, sigma=SIGMAS[i % 3], fit_on=pair(i // 3), thrust=i % 2 == 0, noise=noise,
             derivative_sd=derivative_sd)
        for i in range(count)
    ]  # fmt: skip


def singles(each: int, times: float, noise: float = 1.0) -> list[Case]:
    """Every effect so many times, over the airs, signs and manoeuvres in turn."""
    cases = []
    for j, name in enumerate(DETECTABLE):
        for k in range(each):
            sigma = SIGMAS[k % 3]
            if math.isfinite(size(name, sigma)):
                value = planted(name, times, sigma, 1 if (k // 3 + k) % 2 else -1)
                cases.append(
                    Case(seed=SEED + 100_000 + 100 * j + k, sigma=sigma, effects={name: value}, fit_on=pair(j + k // 3),
                         noise=noise)
                )  # fmt: skip
    return cases


def pairs(count: int, times: float = 2.0) -> list[Case]:
    return [
        Case(seed=s, sigma=SIGMAS[i % 3], fit_on=pair(i // 3), effects=draw(s, 2, times, SIGMAS[i % 3]))
        for i, s in enumerate(range(SEED + 200_000, SEED + 200_000 + count))
    ]


def large(count: int) -> list[Case]:
    """One effect at ten times its size, of those for which that is physical; with that much alpha2 nothing trims."""
    airs = (SIGMAS[0], SIGMAS[2])
    whole = {n for n in DETECTABLE if all(abs(planted(n, 10, s, -1)) >= 9.9 * size(n, s) for s in airs)}
    names = [n for n in DETECTABLE if n in whole and n != "aero.alpha_squared"]
    return [
        Case(seed=s, sigma=airs[i % 2], fit_on=pair(i // 2), effects=draw(s, 1, 10.0, airs[i % 2], names))
        for i, s in enumerate(range(SEED + 300_000, SEED + 300_000 + count))
    ]


def outside(count: int) -> list[Case]:
    n = len(OUTSIDE)
    return [
        Case(seed=SEED + 400_000 + i, sigma=SIGMAS[(i // n + i) % 3], fit_on=pair(i), outside=OUTSIDE[i % n])
        for i in range(count)
    ]


def held_out(count: int) -> list[Case]:
    """One effect, one manoeuvre held out and one more flown for the scorer alone."""
    cases = []
    for i, s in enumerate(range(SEED + 500_000, SEED + 500_000 + count)):
        sigma = SIGMAS[i % 3]
        kept = KINDS[(i // 3 + 2) % 3]
        cases.append(
            Case(seed=s, sigma=sigma, fit_on=pair(i // 3), hold_out=(kept, kept), effects=draw(s, 1, 2.5, sigma))
        )
    return cases


def confusion(found: Sequence[tuple[Case, Diagnosis]]) -> str:
    """One line an effect: how often it was named alone, in a group or otherwise, and as what; and how often its
    interval held the planted value."""
    rows: dict[str, list[str]] = defaultdict(list)
    held: dict[str, list[bool]] = defaultdict(list)
    for case, d in found:
        key = " + ".join(case.effects) or " ".join(f"{n} {v:g}" for n, v in case.outside.items()) or "nothing"
        reported = score(case, d)
        if reported not in ("exact", "clean", "unexplained"):
            reported += " {" + ", ".join(" = ".join((e.term.id, *e.alternatives)) for e in d.effects) + "}"
        rows[key].append(reported)
        for name, inside, _ in covered(case, d):
            held[name].append(inside)
    lines = []
    for key, row in rows.items():
        cover = f"  covered {sum(held[key])} of {len(held[key])}" if held.get(key) else ""
        lines.append(f"{key:40s} {', '.join(f'{n} {c}' for n, c in Counter(row).most_common())}{cover}")
    everything = [inside for hits in held.values() for inside in hits]
    total = Counter(score(c, d) for c, d in found)
    lines.append(f"seed {SEED // 1000}: " + ", ".join(f"{n} {c}" for n, c in total.most_common()))
    if everything:
        lines.append(f"intervals hold {sum(everything)} of {len(everything)} ({np.mean(everything):.3f})")
    return "\n".join(lines)
