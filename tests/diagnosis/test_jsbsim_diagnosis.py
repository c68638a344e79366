"""Another aircraft model than the profile's: instruments are not blamed for it, and faults of theirs are found."""

from __future__ import annotations

import pytest
from blind import SIGMAS, Case, size, tally
from jsbsim_flights import flown, profile

from station.diagnosis.procedure import Diagnosis, diagnose
from station.diagnosis.search import CONFOUNDED

TWO_SPEEDS = (("doublets", 100.0), ("3-2-1-1", 125.0))
PLANTED = (
    "alpha_vane.delay", "alpha_vane.scale", "alpha_vane.position", "boom.flexure", "accelerometer.position",
    "accelerometer.scale", "accelerometer.delay", "q.delay", "q.scale", "imu.delay", "elevator.lag",
    "elevator.backlash", "velocity.delay",
)  # fmt: skip


def diagnosed(case: Case, card=TWO_SPEEDS) -> Diagnosis:
    made = [flown(case, kind, knots, k) for k, (kind, knots) in enumerate((*card, card[0]))]
    return diagnose(made[:-1], made[-1:], profile())


def named(d: Diagnosis) -> dict[str, tuple[str, ...]]:
    """What is named that is not the aircraft's model, and its rivals."""
    return {e.term.id: e.alternatives for e in d.effects if not e.term.aerodynamic}


def score(case: Case, d: Diagnosis) -> str:
    true, found = set(case.effects), named(d)
    if not true:
        return "blamed" if found else "clean"
    if set(found) == true:
        return "group" if any(found.values()) else "alone"
    if not found:
        return "none"
    possible = set(found) | {r for alternatives in found.values() for r in alternatives}
    return "companion" if true < set(found) else "group" if true <= possible and len(found) == 1 else "wrong"


@pytest.mark.parametrize("sigma", [SIGMAS[0], pytest.param(SIGMAS[1], marks=pytest.mark.slow)])
def test_without_an_effect_the_model_lacks_something_and_no_instrument_failed(sigma):
    d = diagnosed(Case(seed=70, sigma=sigma))
    assert named(d) == {}
    assert d.verdict == "unexplained"
    # The table's lift slope near trim is 4.0 to 4.9 per rad, the profile's 5.66.
    k = next(i for i, free in enumerate(d.problem.frees) if free.name == "CL_alpha")
    # The fit without an effect has two minima, at -0.39 and -0.46: which one is found hangs on a thousandth of a prior.
    assert -0.5 < d.problem.frees[k].sd * d.found.null.state.a[k] < -0.1


@pytest.mark.parametrize(
    ("name", "sigma"),
    [
        pytest.param("q.scale", SIGMAS[2], marks=pytest.mark.slow),
        pytest.param("alpha_vane.scale", SIGMAS[0], marks=pytest.mark.slow),
        pytest.param("alpha_vane.delay", SIGMAS[0], marks=pytest.mark.slow),
        pytest.param("q.delay", SIGMAS[0], marks=pytest.mark.slow),
    ],
)
def test_an_instrument_that_contradicts_the_others_is_named(name, sigma):
    case = Case(seed=71, sigma=sigma, effects={name: 4 * size(name, sigma)})
    d = diagnosed(case)
    assert score(case, d) in ("alone", "group")
    found = next(e for e in d.effects if e.term.id == name)
    assert found.ci95[0] < case.effects[name] < found.ci95[1]
    assert found.sd < 0.25 * abs(case.effects[name])


@pytest.mark.slow
def test_two_speeds_tell_a_delay_from_a_position():
    both = ("alpha_vane.delay", "alpha_vane.position")
    for seed in (72, 73):
        true, other = both[seed % 2], both[1 - seed % 2]
        case = Case(seed=seed, effects={true: 4 * size(true, 0.0)})
        d = diagnosed(case)
        assert score(case, d) == "alone"
        cost = {name: e.cost for ids, e in d.found.tried.items() for name in ids if len(ids) == 1}
        assert cost[other] - cost[true] > CONFOUNDED


@pytest.mark.slow
def test_matrix_of_effects_at_four_times_their_detectable_size():
    cases = []
    for i in range(2 * len(PLANTED)):
        name, sigma = PLANTED[i % len(PLANTED)], SIGMAS[(i // len(PLANTED) + i) % 3]
        sign = 1 if name == "elevator.backlash" else (-1) ** (i // 7)
        cases.append(Case(seed=70000 + i, sigma=sigma, effects={name: 4 * sign * size(name, sigma)}))
    scores = [score(c, diagnosed(c)) for c in cases]
    for c, s in zip(cases, scores, strict=True):
        print(f"{s:10s} {c.sigma:.2f} {c.effects}")
    print(tally(scores))
    assert len([s for s in scores if s in ("alone", "group")]) >= 0.85 * len(scores)


@pytest.mark.slow
def test_matrix_of_flights_without_an_effect():
    cases = [Case(seed=71000 + i, sigma=SIGMAS[i % 3]) for i in range(18)]
    scores = [score(c, diagnosed(c)) for c in cases]
    print(tally(scores))
    assert scores.count("clean") >= 0.94 * len(scores)
