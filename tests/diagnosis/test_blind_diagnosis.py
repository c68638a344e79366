"""Hidden effects must be found, named and valued; nothing must be found where nothing is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from blind import SIGMAS, Case, aircraft, covered, diagnosed, prepared, score, size
from matrices import clean, confusion, held_out, large, outside, pairs, singles

from station.diagnosis import judge
from station.diagnosis.detectable import detectable_sizes
from station.diagnosis.fit import Problem
from station.diagnosis.procedure import diagnosis_of


def reported(cases: Sequence[Case]) -> list[str]:
    """Scores, printed by case."""
    found = [(c, diagnosed(c)) for c in cases]
    print(confusion(found))
    return [score(c, d) for c, d in found]


@pytest.mark.parametrize("sigma", [SIGMAS[0], SIGMAS[2]])
def test_a_clean_flight_shows_nothing(sigma):
    assert diagnosed(Case(seed=811, sigma=sigma)).verdict == "no_effect"


@pytest.mark.parametrize(
    ("seed", "sigma", "name", "sign"),
    [
        (901, SIGMAS[0], "alpha_vane.delay", 1),
        (902, SIGMAS[1], "accelerometer.position", -1),
        (903, SIGMAS[2], "q.scale", 1),
        (905, SIGMAS[1], "elevator.backlash", 1),
        (906, SIGMAS[0], "dynamic_pressure.lag", 1),
    ],
)
def test_a_single_effect_is_named_and_its_interval_holds_it(seed, sigma, name, sign):
    case = Case(seed=seed, sigma=sigma, effects={name: sign * 2.5 * size(name, sigma)})
    d = diagnosed(case)
    assert score(case, d) in ("exact", "group"), [(e.term.id, e.value, e.alternatives) for e in d.effects]
    for _, inside, z in covered(case, d):
        assert inside or abs(z) < 3


def test_two_effects_at_once_are_both_named():
    case = Case(seed=921, sigma=SIGMAS[1], effects={"alpha_vane.scale": 0.06, "accelerometer.delay": 0.008})
    assert score(case, diagnosed(case)) in ("exact", "group")


@pytest.mark.parametrize("outside", [{"g_sensitivity": 0.008}])
def test_what_the_catalogue_does_not_have_is_unexplained(outside):
    d = diagnosed(Case(seed=931, sigma=SIGMAS[0], outside=outside))
    assert d.verdict == "unexplained"
    assert set(d.remaining.signals) & {"q", "theta", "elevator"}


@pytest.mark.parametrize("factor", [1.5])
def test_noise_other_than_stated_changes_no_verdict(factor):
    assert diagnosed(Case(seed=941, sigma=SIGMAS[1], noise=factor)).verdict == "no_effect"


def test_gain_is_measured_on_a_manoeuvre_not_fitted():
    case = Case(seed=951, sigma=SIGMAS[0], effects={"alpha_vane.delay": 0.03}, hold_out=("multisine",))
    d = diagnosed(case)
    assert d.gain is not None
    assert d.gain.after < d.gain.before
    assert d.gain.low > 0


def test_detectable_sizes_are_those_that_are_found():
    references, _ = prepared(Case(seed=961, sigma=SIGMAS[0]))
    found = {d.id: d for d in detectable_sizes(Problem(references, aircraft()), (0.0, 0.0))}
    for name in ("alpha_vane.delay", "q.scale", "accelerometer.position", "mass.scale"):
        assert found[name].found == pytest.approx(size(name, 0.0), rel=0.5)
        assert found[name].named >= found[name].found


@pytest.mark.slow
def test_matrix_of_clean_flights():
    assert reported(clean(200)).count("clean") >= 0.99 * 200


@pytest.mark.slow
def test_matrix_of_single_effects_at_twice_their_detectable_size():
    found = [(c, diagnosed(c)) for c in singles(9, 2.0)]
    print(confusion(found))
    scores = [score(c, d) for c, d in found]
    assert scores.count("exact") >= 0.94 * len(scores)
    assert scores.count("exact") + scores.count("group") + scores.count("suspect") >= 0.97 * len(scores)
    inside = [hit for c, d in found for _, hit, _ in covered(c, d)]
    assert 0.90 <= np.mean(inside) <= 0.98


@pytest.mark.slow
def test_matrix_of_single_effects_at_half_their_detectable_size():
    # Most are too small to be found: what is named nevertheless must be true.
    scores = reported(singles(3, 0.5))
    assert scores.count("wrong") + scores.count("companion") + scores.count("left over") <= 0.03 * len(scores)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [1.5, 0.7])
def test_matrix_with_noise_other_than_stated(noise):
    assert reported(clean(30, noise)).count("clean") >= 29
    scores = reported(singles(1, 2.5, noise))
    assert scores.count("exact") + scores.count("group") >= 0.94 * len(scores)


@pytest.mark.slow
def test_matrix_of_pairs():
    scores = reported(pairs(60))
    assert scores.count("exact") + scores.count("group") >= 0.92 * len(scores)


@pytest.mark.slow
def test_matrix_outside_the_catalogue():
    scores = reported(outside(80))
    assert scores.count("unexplained") >= 0.95 * len(scores)


@pytest.mark.slow
def test_matrix_of_large_effects():
    scores = reported(large(60))
    assert scores.count("companion") <= 0.03 * len(scores)


@pytest.mark.slow
def test_gain_is_that_of_a_third_flight():
    hits = []
    for case in held_out(45):
        fit, (kept, fresh) = prepared(case)
        d = diagnosis_of(fit, [kept], aircraft())
        if d.gain is not None:
            again = judge.gain(d.before, d.after, [fresh])
            hits.append(d.gain.low <= again.reduction <= d.gain.high)
    print(f"{sum(hits)} of {len(hits)} gains within their interval")
    assert len(hits) >= 40
    assert np.mean(hits) >= 0.93
