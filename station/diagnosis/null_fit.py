"""The fit without effects, of an aircraft whose lift may follow at once."""

from __future__ import annotations

from typing import Final

import numpy as np

from station.diagnosis.candidate import Estimate
from station.diagnosis.free_parameters import LIFT_AMPLITUDES, LIFT_RATES
from station.diagnosis.likelihood import ROUNDS, Problem

BRISK: Final = 1.5
"""Prior standard deviations of a lag's rate from which none of it is tried. Of 146 aircraft of the second simulation 10
are fitted so, 5 of them for want of a better minimum: with none the cost is less by 14 to 62."""


def without_effects(problem: Problem) -> Estimate:
    """The likelier of two minima, where a lag of the lift has become short by its rate: that one, and one begun with
    none of it, which is lift that follows at once."""
    e = problem.null()
    place = {f.name: i for i, f in enumerate(problem.frees)}
    rates, amplitudes = ([place[n] for n in names if n in place] for names in (LIFT_RATES, LIFT_AMPLITUDES))
    if not (e.state.a[rates] > BRISK).any():
        return e
    a = e.state.a.copy()
    a[rates], a[amplitudes] = 0.0, [-1 / problem.frees[i].sd for i in amplitudes]
    try:
        begun = problem.relevelled(problem.beside(e.state, {}, a))
        return min(e, problem.estimate(begun, ROUNDS, problem.whole), key=lambda e: e.cost)
    except np.linalg.LinAlgError:  # so far off that its noise cannot be told
        return e
