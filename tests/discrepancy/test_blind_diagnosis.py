"""Hidden effects must be found, named and valued; nothing must be found where nothing is."""

from __future__ import annotations

import math

import numpy as np
import pytest
from blind import DETECTABLE, KINDS, SIGMAS, Case, aircraft, covered, diagnosed, draw, prepared, score, size, tally

from station.discrepancy.detectable import detectable_sizes, detectable_table
from station.discrepancy.fit import Problem


def fit_on(i: int) -> tuple[str, str]:
    return KINDS[i % 3], KINDS[(i + 1) % 3]


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
    ],
)
def test_a_single_effect_is_named_and_its_interval_holds_it(seed, sigma, name, sign):
    case = Case(seed=seed, sigma=sigma, effects={name: sign * 2.5 * size(name, sigma)})
    d = diagnosed(case)
    assert score(case, d) in ("exact", "group"), [(e.term.id, e.value, e.rivals) for e in d.effects]
    for _, inside, z in covered(case, d):
        assert inside or abs(z) < 3


def test_two_effects_at_once_are_both_named():
    case = Case(seed=921, sigma=SIGMAS[1], effects={"alpha_vane.scale": 0.06, "accelerometer.delay": 0.008})
    assert score(case, diagnosed(case)) in ("exact", "group")


@pytest.mark.parametrize("outside", [{"g_sensitivity": 0.008}])
def test_what_the_catalogue_does_not_have_is_unexplained(outside):
    d = diagnosed(Case(seed=931, sigma=SIGMAS[0], outside=outside))
    assert d.verdict == "unexplained"
    assert set(d.leftover.signals) & {"q", "theta", "elevator"}


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
    sizes = detectable_sizes(references, Problem(references, aircraft()), 0.0)
    found = {d.id: d for d in sizes}
    for name in ("alpha_vane.delay", "q.scale", "accelerometer.position", "mass.scale"):
        assert found[name].found == pytest.approx(size(name, 0.0), rel=0.5)
        assert found[name].named >= found[name].found
    assert "| `q.scale` | % |" in detectable_table([("two, calm", sizes)])


@pytest.mark.slow
def test_matrix_of_clean_flights():
    cases = [Case(seed=20000 + i, sigma=SIGMAS[i % 3], fit_on=fit_on(i // 3), thrust=i % 2 == 0) for i in range(200)]
    scores = [score(c, diagnosed(c)) for c in cases]
    print(tally(scores))
    assert scores.count("clean") >= 0.99 * len(scores)


@pytest.mark.slow
def test_matrix_of_single_effects_at_twice_their_detectable_size():
    cases = []
    for name in DETECTABLE:
        for k in range(9):
            sigma = SIGMAS[k % 3]
            if name == "elevator.scale" or not math.isfinite(size(name, sigma)):
                continue
            i = len(cases)
            sign = 1 if name == "elevator.backlash" or i % 2 else -1
            planted = {name: 2 * sign * size(name, sigma)}
            cases.append(Case(seed=6000 + i, sigma=sigma, effects=planted, fit_on=fit_on(i)))
    found = [(c, diagnosed(c)) for c in cases]
    scores = [score(c, d) for c, d in found]
    inside = [hit for c, d in found for _, hit, _ in covered(c, d)]
    rows: dict[str, list[str]] = {}
    for c, d in found:
        rows.setdefault(next(iter(c.effects)), []).append(
            score(c, d) if score(c, d) == "exact" else f"{score(c, d)} {[e.term.id for e in d.effects]}"
        )
    for name, row in rows.items():
        print(f"{name:26s} {tally(row)}")
    print(tally(scores), f"coverage {np.mean(inside):.3f} of {len(inside)}")
    named = scores.count("exact")
    assert named >= 0.94 * len(scores)
    assert named + scores.count("group") + scores.count("suspect") >= 0.97 * len(scores)
    assert np.mean(inside) >= 0.90


@pytest.mark.slow
def test_matrix_of_pairs():
    cases = [
        Case(seed=40000 + i, sigma=SIGMAS[i % 3], fit_on=fit_on(i // 3), effects=draw(40000 + i, 2, 2.0, SIGMAS[i % 3]))
        for i in range(60)
    ]
    scores = [score(c, diagnosed(c)) for c in cases]
    print(tally(scores))
    assert scores.count("exact") + scores.count("group") >= 0.92 * len(scores)


@pytest.mark.slow
def test_matrix_outside_the_catalogue():
    kinds = [{"periodic": 0.002}, {"periodic": 0.004}, {"g_sensitivity": 0.006}, {"g_sensitivity": -0.008}]
    kinds += [{"Cm_alpha3": 60.0}, {"Cm_alpha3": -60.0}]
    cases = [
        Case(seed=30000 + i, sigma=SIGMAS[(i // 6) % 3], fit_on=fit_on(i), outside=kinds[i % 6]) for i in range(72)
    ]
    scores = [score(c, diagnosed(c)) for c in cases]
    print(tally(scores))
    assert scores.count("unexplained") >= 0.95 * len(scores)


@pytest.mark.slow
def test_matrix_of_large_effects():
    names = [n for n in DETECTABLE if n not in ("aero.icing", "elevator.scale")]
    airs = (SIGMAS[0], SIGMAS[2])
    cases = [
        Case(seed=s, sigma=airs[s % 2], fit_on=fit_on(s // 2), effects=draw(s, 1, 8.0, airs[s % 2], names))
        for s in range(50000, 50040)
    ]
    scores = [score(c, diagnosed(c)) for c in cases]
    print(tally(scores))
    assert scores.count("companion") <= 0.03 * len(scores)
