"""What is of a size that is not judged may explain more than what is found in its place."""

from __future__ import annotations

import pytest

from station.diagnosis import refits, search
from station.diagnosis.effects import BY_ID
from station.diagnosis.taken_back import outdone
from tests.second_simulation.fitted import fitted


def test_what_stands_in_for_something_too_small_is_no_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    """Thrust with an arm 0.42 m longer moves little more than a model may miss; beside it, a boom that bends, which was
    named, gains nothing."""
    problem, flights = fitted(10, 11)
    (true,) = flights[0].answers["hidden"].values()
    terms = [BY_ID[i] for i in ("boom.flexure", "thrust.moment")]
    monkeypatch.setattr(search, "least_judged", lambda *_: {"thrust.moment": 2 * true})
    found = search.search(problem, terms)
    assert found.accepted.state.ids == ("boom.flexure",)
    left, doubted = outdone(found, problem)
    assert not left.accepted.state.values
    assert doubted == [("thrust.moment", ("boom.flexure",))]


def test_what_gains_enough_beside_it_stays_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two that are hidden the one that explains more is not judged."""
    problem, _ = fitted(1, 4, names=("q.delay", "accelerometer.delay"))
    terms = [BY_ID[i] for i in ("q.delay", "accelerometer.delay")]
    for module in (search, refits):
        monkeypatch.setattr(module, "least_judged", lambda *_: {"q.delay": 1.0})
    found = search.search(problem, terms)
    assert found.accepted.state.ids == ("accelerometer.delay",)
    assert any(e.state.ids == ("q.delay",) for e, _ in found.too_small)
    assert outdone(found, problem) == (found, [])
