"""[pilot] heading: ailerons hold a bank by which the heading is come back to, as the linear equations say."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm

from station.numerics.atmosphere import atmosphere
from station.profile import Flight, Pilot, load_aircraft, load_card
from station.rows import ProfileError
from station.simulation.airframe import Constants
from station.simulation.motion import DT
from station.simulation.side_flow import TURN
from station.simulation.six_degrees import LateralSimulation
from tests.simulation.test_lateral_motion import textbook

G = 9.80665
AIRCRAFT = load_aircraft("twin_otter")
HOLD = Pilot.model_validate({"roll_rate": "0.3 s", "bank": 0.6, "heading": 0.8, "yaw_rate": "0.5 s"})


def linear(c: Constants, off: float, steps: int) -> np.ndarray:
    """(steps, 7): v, p, r, bank, heading, aileron, rudder from a heading that is `off`, by the textbook's linear
    equations, the feedback `delay` late and held for 20 ms."""
    a, inertia, value = np.zeros((9, 9)), AIRCRAFT.inertia, AIRCRAFT.value
    force = 0.5 * float(atmosphere(c.trim_height)[2]) * c.trim_speed**2 * AIRCRAFT.geometry.wing_area
    moments = np.linalg.inv(np.array([[inertia.ixx, -inertia.ixz], [-inertia.ixz, inertia.izz]]))
    a[:4, :4] = textbook(AIRCRAFT, c)
    a[4, 2] = 1 / math.cos(c.trim_alpha)
    for i, (d, actuator) in enumerate((("da", AIRCRAFT.aileron), ("dr", AIRCRAFT.rudder))):
        a[0, 5 + i] = force * value(f"CY_{d}") / inertia.mass
        a[1:3, 5 + i] = moments @ (force * AIRCRAFT.geometry.span * np.array([value(f"Cl_{d}"), value(f"Cn_{d}")]))
        a[5 + i, 5 + i], a[5 + i, 7 + i] = -1 / actuator.time_constant, 1 / actuator.time_constant
    gains = np.zeros((2, 7))
    gains[0, [1, 3, 4]] = HOLD.roll_rate, HOLD.bank, HOLD.bank * HOLD.heading
    gains[1, [2, 3]] = HOLD.yaw_rate, -HOLD.yaw_rate * G / c.trim_speed
    whole, late = expm(a * DT), round(HOLD.delay / DT)
    rows, state = np.empty((steps, 7)), np.array([0, 0, 0, 0, off, 0, 0, 0, 0.0])
    for k in range(steps):
        rows[k] = state[:7]
        if k % 4 == 0 and k >= late:
            state[7:] = gains @ rows[k - late]
        state = whole @ state
    return rows


@pytest.mark.parametrize("off", [1.0, -1.0])
def test_a_heading_is_come_back_to_as_the_linear_equations_say(off: float) -> None:
    simulation = LateralSimulation(AIRCRAFT, Flight(), pilot=HOLD)
    for tremor in simulation._across:
        tremor._sd = 0.0
    simulation._state[TURN] = math.radians(off)
    steps = 200 * 40
    flown = simulation.advance(steps)
    said = np.degrees(linear(simulation.flown.constants, math.radians(off), steps))
    # Left over: what is of second order in a bank of 1 deg.
    for name, row in (("psi", 4), ("phi", 3)):
        shown = np.degrees(flown[name])
        np.testing.assert_allclose(shown, said[:, row], atol=0.03 * np.abs(said[:, row]).max(), err_msg=name)
    assert abs(np.degrees(flown["psi"][-1])) < 0.05


@pytest.mark.parametrize("heading", [30.0, -30.0, 180.0])
def test_a_leg_s_heading_is_turned_to_in_gusts(heading: float) -> None:
    flight = Flight.model_validate({"gust_sigma": "5 ft/s", "legs": ({"start": "5 s", "heading": f"{heading} deg"},)})
    flown = LateralSimulation(AIRCRAFT, flight, pilot=HOLD).advance(200 * 120)
    late = slice(200 * 80, None)
    error = np.angle(np.exp(1j * (flown["psi"][late] - math.radians(heading))))
    assert abs(np.degrees(error.mean())) < 1.0
    assert np.degrees(error.std()) < 3.0
    turning = flown["phi"][200 * 8 : 200 * 12].mean()
    assert abs(heading) == 180 or np.sign(turning) == np.sign(heading)


@pytest.mark.parametrize(("knots", "bank"), [(110.0, 30.0), (110.0, -30.0), (135.0, 40.0)])
def test_a_turn_keeps_speed_and_height(knots: float, bank: float) -> None:
    """As steep as asked for, at the pitch rate of a level turn, g/V sin(bank) tan(bank) (Etkin 1972, 7.4). With the
    elevator of level flight more lift came by speed alone: 13 kt of it, and 1,100 ft lower."""
    speed = knots * 1852 / 3600
    legs = ({"start": "5 s", "speed": f"{speed} m/s", "bank": f"{bank} deg"},)
    flown = LateralSimulation(AIRCRAFT, Flight.model_validate({"legs": legs})).advance(200 * 200)
    late = slice(200 * 120, None)
    assert np.degrees(flown["phi"][late]) == pytest.approx(bank, abs=1.0)
    assert flown["airspeed"][late] == pytest.approx(speed, rel=0.05)
    assert np.abs(flown["altitude"] - 762.0).max() < 150.0
    roll = math.radians(bank)
    at_rest = G / flown["airspeed"][-1] * math.sin(roll) * math.tan(roll)
    assert flown["q"][-1] == pytest.approx(at_rest, rel=0.08)  # some of the side force is that of sideslip


def test_a_turn_too_steep_to_be_trimmed_is_flown_on() -> None:
    legs = ({"start": "2 s", "speed": "36 m/s", "bank": "75 deg"},)
    flown = LateralSimulation(AIRCRAFT, Flight.model_validate({"legs": legs})).advance(200 * 60)
    assert np.isfinite(flown["airspeed"]).all()


def test_a_yaw_damper_damps() -> None:
    swayed = []
    for yaw in ("0 s", "0.5 s"):
        pilot = Pilot.model_validate({"bank": 0.6, "roll_rate": "0.3 s", "yaw_rate": yaw})
        flown = LateralSimulation(AIRCRAFT, Flight.model_validate({"gust_sigma": "5 ft/s"}), pilot=pilot).advance(8000)
        swayed.append(flown["r"].std())
    assert swayed[1] < 0.9 * swayed[0]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"pilot.heading": 1.0}, "write bank = 0.5 beside it"),
        ({"pilot.roll_rate": 1.0}, "missing unit"),
        ({"pilot.bank": 1.0, "flight.source": "jsbsim"}, "a pilot of its own"),
    ],
)
def test_a_heading_hold_that_cannot_be_is_refused(settings: dict[str, object], said: str) -> None:
    with pytest.raises(ProfileError, match=said):
        load_card("feedback", overrides=settings)
