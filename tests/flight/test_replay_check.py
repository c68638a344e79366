"""What replay --verify says of a difference."""

import math

from station.flight.loop import Beat
from station.flight.replay_check import Comparison, difference, same_bits
from station.rows import MethodEstimate, ParamEstimate, Status, Tick


def estimate(value: float, name: str = "Cm_q") -> MethodEstimate:
    known = ParamEstimate("Cm_de", -1.7, 0.1, Status.ESTIMATED)
    return MethodEstimate(5, "split", (known, ParamEstimate(name, value, math.nan, Status.INVALID, "why")))


def test_the_fields_that_differ_are_told_and_no_others() -> None:
    assert same_bits(estimate(math.nan), estimate(math.nan))
    assert not same_bits(estimate(0.0), estimate(-0.0))
    said = difference(estimate(-38.0), estimate(math.nextafter(-38.0, 0)))
    assert said == "MethodEstimate split\nparameters[Cm_q].value: -38.0 recorded, -37.99999999999999 now"
    assert difference(estimate(1.0), None) == "MethodEstimate recorded, nothing now"
    assert difference(estimate(1.0), Tick(5, 1, 4)) == "MethodEstimate recorded, Tick now"


def test_only_the_first_difference_is_kept_and_all_are_counted() -> None:
    found = Comparison()
    beat = Beat(Tick(5, 7, 4), (), recorded=(estimate(1.0), estimate(2.0)))
    found.take(beat, [estimate(1.0), estimate(2.0), estimate(3.0)])
    assert (found.beats, found.rows, found.different, found.first) == (1, 2, 0, "")
    found.take(beat, [estimate(1.5), estimate(2.5)])
    found.take(beat._replace(recorded=()), [estimate(1.0)])
    assert (found.beats, found.rows, found.different) == (3, 4, 2)
    assert found.first.splitlines()[0] == "first difference at tick 7: MethodEstimate split"
    assert "1.0 recorded, 1.5 now" in found.first
