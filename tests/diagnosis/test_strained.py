"""Parameters that all are far from the profile contradict it, though no single series does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blind import Case, aircraft, fly_case

from station.diagnosis.candidate import Estimate
from station.diagnosis.judge import remaining_residual
from station.diagnosis.likelihood import Problem
from station.diagnosis.manoeuvre import manoeuvre


@pytest.fixture(scope="module")
def sound() -> tuple[Problem, Estimate]:
    problem = Problem([manoeuvre(fly_case(Case(seed=3, effects={}), "doublets", 0), aircraft())], aircraft())
    return problem, problem.null()


def test_a_sound_flight_strains_no_profile(sound: tuple[Problem, Estimate]) -> None:
    assert not remaining_residual(*sound).strained


@pytest.mark.parametrize(("names", "told"), [(("tail arm", "downwash", "inertia", "thrust scale", "mass"), True),
                                             (("Cm_alpha", "Cm_q", "Cm_de", "CL_alpha", "q bias"), False)])  # fmt: skip
def test_what_is_far_together_is_told_unless_it_has_a_name_of_its_own(
    sound: tuple[Problem, Estimate], names: tuple[str, ...], told: bool
) -> None:
    """Five parameters 4.5 standard deviations off make 101 where chance leaves 43 +- 9; derivatives have names."""
    problem, null = sound
    a = np.where([f.name in names for f in problem.frees] + [False] * len(problem.manoeuvres), 4.5, 0.0)
    strained = remaining_residual(problem, replace(null, state=replace(null.state, a=a))).strained
    assert ({n for n, _ in strained} == set(names)) is told
    assert bool(strained) is told
