"""When an estimate counts as estimated: each criterion alone, on either side of its limit."""

import math

import pytest

from station.estimation import acceptance as a
from station.rows import Status

GOOD = {"value": 5.0, "error": 0.5, "known": 4.0, "r2": 0.9, "inflation": 3.0}


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        ({}, a.ESTIMATED),
        ({"r2": 0.3}, a.ESTIMATED),
        ({"r2": 0.29}, a.UNEXPLAINED + 29),
        ({"r2": -2.0}, a.UNEXPLAINED),
        ({"inflation": 100.0}, a.ESTIMATED),
        ({"inflation": 101.0}, a.MOVES_ALONG),
        ({"error": 2.5}, a.ESTIMATED),
        ({"error": 2.51}, a.WIDE),
        # A small estimate of a derivative that the profile knows to be large is known well enough.
        ({"value": 0.1, "error": 2.0}, a.ESTIMATED),
        ({"value": 0.1, "error": 2.01}, a.WIDE),
        ({"value": math.nan}, a.NOT_FINITE),
        ({"error": math.inf}, a.NOT_FINITE),
    ],
)
def test_each_criterion_alone(change: dict[str, float], wanted: int) -> None:
    case = {**GOOD, **change}
    assert (a.of_equation(case.pop("r2")) or a.of_estimate(**case)) == wanted


def test_a_verdict_says_its_criterion() -> None:
    assert a.worded(a.ESTIMATED) == (Status.ESTIMATED, "")
    status, why = a.worded(a.UNEXPLAINED + 12)
    assert status is Status.INVALID
    assert "0.12" in why
    assert all(why for code, (_, why) in a._WORDS.items() if code != a.ESTIMATED)
