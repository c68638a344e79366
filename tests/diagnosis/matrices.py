"""The blind matrices of tests/benchmarks/blind_matrices.py: which cases are flown."""

from __future__ import annotations

import math
from dataclasses import replace

import lateral_blind
import numpy as np
from blind import DETECTABLE, KINDS, SIGMAS, Case, draw, planted, reached, size
from foreign import Scene, flying, sizes

from station.diagnosis.effects import BY_ID

SEED = 1000
"""Of the first case."""

OUTSIDE = (
    {"periodic": 0.002}, {"periodic": 0.004}, {"g_sensitivity": 0.006}, {"g_sensitivity": -0.008},
    {"elevator_uneven": 0.15}, {"elevator_uneven": -0.15}, {"az_tone": 0.01}, {"vane_quadratic": 4.0},
    {"q_quadratic": -0.6}, {"velocity_filter": 0.5}, {"vane_stick": math.radians(0.4)},
)  # fmt: skip
"""Effects that the catalogue does not have: a periodic moment (Cm at 0.8 Hz), g-sensitivity of the gyro (rad/s per g),
an elevator stronger one way than the other (the share), a tone of 1.3 Hz in az (g), a vane whose error goes with alpha2
(per rad), a gyro whose error goes with q |q| (s/rad), velocities through a second-order filter (s), a vane with play
(rad)."""


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
            sigma = SIGMAS[(j + k) % 3]
            if reached(name, times, sigma):
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


PAIRS = tuple(
    (lateral_blind.KINDS[j], lateral_blind.KINDS[(j + 1) % 3], lateral_blind.KINDS[(j + 2) % 3]) for j in range(3)
)
"""Two lateral manoeuvres to fit, one held out, in turn."""


def lateral_case(seed: int, number: int, **given: object) -> lateral_blind.Case:
    one, other, kept = PAIRS[number % 3]
    return replace(lateral_blind.Case(seed=seed, fit_on=(one, other), hold_out=(kept,)), **given)


def lateral_clean(count: int) -> list[lateral_blind.Case]:
    return [lateral_case(SEED + i, i // 3, sigma=lateral_blind.SIGMAS[i % 3]) for i in range(count)]


def lateral_singles(times: float) -> list[lateral_blind.Case]:
    """Every lateral effect in every air."""
    cases = []
    for j, name in enumerate(lateral_blind.DETECTABLE):
        for k, sigma in enumerate(lateral_blind.SIGMAS):
            value = lateral_blind.planted(name, times, sigma, 1 if (j + k) % 2 else -1)
            if np.isfinite(value):
                given = {"sigma": sigma, "effects": {name: value}}
                cases.append(lateral_case(SEED + 100_000 + 10 * j + k, j + k, **given))
    return cases


def scene_clean(scene: Scene) -> list[Case]:
    return [Case(seed=SEED + i, sigma=scene.sigmas[i % 3], fit_on=KINDS) for i in range(6)]


def scene_singles(scene: Scene) -> list[Case]:
    """Each effect in one air, at twice the size that this aircraft's own card detects, within what is physical."""
    cases = []
    for i, sigma in enumerate(scene.sigmas):
        with flying(scene):
            found = sizes(scene, sigma)
        for j, (effect, least) in enumerate(sorted(found.items())):
            term = BY_ID[effect]
            physical = math.isfinite(least) and 2 * least < 0.9 * min(-term.low or term.high, term.high)
            if j % 3 == i and physical and effect != "boom.mode":
                sign = 1 if term.low == 0 or j % 2 == 0 else -1
                value = min(max(2 * sign * least, 0.9 * term.low), 0.9 * term.high)
                cases.append(Case(seed=SEED + 100 + j, sigma=sigma, effects={effect: value}, fit_on=KINDS))
    return cases


ON_JSBSIM = (
    "alpha_vane.delay", "alpha_vane.scale", "alpha_vane.position", "boom.flexure", "accelerometer.position",
    "accelerometer.scale", "accelerometer.delay", "q.delay", "q.scale", "imu.delay", "elevator.lag",
    "elevator.backlash", "velocity.delay",
)  # fmt: skip


def jsbsim_clean(count: int) -> list[Case]:
    return [Case(seed=SEED + i, sigma=SIGMAS[i % 3]) for i in range(count)]


def jsbsim_singles(times: float) -> list[Case]:
    cases = []
    for i, name in enumerate(ON_JSBSIM):
        sigma = SIGMAS[i % 3]
        value = planted(name, times, sigma, (-1) ** (i // 7))
        cases.append(Case(seed=SEED + 70_000 + i, sigma=sigma, effects={name: value}))
    return cases
