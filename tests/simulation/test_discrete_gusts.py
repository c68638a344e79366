"""Discrete gusts: the shape that MIL-F-8785C prints, where it is met, and what half a span makes of one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from station.profile import Flight, load_aircraft
from station.simulation.flown_aircraft import FlownAircraft
from station.simulation.gusts import SIDEWAYS, UP, gust_at
from station.simulation.six_degrees import LateralSimulation
from station.simulation.three_degrees import HANDS_OFF, Simulation, gusts_of

AIRCRAFT = load_aircraft("twin_otter")
SPEED, PEAK, LENGTH = 56.0, 4.0, 40.0


def flight(field: str = "line", **keys: Any) -> Flight:
    gust = {"start": "5 s", "peak": f"{PEAK} m/s", "length": f"{LENGTH} m", **keys}
    return Flight.model_validate({"speed": f"{SPEED} m/s", "field": field, "gusts": [gust]})


def field_of(flown: Flight) -> Any:
    made = gusts_of(flown, FlownAircraft(AIRCRAFT, flown, (0.0, 0.0, 0.0), True, HANDS_OFF), None)
    for far in (100.0, 350.0, 600.0):
        made.cover(-10.0, far)
    return made.now


@pytest.mark.parametrize("field", ["line", "plane"])
@pytest.mark.parametrize(("component", "column"), [("up", UP), ("side", SIDEWAYS)])
def test_it_is_one_minus_cosine_and_nowhere_else(field: str, component: str, column: int) -> None:
    """MIL-F-8785C 3.7.1.3: V_m/2 (1 - cos(pi x/d_m)), here to the end of the second half."""
    now = field_of(flight(field, component=component))
    for x in (-3.0, 0.0, 10.0, 40.0, 55.0, 79.0, 81.0, 200.0):
        wanted = 0.5 * PEAK * (1 - math.cos(math.pi * x / LENGTH)) if 0 < x < 2 * LENGTH else 0.0
        assert gust_at(now, 5 * SPEED + x, column) == pytest.approx(wanted, abs=1e-3 * PEAK)
        assert gust_at(now, 5 * SPEED + x, UP + SIDEWAYS - column) == 0.0
    if field == "plane" and component == "up":
        assert gust_at(now, 5 * SPEED + LENGTH, now.meets.w_wing) == pytest.approx(PEAK)
        assert gust_at(now, 5 * SPEED + LENGTH, now.meets.roll) == pytest.approx(0.0, abs=1e-12)


def test_half_a_span_lifts_by_half_and_rolls() -> None:
    """Of an elliptic wing in a gust on its right half, quasi-steady: half the lift, p_g = 16 w / (3 pi b)."""
    quick = AIRCRAFT.model_copy(update={"unsteady": AIRCRAFT.unsteady.model_copy(update={"lift_gust": None})})
    flown = flight("plane", half="right")
    made = gusts_of(flown, FlownAircraft(quick, flown, (0.0, 0.0, 0.0), True, HANDS_OFF), None)
    made.cover(-10.0, 600.0)
    top = 5 * SPEED + LENGTH
    assert gust_at(made.now, top, made.now.meets.w_wing) == pytest.approx(PEAK / 2)
    expected = 16 * PEAK / (3 * math.pi * AIRCRAFT.geometry.span)
    # 24 ways in place of a span: the step between the halves is told to half a hundredth.
    assert gust_at(made.now, top, made.now.meets.roll) == pytest.approx(expected, rel=5e-3)


def test_an_updraught_on_the_right_rolls_left_and_the_wing_s_response_is_late() -> None:
    rolled = LateralSimulation(AIRCRAFT, flight("plane", half="right"), hold=False).advance(200 * 8)
    reached = rolled["time"] < 5 + 2 * LENGTH / SPEED
    assert rolled["p"][reached].min() < -0.1
    top = rolled["time"][np.argmax(rolled["p_gust"])]
    quasi_steady = 5 + (LENGTH - AIRCRAFT.geometry.chord / 4) / SPEED
    assert 0.005 < top - quasi_steady < 0.1  # of a chord's 35 ms: Kuessner's function is half way after one


def test_boom_before_cg_before_tail() -> None:
    """Times of the vane's peak and of the CG's: the vane's place over the speed, and the vane's own lag, 12 ms."""
    assert AIRCRAFT.boom is not None
    stiff = AIRCRAFT.boom.model_copy(update={"vane_frequency": 50.0, "upwash_wing": 0.0})
    aircraft = AIRCRAFT.model_copy(update={"boom": stiff})
    f = Simulation(aircraft, flight(length="15 m"), hold=False).advance(200 * 6)
    ahead = f["time"][np.argmax(f["w_gust"])] - f["time"][np.argmax(f["alpha_vane"])]
    assert ahead == pytest.approx(stiff.vane_x / SPEED, abs=0.03)


@pytest.mark.parametrize(
    ("keys", "message"),
    [({"half": "left"}, "half a span"), ({"length": "0 m"}, "length"), ({"component": "north"}, "component")],
)
def test_gusts_that_cannot_be_are_refused(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        flight(**keys)
