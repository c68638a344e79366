"""Aircraft much slower and much faster than the one that the engine was made on."""

from __future__ import annotations

import math
from collections import Counter

import pytest
from blind import KINDS, NOISE, Case, aircraft, diagnosed, fly_case, score
from foreign import SCENES, flying, sizes
from matrices import SEED, confusion

from station.diagnosis.detectable import detectable_sizes
from station.diagnosis.effects import BY_ID
from station.diagnosis.likelihood import Problem
from station.diagnosis.manoeuvre import manoeuvre


def test_the_samples_of_a_slow_aircraft_show_its_sensors_noise():
    # At 25 m/s the vertical speed's noise alone turns the flow by more than the vane's own.
    scene = SCENES["aerosonde"]
    with flying(scene):
        made = manoeuvre(fly_case(Case(seed=1000), "multisine", 0), scene.aircraft)
    for name in ("alpha_vane", "az", "theta"):
        # Three quarters of the variance are white in these flights.
        assert made.noise(name) == pytest.approx(math.sqrt(0.75) * NOISE[name], rel=0.2)


@pytest.mark.slow
def test_an_effect_that_does_not_show_has_no_size():
    plain = aircraft()
    plain = plain.model_copy(update={"boom": plain.boom.model_copy(update={"upwash_wing": 0.0})})
    problem = Problem([manoeuvre(fly_case(Case(seed=12), "doublets", 0), plain)], plain)
    found = {d.id for d in detectable_sizes(problem, problem.null())}
    assert "alpha_vane.position" in found
    assert "alpha_vane.upwash_memory" not in found


def planted(name: str, size: float, sign: int) -> float:
    """An effect of twice a size, within what is physical."""
    term = BY_ID[name]
    x = 2 * size * (1 if term.low == 0 else sign)
    return min(max(x, 0.9 * term.low), 0.9 * term.high)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_matrix_of_a_foreign_aircraft(name):
    scene = SCENES[name]
    with flying(scene):
        clean = [Case(seed=SEED + i, sigma=scene.sigmas[i % 3], fit_on=KINDS) for i in range(9)]
        singles = []
        for i, sigma in enumerate(scene.sigmas):
            found = sizes(scene, sigma)
            for j, (effect, size) in enumerate(sorted(found.items())):
                term = BY_ID[effect]
                physical = math.isfinite(size) and 2 * size < 0.9 * min(-term.low or term.high, term.high)
                if j % 3 == i and physical and effect != "boom.mode":
                    value = planted(effect, size, -1 if j % 2 else 1)
                    singles.append(Case(seed=SEED + 100 + j, sigma=sigma, effects={effect: value}, fit_on=KINDS))
        reported = [(case, diagnosed(case)) for case in (*clean, *singles)]
    print(name)
    print(confusion(reported))
    scores = Counter(score(case, d) for case, d in reported)
    assert scores["clean"] >= len(clean) - 1
    # 91 % of 99 flights were counted; two standard deviations of some thirty below that.
    assert scores["exact"] + scores["group"] >= 0.8 * len(singles)
