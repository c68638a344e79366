"""[pilot] as a human flies: McRuer's crossover model, by its transfer function, and a remnant by its statistics."""

from __future__ import annotations

import math

import numpy as np
import pytest

from station.profile import Card, Flight, Pilot, from_json, load_aircraft, load_card, to_json
from station.rows import ProfileError
from station.simulation.pilot import RATE_HZ, Tremor, asked, hands, ring
from station.simulation.side_flow import TURN
from station.simulation.six_degrees import LateralSimulation
from station.simulation.three_degrees import Simulation

HUMAN = Pilot.model_validate(
    {"attitude": 0.4, "pitch_rate": "0.2 s", "delay": "0.2 s", "neuromuscular": "0.1 s", "remnant": "0.3 deg"}
)


@pytest.mark.parametrize("omega", [0.5, 1.0, 2.0, 4.0, 8.0])
def test_crossover_model(omega: float) -> None:
    """Of a pitch attitude that swings: K (T_L s + 1) e^(-tau s)/(T_N s + 1), a command held for a tick being 10 ms late
    on average and weakened as a hold does."""
    h = hands(HUMAN, 0.0, 0.0, 56.0)
    memory, steps = ring(h), 40 * RATE_HZ
    t = np.arange(steps) / RATE_HZ
    theta, q = np.sin(omega * t), omega * np.cos(omega * t)
    out = np.array([asked(h, memory, k, q[k], theta[k], 0.0, 56.0) for k in range(steps)])
    # Whole periods of the second half.
    period = 2 * math.pi / omega
    last = t > 40 - period * math.floor(20 / period)
    swung = np.linalg.lstsq(np.column_stack([np.sin(omega * t[last]), np.cos(omega * t[last])]), out[last], rcond=None)[
        0
    ]
    s = 1j * omega
    lead = HUMAN.pitch_rate / HUMAN.attitude
    model = HUMAN.attitude * (lead * s + 1) * np.exp(-HUMAN.delay * s) / (HUMAN.neuromuscular * s + 1)
    tick, step = 0.02, 1 / RATE_HZ
    # What is asked for at a step holds through it: the lag's exact step response leads the sampled line by half a step.
    model *= (1 - np.exp(-tick * s)) / (tick * s) * np.exp(step * s)
    assert abs(complex(swung[0], swung[1]) / model - 1) < 0.02


def test_remnant_is_as_strong_and_as_slow_as_said() -> None:
    """Ten minutes of it are 900 independent values: 3 % of the deviation each standard deviation."""
    line = Tremor(0.0, 3, remnant=HUMAN.remnant).half_steps(50 * 600)[::8]
    assert line.std() == pytest.approx(HUMAN.remnant, rel=0.1)
    late = 17  # ticks: 0.34 s
    assert np.corrcoef(line[:-late], line[late:])[0, 1] == pytest.approx(math.exp(-0.34 * 3), abs=0.1)


def test_remnant_is_the_same_however_the_flight_is_cut() -> None:
    aircraft, flight = load_aircraft("twin_otter"), Flight()
    whole = Simulation(aircraft, flight, pilot=HUMAN).advance(1000)["elevator"]
    cut = Simulation(aircraft, flight, pilot=HUMAN)
    np.testing.assert_array_equal(whole, np.concatenate([cut.advance(n)["elevator"] for n in (1, 399, 205, 395)]))


def test_the_card_s_human_comes_back_to_the_heading_and_stays_there() -> None:
    """From 10 deg off, 60 s in calm air: what is left is the remnant, 0.3 deg of aileron and rudder."""
    profiles = load_card("human")
    pilot = profiles.card.pilot
    assert "a human's pitch damper" in pilot.words
    simulation = LateralSimulation(profiles.aircraft, Flight(), pilot=pilot, hold=False)
    simulation._state[TURN] = math.radians(10.0)
    flown = simulation.advance(RATE_HZ * 60)
    last = np.degrees(flown["psi"][-20 * RATE_HZ :])
    assert abs(last.mean()) < 1.0
    assert 0.05 < last.std() < 2.0


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"attitude": 0.5, "delay": "3 ms"}, "3 ms is no multiple of 5 ms, the simulation's step; write 5 ms"),
        ({"remnant": "0.3 deg"}, "remnant: of a pilot who moves no surface; write a gain beside it"),
        ({"neuromuscular": "0.1 s", "heading": 0.0}, "neuromuscular: of a pilot who moves no surface"),
    ],
)
def test_what_no_pilot_can_do_is_refused(keys: dict[str, object], said: str) -> None:
    with pytest.raises(ProfileError, match=said):
        load_card("bench", overrides={f"pilot.{k}": v for k, v in keys.items()})
    for ms in range(0, 305, 5):
        assert Pilot.model_validate({"attitude": 0.5, "delay": f"{ms} ms"}).delay == pytest.approx(ms / 1000)


def test_recordings_of_cards_that_are_refused_now_are_read() -> None:
    card = load_card("bench").card
    odd = card.model_copy(update={"pilot": card.pilot.model_copy(update={"delay": 0.003, "remnant": 0.01})})
    assert from_json(Card, to_json(odd)).pilot == odd.pilot
