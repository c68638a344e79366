"""What a search accepts, and what the model's error takes back."""

from __future__ import annotations

from dataclasses import replace

import blind
import foreign

from station.diagnosis.effects import BY_ID
from station.diagnosis.likelihood import Problem
from station.diagnosis.refits import ASKED, CONFOUNDED
from station.diagnosis.search import search
from station.diagnosis.taken_back import outdone, still_told


def test_what_the_model_s_error_may_be_all_of_is_not_named() -> None:
    """A gyro 4 % too strong, eight standard errors off; where shares of 30 % are missed of all that moves, its 95 %
    interval holds that it is right."""
    case = blind.Case(seed=11, effects={"q.scale": 0.04})
    problem = Problem(blind.prepared(case), blind.aircraft())
    found = search(problem, [BY_ID["q.scale"]])
    assert set(still_told(found, problem).accepted.state.values) == {"q.scale"}
    s = found.accepted.state
    missing = replace(s, levels=replace(s.levels, missed=0.0 * s.levels.missed + 0.3**2))
    doubtful = replace(found, accepted=replace(found.accepted, state=missing))
    assert not still_told(doubtful, problem).accepted.state.values


def test_a_rival_with_something_too_small_beside_it_does_not_make_a_finding_none() -> None:
    """A lag or a delay of 7 ms, hardly told apart; the one with a backlash of 0.5 mrad, which is too small to be
    judged, explains more than the other alone."""
    case = blind.Case(seed=102801, sigma=0.9144, effects={"elevator.lag": 0.007})
    problem = Problem(blind.prepared(case), blind.aircraft())
    found = search(problem, [BY_ID[i] for i in ("elevator.lag", "elevator.delay", "elevator.backlash")])
    (late,) = found.accepted.state.ids
    (rival,) = {"elevator.lag", "elevator.delay"} - {late}
    assert any(set(e.state.ids) == {rival, "elevator.backlash"} for e, _ in found.too_small)
    assert outdone(found, problem) == (found, [])


def test_of_two_that_look_alike_the_one_that_may_be_judged_stays_a_finding() -> None:
    """An attitude 1.4 % too large or a gyro 1.2 % too weak: beside either the other gains nothing, though one explains
    a little more. Of this gyro 1.3 % are the least that is judged."""
    case = blind.Case(seed=1134, sigma=0.404, effects={"theta.scale": 0.013856})
    with foreign.flying(foreign.SCENES["aerosonde"]):
        problem = Problem(blind.prepared(case), blind.aircraft())
        found = search(problem, [BY_ID["theta.scale"]])
        assert found.accepted.state.ids == ("theta.scale",)
        weak = problem.from_profile({"q.scale": -0.0124})
        assert weak.cost < found.null.cost - 3 * ASKED
        a_little_more = replace(weak, cost=found.accepted.cost - 1.5 * CONFOUNDED)
        found = replace(found, too_small=((a_little_more, frozenset(["q.scale"])),))
        assert outdone(found, problem) == (found, [])
