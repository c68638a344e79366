"""A card's [pilot]: what is measured moves the elevator, late and noisy, and gusts are answered."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from station.log import metadata
from station.profile import Doublet, Flight, Pilot, load_aircraft, load_card
from station.rows import ProfileError
from station.simulation import fly
from station.simulation.jsbsim_flight import JsbsimFlight
from station.simulation.pilot import deviation
from station.simulation.six_degrees import LateralSimulation
from station.simulation.three_degrees import Simulation

AIRCRAFT = load_aircraft("twin_otter")
HOLD = Pilot.model_validate({"pitch_rate": "0.5 s", "attitude": 0.5, "altitude": "0.1 deg/m", "delay": "60 ms"})
DAMPER = Pilot.model_validate({"pitch_rate": "0.7 s"})
KICK = (Doublet.model_validate({"kind": "doublet", "start": 2.0, "amplitude": 0.05, "width": 0.6}, context="si"),)


def gusty(sigma: float) -> Flight:
    return Flight.model_validate({"gust_sigma": f"{sigma} ft/s"})


def test_the_elevator_is_moved_by_what_was_measured() -> None:
    """The command written out from the flown motion, 60 ms late, held for 20 ms, through the actuator's 1/(0.08 s + 1)
    as scipy has it: what is left is the noise of the feedback's sensors."""
    flown = Simulation(AIRCRAFT, gusty(5), pilot=HOLD).advance(200 * 60)
    trim = {n: flown[n][0] for n in ("theta", "altitude", "elevator")}
    by_height = np.radians(0.1)
    wanted = (
        0.5 * flown["q"] + 0.5 * (flown["theta"] - trim["theta"]) + by_height * (flown["altitude"] - trim["altitude"])
    )
    late = np.concatenate((np.zeros(12), wanted))[: len(wanted)]
    held = np.repeat(late[::4], 4)[: len(late)]
    # Of a command held over each step, sampled exactly.
    share = np.exp(-0.005 / 0.08)
    moved = signal.lfilter([0.0, 1 - share], [1.0, -share], held)
    left = flown["elevator"] - trim["elevator"] - moved
    # White noise held for 20 ms through the actuator: of its standard deviation sqrt((1 - e)/(1 + e)), e = exp(-20/80).
    e = np.exp(-0.25)
    expected = deviation(HOLD) * np.sqrt((1 - e) / (1 + e))
    assert left[::4].std() == pytest.approx(expected, rel=0.1)  # of 3000 samples, 8 of them each alike
    assert np.std(moved) > 20 * expected


def test_without_a_gain_no_bit_changes() -> None:
    free, asked = (Simulation(AIRCRAFT, gusty(5), KICK, **k).advance(2000) for k in ({}, {"pilot": Pilot()}))
    for name, values in free.items():
        np.testing.assert_array_equal(values, asked[name])


@pytest.mark.parametrize("kind", [Simulation, LateralSimulation])
def test_a_flight_is_the_same_however_it_is_cut(kind: type[Simulation] | type[LateralSimulation]) -> None:
    whole = kind(AIRCRAFT, gusty(5), KICK, pilot=HOLD).advance(2000)
    cut = kind(AIRCRAFT, gusty(5), KICK, pilot=HOLD)
    pieces = [cut.advance(n) for n in (1, 7, 392, 3, 800, 797)]
    for name, values in whole.items():
        np.testing.assert_array_equal(values, np.concatenate([p[name] for p in pieces]))


def test_six_degrees_of_freedom_fly_as_three_do() -> None:
    """In calm air: the side gusts that only six feel are not there."""
    three, six = (k(AIRCRAFT, Flight(), KICK, pilot=HOLD).advance(4000) for k in (Simulation, LateralSimulation))
    for name in ("elevator", "q", "theta", "altitude"):
        np.testing.assert_allclose(six[name], three[name], atol=1e-9 * max(1.0, np.abs(three[name]).max()))


@pytest.mark.parametrize("kind", [Simulation, pytest.param(JsbsimFlight, marks=pytest.mark.slow)])
def test_a_damper_damps(kind: type[Simulation] | type[JsbsimFlight]) -> None:
    """JSBSim's aircraft too: the same gusts pitch it less."""
    aircraft = load_aircraft("dhc6_jsbsim" if kind is JsbsimFlight else "twin_otter")
    free, damped = (kind(aircraft, gusty(5), pilot=p).advance(200 * 20)["q"].std() for p in (Pilot(), DAMPER))
    assert damped < 0.75 * free


def test_attitude_and_altitude_are_held_in_gusts() -> None:
    spread = []
    for pilot in (Pilot(), HOLD):
        flown = Simulation(AIRCRAFT, gusty(5), pilot=pilot, hold=False).advance(200 * 60)
        spread.append((np.ptp(flown["altitude"]), flown["elevator"].std()))
    assert spread[1][0] < 0.5 * spread[0][0]
    assert spread[0][1] == 0.0 < spread[1][1]


def test_a_simulated_flight_is_recorded_and_says_who_flies(station, tmp_path) -> None:
    log = tmp_path / "flight.mcap"
    code, _, said = station("simulate", "feedback", "-o", log, "--duration", 30)
    assert code == 0
    assert "flown with pitch damper 0.5 s, attitude hold 0.5, altitude hold 0.00174533 rad/m, 40 ms late" in said
    card = metadata(log).about.card
    assert card is not None
    assert card.pilot == load_card("feedback").card.pilot
    assert "altitude hold 0.00174533 rad/m" in station("info", log)[1]


def test_a_card_flies_by_its_pilot() -> None:
    profiles = load_card("feedback")
    still = profiles.card.model_copy(update={"manoeuvres": ()})
    moved = [
        fly(profiles.aircraft, profiles.rig, c, 20)[1]["elevator"].std()
        for c in (still, still.model_copy(update={"pilot": Pilot()}))
    ]
    assert moved[0] > 1e-3
    assert moved[1] < 1e-15  # the trim's own rounding


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"pilot.pitch_rate": 0.5}, "missing unit"),
        ({"pilot.pitch": "0.5 s"}, "pitch_rate"),
        ({"pilot.altitude": "0.1 deg"}, "deg/m"),
        ({"flight.source": "recording"}, "a recording is flown as it is"),
    ],
)
def test_a_pilot_that_cannot_be_is_refused(settings: dict[str, object], said: str) -> None:
    with pytest.raises(ProfileError, match=said):
        load_card("feedback", overrides=settings)


def test_a_simulated_flight_says_that_the_rig_s_loop_is_left_out(station, tmp_path) -> None:
    code, _, said = station("simulate", "by_hand", "-o", tmp_path / "log.mcap", "--duration", 5)
    assert code == 0
    assert "the rig's loop (measured) is left out: nothing from outside moves a surface" in said
    assert "left out" not in station("simulate", "bench", "-o", tmp_path / "bench.mcap", "--duration", 5)[2]
