"""What a programme remarks of its points and a calibration of what was known better, each by made-up flights."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from station.commands.replay import replay
from station.commands.simulate import simulate
from station.log import Point
from station.profile import Calibrated, load_aircraft
from station.programme.calibrated_profile import known_worse
from station.programme.calibration import Constant
from station.programme.measured_baseline import of_several_speeds
from station.programme.programme import Flight, twice
from station.rows import UsageError


def flight(*points: Point) -> Flight:
    return Flight(Path("a.mcap"), None, points, True)  # type: ignore[arg-type]


def test_points_that_overlap_and_those_of_one_name_are_remarked() -> None:
    one, two = Point(1, 10.0, 40.0, "one; flaps up"), Point(2, 40.0, 70.0, "two; flaps up")
    assert list(twice([flight(one, two)])) == []
    over = Point(3, 60.0, 90.0, "one; flaps 20")
    said = list(twice([flight(one, two, over)]))
    assert len(said) == 2
    assert said[0].startswith("a.mcap: two and one overlap from 60 to 70 s: what was flown there counts twice")
    assert said[1] == "a.mcap: 2 points are named one: tell them by their times"
    assert list(twice([flight(one), flight(one)])) == []


def test_a_baseline_of_several_speeds_says_so() -> None:
    kt = 0.514444
    (said,) = of_several_speeds([110 * kt, 85 * kt, 135 * kt])
    assert said.startswith("pooled of 85 to 135 kt: ")
    assert list(of_several_speeds([110 * kt, 114 * kt])) == []


@pytest.mark.parametrize(("sd_deg", "count"), [(0.78, 1), (0.09, 0), (0.03, 0)])
def test_what_was_known_better_before_is_said(sd_deg: float, count: int) -> None:
    """A vane's zero known to 0.076 deg by the flight before."""
    before = {"date": "", "recordings": ["a"], "lowest_speed": "40 m/s", "highest_speed": "60 m/s"}
    known = Calibrated.model_validate({**before, "vane_zero_sd": "0.076 deg"})
    aircraft = load_aircraft("twin_otter").model_copy(update={"calibrated": known})
    zero = Constant("vane_zero", "boom.zero", "rad", 0.01, math.radians(sd_deg), 0.012)
    made: Any = SimpleNamespace(aircraft=aircraft, constants={"vane_zero": zero})
    said = known_worse(made)
    assert len(said) == count
    assert all("known to 0.78 deg, before it was to 0.076 deg (1 sd): boom.zero is now" in words for words in said)
    made.aircraft = load_aircraft("twin_otter")
    assert known_worse(made) == []


def test_a_simulated_flight_has_no_ticks_and_is_not_called_imported(tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    simulate("crew_ice", log, None, 1, 2.0)
    with pytest.raises(UsageError, match="a simulated flight has no ticks to replay"):
        replay(log)
