"""The fit without effects, whose minima may lie apart."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.optimize import minimize_scalar

from station.diagnosis.candidate import Estimate, State
from station.diagnosis.free_parameters import LIFT_AMPLITUDES, LIFT_RATES, OWN_SHARE
from station.diagnosis.likelihood import BLAMED, ROUNDS, Problem
from station.diagnosis.side_by_side import meanwhile
from station.profile.profile_changes import fin

BRISK: Final = 1.5
"""Prior standard deviations of a lag's rate, beyond which a fit is begun without the lag too. Of 31 flights of the
second simulation whose lift follows at once 11 are: 9 end in a better minimum by it, 1 to 53 lower in cost. Of 31
others 1 is, and ends as it was."""


WASH: Final = 0.5
"""Sidewash to either side, within which the fin's share of the yaw damping is looked for. It moves the wing's share by
six hundredths, twice what a slope of 20 %, an arm of 9 % and a Cn_r of 10 % leave it uncertain by."""
MOST_WASH: Final = 0.95
"""A sidewash of 1 leaves the fin no sideslip: profile.Fin ends there."""
WASH_DONE: Final = 0.02
"""Of it: a tenth of what the answer shows it to."""


def null(problem: Problem) -> Estimate:
    """Without effects. Where the model misses much, minima lie apart: the likelier of two, begun with what scales a
    series held, and free."""
    near = problem.near({})
    other = meanwhile(_freely, [(problem,)]) if _misses_much(problem, near) else lambda: [_freely(problem)]
    e = problem.from_near(near)
    e = min(e, *other(), key=lambda e: e.cost) if _misses_much(problem, e.state) else e
    return well_answered(problem, e)


def well_answered(problem: Problem, e: Estimate) -> Estimate:
    """Where gusts are answered: the likelier of an estimate and of one whose gusts are answered by another share of
    the fin in the yaw damping. What yaws a wing alone is the small difference of the two; the aircraft's answer to air
    that turns about it rests on that, and no mean of the residuals does. A wrong share leaves noise at the Dutch roll
    that has no sensor."""
    s = e.state
    if problem.axis.answers is None or problem.aircraft.fin is None:
        return e
    craft = problem.aircraft_at(s.values, s.a)
    assert craft.fin is not None
    washed, here = fin("sidewash"), craft.fin.sidewash

    def answered(sidewash: float) -> State:
        return problem.relevelled(problem.state(s.values, s.a, s.levels, washed(craft, sidewash - here)))

    ends = max(here - WASH, -MOST_WASH), min(here + WASH, MOST_WASH)
    found = minimize_scalar(
        lambda x: problem.cost(answered(x)), bounds=ends, method="bounded", options={"xatol": WASH_DONE}
    )
    best = answered(float(found.x))
    if problem.cost(best) >= problem.cost(s):
        return e
    return min(e, problem.estimate(best, ROUNDS, problem.whole), key=lambda e: e.cost)


def _misses_much(problem: Problem, s: State) -> bool:
    return bool((s.levels.missed > BLAMED**2 * problem.prior.missed).any())


def _freely(problem: Problem) -> Estimate:
    return problem.from_profile({}, free=True)


def without_effects(problem: Problem) -> Estimate:
    """`null`; or where that has made a lag of the lift brisk, the likelier of it and of a fit that is begun with lift
    that follows at once. Each ends in a minimum of its own."""
    e = null(problem)
    place = {f.name: i for i, f in enumerate(problem.frees)}
    if not {*LIFT_RATES, *LIFT_AMPLITUDES} <= place.keys():
        return e
    (both, of_gusts), amplitudes = ([place[n] for n in names] for names in (LIFT_RATES, LIFT_AMPLITUDES))
    if e.state.a[both] + max(OWN_SHARE * e.state.a[of_gusts], 0.0) < BRISK:
        return e
    a = e.state.a.copy()
    a[[both, of_gusts]] = 0.0
    a[amplitudes] = -1 / problem.frees[amplitudes[0]].sd, 0.0
    try:
        begun = problem.relevelled(problem.beside(e.state, {}, a))
        return min(e, problem.estimate(begun, ROUNDS, problem.whole), key=lambda e: e.cost)
    except np.linalg.LinAlgError:  # so far off that its noise cannot be told
        return e
