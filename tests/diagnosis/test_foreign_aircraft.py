"""Aircraft much slower and much faster than the one that the engine was made on."""

from __future__ import annotations

import math

import pytest
from blind import KINDS, NOISE, Case, aircraft, diagnosed, fly_case, score
from foreign import SCENES, flying

from station.diagnosis import null_fit
from station.diagnosis.detectable import detectable_sizes
from station.diagnosis.likelihood import Problem
from station.diagnosis.manoeuvre import manoeuvre


def test_the_samples_of_a_slow_aircraft_show_its_sensors_noise():
    # At 25 m/s the vertical speed's noise alone turns the flow by more than the vane's own.
    scene = SCENES["aerosonde"]
    with flying(scene):
        made = manoeuvre(fly_case(Case(seed=1000), "multisine", 0), scene.aircraft)
    for name in ("alpha_vane", "az", "theta"):
        # Three quarters of the variance are white in these flights.
        assert made.noise(name) / made.thinner == pytest.approx(math.sqrt(0.75) * NOISE[name], rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "sigma", "name", "value"),
    [
        (1115, 0.0, "boom.flexure", -0.00154),  # a vane's scale and a boom that swings were likelier by 30
        (1108, 5.56, "aero.speed_terms", 0.367),  # gusts of 0.6 Hz are 340 m long: a lag of the air data beside it
        (1121, 0.0, "elevator.lag", -0.0077),
    ],
)
def test_a_fast_aircraft_s_effect_is_named_alone(seed: int, sigma: float, name: str, value: float) -> None:
    with flying(SCENES["learjet"]):
        case = Case(seed=seed, sigma=sigma, effects={name: value}, fit_on=KINDS)
        assert score(case, diagnosed(case)) in ("exact", "group")


@pytest.mark.slow
def test_an_effect_that_does_not_show_has_no_size():
    plain = aircraft()
    plain = plain.model_copy(update={"boom": plain.boom.model_copy(update={"upwash_wing": 0.0})})
    problem = Problem([manoeuvre(fly_case(Case(seed=12), "doublets", 0), plain)], plain)
    found = {d.id for d in detectable_sizes(problem, null_fit.null(problem))}
    assert "alpha_vane.position" in found
    assert "alpha_vane.upwash_memory" not in found
