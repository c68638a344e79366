"""The simulation a step at a time against whole flights of the same equations, and closed forms of what comes in."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from station.profile import LOOP_HZ, Aircraft, Card, MeasuredLoop, load_card
from station.rows import ProfileError
from station.simulation.six_degrees import LateralSimulation
from station.simulation.stepped_flight import SteppedFlight

BENCH, FEEDBACK, LATERAL, PLANE = (load_card(name) for name in ("bench", "feedback", "lateral", "gusty_plane"))


def card(**keys: Any) -> Card:
    return Card.model_validate({"name": "t", "aircraft": "a", "rig": "r", **keys})


def flown(flight: SteppedFlight, seconds: float, rate_hz: int = LOOP_HZ, **given: float) -> dict[str, np.ndarray]:
    rows = np.array([flight.step(given) for _ in range(round(seconds * rate_hz))])
    return dict(zip(flight.columns, rows.T, strict=True))


@pytest.mark.parametrize("profiles", [BENCH, FEEDBACK, LATERAL, PLANE], ids=lambda p: p.card.name)
def test_with_nobody_outside_it_is_the_simulation_to_the_last_bit(profiles: Any) -> None:
    aircraft, planned = profiles.aircraft, profiles.card
    whole = LateralSimulation(aircraft, planned.flight, planned.manoeuvres, pilot=planned.pilot).advance(27 * 200)
    stepped = flown(SteppedFlight(aircraft, planned, rate_hz=200), 27, 200)
    for name, values in stepped.items():
        np.testing.assert_array_equal(values, whole[name], err_msg=name)


def test_at_400_hz_it_is_the_same_flight() -> None:
    """Between edges: an edge falls between two steps of one and not of the other (5 ms of a doublet)."""
    slow = flown(SteppedFlight(BENCH.aircraft, BENCH.card, rate_hz=200), 24, 200)
    fast = flown(SteppedFlight(BENCH.aircraft, BENCH.card), 24)
    for name in ("alpha_vane", "q", "az", "theta", "airspeed"):
        np.testing.assert_allclose(fast[name][::2], slow[name], atol=2e-2 * np.std(slow[name]), err_msg=name)


def test_a_measured_surface_is_where_it_is_said_to_be_at_once() -> None:
    flight = SteppedFlight(BENCH.aircraft, card(), outside=("elevator",), measured=True)
    flown(flight, 0.1)
    moved = flight.rest["elevator"] + 0.05
    row = dict(zip(flight.columns, flight.step({"elevator": moved}), strict=True))
    assert row["elevator"] == moved
    level = SteppedFlight(BENCH.aircraft, card(), outside=("elevator",), measured=True)
    still = flown(level, 0.1)
    lift = row["CL"] - still["CL"][-1]
    assert lift == pytest.approx(BENCH.aircraft.value("CL_de") * 0.05, rel=1e-3)


def test_a_commanded_surface_follows_through_its_actuator() -> None:
    """A first-order lag, its closed form; the command is small enough for the rate limit."""
    aircraft = BENCH.aircraft
    flight = SteppedFlight(aircraft, card(), outside=("elevator",))
    step = 0.5 * aircraft.elevator.rate_limit * aircraft.elevator.time_constant
    seen = flown(flight, 0.5, elevator=flight.rest["elevator"] + step)["elevator"] - flight.rest["elevator"]
    t = np.arange(len(seen)) / LOOP_HZ
    np.testing.assert_allclose(seen, step * (1 - np.exp(-t / aircraft.elevator.time_constant)), atol=1e-3 * step)


def test_test_inputs_are_laid_over_a_command() -> None:
    inputs = [{"kind": "pulse", "start": "0 s", "amplitude": "1 deg", "width": "2 s"}]
    flight = SteppedFlight(BENCH.aircraft, card(manoeuvres=inputs), outside=("elevator",))
    at = flight.rest["elevator"] + math.radians(2)
    assert flown(flight, 1.5, elevator=at)["elevator"][-1] == pytest.approx(at + math.radians(1), abs=1e-6)


def test_thrust_from_outside_replaces_the_pilot_s() -> None:
    flight = SteppedFlight(BENCH.aircraft, card(), outside=("thrust",))
    seen = flown(flight, 30, thrust=0.0)
    assert seen["thrust"][-1] < 1e-3 * seen["thrust"][0]
    assert seen["v_down"][-1] > 2.0


def test_without_lateral_derivatives_three_degrees_of_freedom_are_flown() -> None:
    bare = {n: d for n, d in BENCH.aircraft.derivatives.items() if n[:2] not in ("CY", "Cl", "Cn")}
    glider = Aircraft.model_validate(BENCH.aircraft.model_copy(update={"derivatives": bare}))
    three, six = SteppedFlight(glider, card()), SteppedFlight(BENCH.aircraft, card())
    assert not three.is_lateral
    q = flown(three, 2.0, elevator=0.02)["q"]
    np.testing.assert_allclose(q, flown(six, 2.0, elevator=0.02)["q"], atol=1e-9)
    with pytest.raises(ProfileError, match="aileron comes from outside"):
        SteppedFlight(glider, card(), outside=("aileron",))


@pytest.mark.parametrize(
    ("keys", "measured", "words"),
    [
        ({"flight": {"source": "jsbsim"}}, True, "jsbsim cannot be flown from outside"),
        ({"pilot": {"attitude": 0.5}}, True, "one of the two can move it"),
        (
            {"manoeuvres": [{"kind": "pulse", "start": "0 s", "amplitude": "1 deg", "width": "1 s"}]},
            True,
            "elevator is measured on the rig",
        ),
    ],
)
def test_what_cannot_be_flown_is_refused(keys: dict[str, Any], measured: bool, words: str) -> None:
    with pytest.raises(ProfileError, match=words):
        SteppedFlight(BENCH.aircraft, card(**keys), outside=("elevator",), measured=measured)


@pytest.mark.parametrize("rate_hz", [50.0, 200.0])
def test_a_measured_surface_is_flown_late_by_what_the_rig_declares(rate_hz: float) -> None:
    """A ramp, sampled at any moment between the steps, held until the next sample: what is flown is late on average."""
    declared = MeasuredLoop(kind="measured").delay_s(rate_hz)
    phases = np.random.default_rng(1).random(200) / rate_hz
    late = []
    for phase in phases:
        samples = phase + np.arange(-3, 100) / rate_hz
        steps = np.arange(LOOP_HZ // 2) / LOOP_HZ
        fine = np.linspace(0.1, 0.4, 3001)
        step = steps[np.searchsorted(steps, fine, side="right") - 1]
        late.append(np.mean(fine - samples[np.searchsorted(samples, step, side="right") - 1]))
    assert np.mean(late) == pytest.approx(declared, abs=5 * np.std(late) / math.sqrt(len(late)) + 1e-5)
