"""A profile's instrument errors, play and imu offset as the simulation and the emulators fly them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest

from station.profile import Aircraft, Card, Change, Instrument, load_aircraft, load_card, load_rig
from station.rows import ProfileError
from station.simulation import Simulation, fly
from station.simulation.installed import Installed
from station.simulation.motion import DT
from station.simulation.sortie import installed

RAMP, N = 0.02, 800
DOUBLET = {"kind": "doublet", "start": "1 s", "width": "0.7 s", "amplitude": "3 deg"}


class Line:
    """A source whose pitch rate is a straight line in time and whose heading turns through 180 deg."""

    def __init__(self) -> None:
        self.k = 0

    def advance(self, n: int) -> Mapping[str, np.ndarray]:
        t = (self.k + np.arange(n)) * DT
        self.k += n
        turned = np.remainder(3.0 + 0.1 * t + math.pi, 2 * math.pi) - math.pi
        return {"q": RAMP * t, "psi": turned, "theta": np.sin(3 * t), "secret": t}


def errs(**keys: float) -> Instrument:
    return Instrument.model_validate(keys, context="si")


def with_errors(**errors: Instrument) -> Aircraft:
    return load_aircraft("twin_otter").model_copy(update={"instruments": errors})


def card(*manoeuvres: dict[str, object], **flight: object) -> Card:
    return Card.model_validate(
        {"name": "t", "aircraft": "twin_otter", "rig": "bench", "manoeuvres": list(manoeuvres), "flight": flight}
    )


@pytest.mark.parametrize("latency", [0.0, 0.0323, 0.02, -0.0323, -0.3])
@pytest.mark.parametrize("lag", [0.0, 0.05, -0.05])
def test_gain_bias_latency_and_lag_of_either_sign(latency: float, lag: float) -> None:
    errors = errs(latency=latency, lag=lag, gain=1.1, bias=0.4)
    flight = Installed(Line(), with_errors(q=errors))
    shown = flight.advance(N)["q"]
    t = np.arange(N) * DT
    settled = t > 0.8
    expected = 1.1 * RAMP * (t - latency - lag) + 0.4
    np.testing.assert_allclose(shown[settled], expected[settled], atol=1e-8)
    np.testing.assert_array_equal(flight.truth["q"], RAMP * t)
    np.testing.assert_allclose(flight.truth["secret"], t)


def test_the_same_bits_however_the_flight_is_cut_and_angles_pass_180_degrees() -> None:
    errors = {
        "q": errs(latency=-0.03, lag=0.02),
        "psi": errs(latency=0.04),
        "theta": errs(lag=-0.03, latency=0.011),
    }
    drifts = {"q": 1e-3, "theta": 2e-3}
    whole = Installed(Line(), with_errors(**errors), drifts, 5).advance(N)
    cut = Installed(Line(), with_errors(**errors), drifts, 5)
    pieces = [cut.advance(n) for n in (1, 2, 20, 377, 400)]
    for name, values in whole.items():
        np.testing.assert_array_equal(np.concatenate([p[name] for p in pieces]), values, err_msg=name)
    assert np.abs(whole["psi"]).max() <= math.pi
    off = np.unwrap(whole["psi"]) - (3.0 + 0.1 * (np.arange(N) * DT - 0.04))
    assert np.abs(off[20:]).max() < 1e-9


def test_without_errors_what_is_shown_is_the_truth() -> None:
    flight = Installed(Line(), load_aircraft("twin_otter"))
    shown = flight.advance(50)
    assert set(shown) == {"q", "psi", "theta"}
    assert all(shown[n] is flight.truth[n] or np.array_equal(shown[n], flight.truth[n]) for n in shown)


def test_drift_is_a_random_walk_of_the_stated_size() -> None:
    ends = []
    for seed in range(400):
        shown = Installed(Line(), load_aircraft("twin_otter"), {"q": 0.01}, seed).advance(N + 1)["q"]
        walk = shown - RAMP * np.arange(N + 1) * DT
        assert walk[0] == 0.0
        ends.append(walk[-1])
    # After 4 s: twice the standard deviation after one; 400 draws know theirs to 3.5 %.
    assert np.std(ends) == pytest.approx(0.02, rel=0.12)
    assert abs(np.mean(ends)) < 4 * 0.02 / 20


def test_play_holds_the_surface_back_and_the_sensor_sees_its_drive() -> None:
    play = math.radians(0.5)
    loose = with_errors(elevator=errs(backlash=play))
    shown, truth = fly(loose, {}, card(DOUBLET), 6.0)
    _, stiff = fly(load_aircraft("twin_otter"), {}, card(DOUBLET), 6.0)
    np.testing.assert_array_equal(shown["elevator"], truth["elevator_drive"])
    np.testing.assert_allclose(truth["elevator_drive"], stiff["elevator"], atol=1e-12)
    # The play operator, written again from its definition.
    at, expected = truth["elevator_drive"][0], []
    fine = Simulation(loose, card().flight, card(DOUBLET).manoeuvres).advance(1200)
    for x in fine["elevator_drive"]:
        at = min(max(at, x - play / 2), x + play / 2)
        expected.append(at)
    np.testing.assert_allclose(fine["elevator"], expected, atol=1e-12)
    assert np.abs(fine["elevator"] - fine["elevator_drive"]).max() == pytest.approx(play / 2)
    assert np.ptp(truth["q"]) < 0.97 * np.ptp(stiff["q"])
    # The surface has been to both sides and is left where its drive's last motion put it.
    assert abs(truth["elevator"][-1] - truth["elevator_drive"][-1]) > 0.4 * play / 2


def test_play_elsewhere_is_refused() -> None:
    with pytest.raises(ProfileError, match=r"instruments\.rudder\.backlash"):
        fly(with_errors(rudder=errs(backlash=0.01)), {}, card(), 1.0)


def planted() -> Aircraft:
    errors = {
        "alpha_vane": errs(gain=1.2, latency=0.03),
        "elevator": errs(backlash=math.radians(0.4)),
        "q": errs(latency=-0.02),
        "theta": errs(latency=-0.02),
    }
    return with_errors(**errors).model_copy(update={"imu_offset": (0.6, 0.0, -0.2)})


def test_a_diagnosed_profile_is_flown_by_simulate_and_by_the_emulators_alike() -> None:
    aircraft, flown = planted(), card(DOUBLET, gust_sigma="5 ft/s")
    rig = load_rig("bench")
    silent = rig.without_noise()
    shown, truth = fly(aircraft, silent, flown, 8.0)
    plain, plain_truth = fly(aircraft.model_copy(update={"instruments": {}}), silent, flown, 8.0)
    t = truth["time"]
    late = np.interp(t - 0.03, t, truth["alpha_vane"])
    np.testing.assert_allclose(shown["alpha_vane"][5:], 1.2 * late[5:], atol=3e-3)
    early = np.interp(t + 0.02, t, truth["q"])
    np.testing.assert_allclose(shown["q"][:-1], early[:-1], atol=1e-9)
    assert np.abs(truth["alpha"] - plain_truth["alpha"]).max() > 1e-4  # the backlash was flown
    # Where the imu is: rig and profile together.
    x, z = rig.imu_position[0] + 0.6, rig.imu_position[2] - 0.2
    still = Simulation(aircraft, flown.flight, flown.manoeuvres).advance(1600)
    felt = still["az"] - still["qdot"] * x - still["q"] ** 2 * z
    np.testing.assert_allclose(shown["az"], felt[::4], atol=1e-9)

    source = installed(aircraft, rig, flown)  # what the emulators fly
    rows = [source.advance(20) for _ in range(80)]
    for name, values in shown.items():
        np.testing.assert_array_equal(np.concatenate([r[name] for r in rows])[::4], values, err_msg=name)
    assert np.abs(shown["elevator"] - plain["elevator"]).max() < 1e-12


def test_the_lateral_card_flies_six_degrees_of_freedom() -> None:
    flown = load_card("lateral")
    shown, truth = fly(flown.aircraft, flown.rig, flown.card, 30.0)
    assert np.ptp(truth["beta"]) > math.radians(2)
    assert np.ptp(shown["rudder"]) > math.radians(8)


class Steady:
    """A source at 1,000 Pa of dynamic pressure."""

    def __init__(self) -> None:
        self.k = 0

    def advance(self, n: int) -> Mapping[str, np.ndarray]:
        self.k += n
        return {"static_pressure": np.full(n, 9e4), "dynamic_pressure": np.linspace(1000, 2000, n)}


def test_the_static_port_errs_by_dynamic_pressure() -> None:
    """What airspeed and dynamic pressure show is stated whole in [instruments]."""
    aircraft = load_aircraft("twin_otter").model_copy(update={"static_position": 0.03})
    flight = Installed(Steady(), aircraft)
    shown = flight.advance(N)
    np.testing.assert_allclose(shown["static_pressure"], 9e4 + 0.03 * np.linspace(1000, 2000, N))
    np.testing.assert_array_equal(shown["dynamic_pressure"], np.linspace(1000, 2000, N))
    np.testing.assert_array_equal(flight.truth["static_pressure"], np.full(N, 9e4))


def test_mass_that_falls_flows_as_fuel() -> None:
    """0.05 kg/s from 1 s to 3 s of flight."""
    burnt = Change.model_validate({"at": ["1 s", "3 s"], "value": ["4900 kg", "4899.9 kg"]})
    shown = Installed(Line(), load_aircraft("twin_otter"), truth={"inertia.mass": burnt}).advance(N)
    t = np.arange(N) * DT
    np.testing.assert_allclose(shown["fuel_flow"][(t > 1) & (t < 2.99)], 0.05, rtol=1e-6)
    assert not shown["fuel_flow"][(t < 0.99) | (t > 3.01)].any()
    assert "fuel_flow" not in Installed(Line(), load_aircraft("twin_otter")).advance(N)
