"""Aircraft stacked as one give the series that each gives by itself, and so do what is unseen and the noise."""

from __future__ import annotations

from dataclasses import dataclass

import blind
import lateral_blind
import numpy as np
import pytest
from numpy.typing import NDArray

from station.diagnosis.air_data import Unseen
from station.diagnosis.effects import extended, judged_effects
from station.diagnosis.finite_differences import Differences, Move, unseen_differences
from station.diagnosis.free_parameters import moved
from station.diagnosis.likelihood import Problem
from station.diagnosis.stacked import MOST, stacked, stacks
from station.profile import Aircraft, load_aircraft
from station.profile.profile_changes import backlash, boom_mode, derivative, separation, zero_lift_drag

ROUNDING = 1e-9
"""Of the residuals: double precision leaves 1e-13 of them."""


@dataclass(frozen=True)
class Moved:
    """About an aircraft that is not the profile's, every free parameter and every effect moved."""

    problem: Problem
    here: Aircraft
    a: NDArray[np.float64]
    moves: list[Move]


@pytest.fixture(scope="module", params=["along", "across"])
def case(request: pytest.FixtureRequest) -> Moved:
    """In gusts, by which distances and times are not the same."""
    if across := request.param == "across":
        problem = Problem(
            lateral_blind.prepared(lateral_blind.Case(3, lateral_blind.SIGMAS[1])), lateral_blind.aircraft()
        )
    else:
        problem = Problem(blind.prepared(blind.Case(3, 0.9)), blind.aircraft())
    a = np.clip(0.3 * np.random.default_rng(5).standard_normal(problem.ends.shape[1]), *problem.ends)
    here = moved(problem.aircraft, problem.frees, a)
    moves = []
    for i, free in enumerate(problem.frees):
        there = a.copy()
        there[i] += free.step if a[i] + free.step <= free.ends[1] else -free.step
        moves.append(Move(moved(problem.aircraft, problem.frees, there), float(there[i] - a[i]), free.of_noise))
    present = set.intersection(*(set(m.record.signals) for m in problem.manoeuvres))
    terms = judged_effects(problem.aircraft, present, True, False, across)
    moves += [Move(extended(here, {t.id: t.null + t.step}), t.step) for t in terms]
    return Moved(problem, here, a, moves)


def test_slopes_are_those_of_each_aircraft_by_itself(case):
    problem, s = case.problem, case.problem.state({}, case.a)
    air = problem._unseen(case.a)
    made = Differences(case.here, case.moves)
    assert max(len(p.places) for p in made._passes) > 2
    for k, m in enumerate(problem.manoeuvres):
        z, r, got = s.spectra[k], s.responses[k][m.grouped.pick], made.of(m, s, k, air[k])
        for i, move in enumerate(case.moves):
            there = m.differences(move.aircraft, air[k]).minus(z)
            assert np.abs(got.bins[i] * move.step - there.bins).max() < ROUNDING * np.abs(z.bins).max(), i
            assert np.abs(got.steady[i] * move.step - there.steady).max() < ROUNDING * np.abs(z.steady).max(), i
            if move.of_noise:
                shown = m.responses(move.aircraft, m.grouped.pick, s.flown) - r
                assert np.abs(got.response[i] * move.step - shown).max() < ROUNDING * np.abs(r).max(), i


def test_a_pass_leaves_its_stack_as_it_is(case):
    m, made = case.problem.manoeuvres[0], Differences(case.here, case.moves)
    whole = max(made._passes, key=lambda p: len(p.places))
    once, again = (m.differences(whole.series).bins for _ in range(2))
    assert np.array_equal(once, again)


def test_what_is_unseen_moves_the_series_as_one_by_one(case):
    m, here = case.problem.manoeuvres[0], Unseen(0.5, -0.2, 0.3)
    count = len(case.problem.unseen_sd)
    steps = np.array([0.4, 0.3, 0.5])[:count]
    got, z = unseen_differences(m, case.here, here, steps), m.differences(case.here, here)
    for i, step in enumerate(steps):
        values = np.array(here)
        values[i] += step
        there = m.differences(case.here, Unseen(*values.tolist())).minus(z)
        assert np.abs(got.bins[i] - there.bins).max() < ROUNDING * np.abs(z.bins).max()
        assert np.abs(got.bins[i]).max() > 100 * ROUNDING * np.abs(z.bins).max()


def test_what_shows_in_no_series_judged_changes_nothing(case):
    """As drag does not across the flight, nor along it without a recorded thrust."""
    problem, s = case.problem, case.problem.state({}, case.a)
    moves = [Move(zero_lift_drag(case.here, 0.001 * k), 0.001 * k) for k in (1, 2, 3)]
    got = Differences(case.here, moves).of(problem.manoeuvres[0], s, 0, problem._unseen(case.a)[0])
    drag = problem.axis.series[-1] == "drag" and problem.manoeuvres[0].place("drag") is not None
    assert np.abs(got.bins).any() == np.abs(got.steady).any() == drag


def test_aircraft_of_another_kind_come_by_themselves():
    own = load_aircraft("twin_otter")
    others = [backlash("elevator")(own, 0.01), boom_mode(own, 0.001), separation(own, 0.2)]
    alike = [derivative("CL_alpha")(own, 0.01 * k) for k in range(1, MOST + 3)]
    rows = [others[0], *alike, *others[1:]]
    groups = sorted(stacks(rows, own))
    assert groups == sorted([[0], [MOST + 3], [MOST + 4], list(range(1, MOST + 1)), [MOST + 1, MOST + 2]])
    column = stacked([own, *alike[:2]], 1).value("CL_alpha")
    assert np.array_equal(column, own.value("CL_alpha") + np.array([[0.0], [0.01], [0.02]]))
    with pytest.raises(TypeError, match="different kinds"):
        stacked([own, others[2]], 1)
