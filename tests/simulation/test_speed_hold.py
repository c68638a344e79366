"""[pilot] speed: the elevator holds the airspeed by pitch, as the textbook's linear equations say, and in gusts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from linear_flight import G, textbook
from scipy.linalg import expm

from station.profile import Flight, Pilot, Unsteady, load_aircraft, load_card
from station.rows import ProfileError
from station.simulation import longitudinal as eq
from station.simulation.motion import DT
from station.simulation.six_degrees import LateralSimulation
from station.simulation.three_degrees import Simulation

QUASI_STEADY = load_aircraft("twin_otter").model_copy(update={"unsteady": Unsteady(memory=False)})
INNER = {"pitch_rate": "0.5 s", "attitude": 1.0}
HOLD = Pilot.model_validate({**INNER, "speed": "0.012 rad/(m/s)"})


def gusty(sigma: float, **more: object) -> Flight:
    return Flight.model_validate({"gust_sigma": f"{sigma} ft/s", **more})


def linear(a: np.ndarray, pilot: Pilot, start: np.ndarray, steps: int) -> np.ndarray:
    """(steps, 5): from `start`, the feedback `delay` late and held for 20 ms."""
    whole = expm(np.vstack((a, np.zeros((1, 6)))) * DT)
    gains = np.array([-pilot.speed, 0.0, pilot.pitch_rate, pilot.attitude, 0.0])
    rows, state, asked = np.empty((steps, 5)), start, 0.0
    late = round(pilot.delay / DT)
    for k in range(steps):
        rows[k] = state
        if k % 4 == 0 and k >= late:
            asked = float(gains @ rows[k - late])
        state = (whole @ np.append(state, asked))[:5]
    return rows


@pytest.mark.parametrize("off", [0.5, -0.5])
def test_a_speed_is_held_as_the_linear_equations_say(off: float) -> None:
    """From 0.5 m/s too fast and too slow, thrust left alone: the phugoid becomes a decay, and it is that."""
    simulation = Simulation(QUASI_STEADY, Flight(), pilot=HOLD, hold=False)
    simulation._tremor._sd = 0.0
    c = simulation.flown.constants
    x = simulation._memory.x
    x[eq.U] += off * math.cos(c.trim_alpha)
    x[eq.W] += off * math.sin(c.trim_alpha)
    steps = 200 * 40
    flown = simulation.advance(steps)
    a = textbook(QUASI_STEADY, c)
    held = linear(a, HOLD, np.array([off, 0.0, 0.0, 0.0, 0.0]), steps)
    shown = np.stack([flown["airspeed"] - c.trim_speed, flown["theta"] - c.trim_alpha], axis=1)
    # Left over: what is of second order in a change of speed of 1 %, and density with height.
    np.testing.assert_allclose(shown[:, 0], held[:, 0], atol=0.02 * abs(off))
    np.testing.assert_allclose(shown[:, 1], held[:, 3], atol=0.02 * np.abs(held[:, 3]).max())
    # Pitch follows speed at speed / attitude, and gravity then takes the error away: dV/dt = -g K V.
    constant = HOLD.attitude / (HOLD.speed * G)
    settled = np.abs(shown[:, 0]) < abs(off) / math.e
    assert DT * int(np.argmax(settled)) == pytest.approx(constant, rel=0.5)
    assert abs(shown[-1, 0]) < 0.1 * abs(off)


@pytest.mark.parametrize("off", [4.0, -4.0])
def test_a_speed_is_come_back_to_in_gusts_from_both_sides(off: float) -> None:
    kept = []
    for pilot in (Pilot.model_validate(INNER), HOLD):
        simulation = Simulation(load_aircraft("twin_otter"), gusty(5), pilot=pilot, hold=False)
        simulation._memory.x[eq.U] += off
        flown = simulation.advance(200 * 120)
        kept.append(flown["airspeed"][200 * 30 :] - simulation.flown.constants.trim_speed)
    assert abs(kept[1].mean()) < 0.5
    assert np.std(kept[1]) < np.std(kept[0])


@pytest.mark.parametrize("speed", [52.0, 61.0])
def test_a_leg_s_speed_is_commanded(speed: float) -> None:
    flight = gusty(3, legs=({"start": "10 s", "speed": f"{speed} m/s"},))
    flown = LateralSimulation(load_aircraft("twin_otter"), flight, pilot=HOLD).advance(200 * 120)
    assert flown["airspeed"][200 * 70 :].mean() == pytest.approx(speed, abs=0.5)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"pilot.speed": "0.5 deg/kt"}, "one elevator holds one of the two"),
        ({"pilot.speed": 0.01}, "missing unit"),
        ({"pilot.speed": "0.5 deg/m"}, "does not fit here; use one of .*deg/kt"),
        ({"pilot.altitude": "0 deg/m", "pilot.attitude": 0.0, "pilot.speed": "0.5 deg/kt"}, "attitude = 0.5"),
    ],
)
def test_a_speed_hold_that_cannot_be_is_refused(settings: dict[str, object], said: str) -> None:
    with pytest.raises(ProfileError, match=said):
        load_card("feedback", overrides=settings)
