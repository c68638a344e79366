"""What could be instead of what is found."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from station.diagnosis.candidate import Estimate, State
from station.diagnosis.likelihood import Problem
from station.diagnosis.search import CONFOUNDED, SHORT, _others, _Refits, _rivalled


def at(cost: float, *ids: str) -> Estimate:
    nothing = cast("Any", None)
    state = State(dict.fromkeys(ids, 0.01), np.zeros(0), nothing, (), (), (), (), (), 0.0)
    return Estimate(state, nothing, [], nothing, cost)


class FittedTo:
    """A problem whose candidates end where they are told to."""

    whole = None

    def __init__(self, **ends: float) -> None:
        self.ends = {name.replace("__", "."): cost for name, cost in ends.items()}

    def estimate(self, state: State, *_: object) -> Estimate:
        return at(self.ends[state.ids[0]], *state.ids)


def test_what_few_steps_left_near_is_fitted_before_it_is_no_rival() -> None:
    """One candidate was stopped 17 short of where it ends, which is 2 from what is accepted; one is too far to be."""
    accepted, stopped, far = at(-100.0, "q.delay"), at(-81.0, "q.scale"), at(-99.0 + SHORT, "q.bias")
    problem = cast("Problem", FittedTo(q__scale=-98.0))
    refits = _Refits(problem, at(0.0), {})
    refits.done = {frozenset(e.state.ids): e for e in (accepted, stopped, far)}
    assert _rivalled(problem, refits, accepted, lambda _: None) is accepted
    rivals = [e for e in _others(refits, accepted) if e.cost - accepted.cost < CONFOUNDED]
    assert [e.state.ids for e in rivals] == [("q.scale",)]
