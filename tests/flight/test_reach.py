"""Before the flight: what a step's inputs, the travel of surfaces and the card's limits leave within reach."""

import math

import pytest

from station.api.simulated_rows import write_simulated
from station.flight.reach import beyond_flight, beyond_travel, travel_remarks, unmoved
from station.flight.verdict import obstacles
from station.profile import Card, Limits, Step, load_aircraft, load_card, profiles_dir
from station.screen.go_no_go import print_steps

AIRCRAFT = load_aircraft("twin_otter")
SIGNALS = ("alpha_vane", "beta_vane", "airspeed", "p", "q", "r", "ax", "ay", "az", "elevator", "aileron", "rudder")
ICE = (profiles_dir() / "cards" / "crew_ice.toml").read_text()


def doublet(surface: str, amplitude: str, start: str = "0 s") -> dict[str, str]:
    return {"kind": "doublet", "surface": surface, "start": start, "amplitude": amplitude, "width": "1 s"}


def step(*inputs: dict[str, str], **more: object) -> Step:
    return Step.model_validate({"name": "one", "inputs": list(inputs), **more})


@pytest.mark.parametrize(
    ("surfaces", "wanted", "lacking"),
    [
        ("elevator", "CL_alpha", ""),
        ("elevator", "Cl_p", "Cl_p: no input moves the aileron or the rudder: add one"),
        ("aileron", "Cl_p", ""),
        ("rudder", "Cl_p", ""),
        ("rudder", "Cl_da", "Cl_da: no input moves the aileron: add one"),
        ("aileron", "Cn_dr", "Cn_dr: no input moves the rudder: add one"),
        ("aileron", "Cm_q", "Cm_q: no input moves the elevator: add one"),
    ],
)
def test_a_derivative_needs_an_input_of_its_axis(surfaces: str, wanted: str, lacking: str) -> None:
    """As for the eye: nobody rolls with the elevator."""
    flies = step(doublet(surfaces, "2 deg"), accept={wanted: "30 %"})
    said = unmoved(flies)
    assert len(said) == bool(lacking)
    assert all(words.startswith(lacking) for words in said)
    assert [w for w in obstacles(flies, AIRCRAFT, SIGNALS) if "no input" in w] == said


def test_a_surface_is_not_asked_for_more_than_it_moves() -> None:
    """Of 20 deg: not 40, nor two of 12 that come at once; 20 it moves."""
    (said,) = obstacles(step(doublet("elevator", "-40 deg")), AIRCRAFT, SIGNALS)
    assert said.startswith("an input of 40 deg, the elevator moves 20 deg: less amplitude")
    both = step(doublet("elevator", "12 deg"), doublet("elevator", "12 deg"))
    assert "an input of 24 deg" in beyond_travel(both.inputs, AIRCRAFT)[0]
    after = step(doublet("elevator", "12 deg"), doublet("elevator", "12 deg", "5 s"))
    assert beyond_travel(after.inputs, AIRCRAFT) == []
    assert obstacles(step(doublet("elevator", "20 deg")), AIRCRAFT, SIGNALS) == []


def test_a_condition_is_flown_below_the_limit_of_the_angle_of_attack() -> None:
    """Weight over dynamic pressure, area and lift slope: at half the speed some 15 deg more."""
    flight = {"speed": "110 kt", "altitude": "2500 ft"}
    card = Card.model_validate(
        {"name": "x", "aircraft": "", "rig": "", "flight": flight, "limits": {"angle_of_attack": "8 deg"}}
    )
    fast, slow, turning = (
        step(doublet("elevator", "2 deg"), condition=c)
        for c in ({"speed": "110 kt"}, {"speed": "75 kt"}, {"speed": "90 kt", "bank": "40 deg"})
    )
    assert beyond_flight(fast, AIRCRAFT, card) == []
    (said,) = beyond_flight(slow, AIRCRAFT, card)
    assert "limits.angle_of_attack is 8 deg: more speed, less bank" in said
    assert len(beyond_flight(turning, AIRCRAFT, card)) == 1
    assert len(obstacles(slow, AIRCRAFT, SIGNALS, card)) == 1
    rate, area, mass = 0.5 * 1.1376, AIRCRAFT.geometry.wing_area, AIRCRAFT.inertia.mass
    lift = mass * 9.80665 / (rate * (75 * 0.514444) ** 2 * area)
    alpha = math.degrees((lift - AIRCRAFT.value("CL_0")) / AIRCRAFT.value("CL_alpha"))
    told = float(said.split("takes ")[1].split(" deg")[0])
    assert told == pytest.approx(alpha, abs=1.0)  # thrust and elevator bear a little


@pytest.mark.parametrize(
    ("surface", "amplitude", "limits", "beyond"),
    [
        ("elevator", "-6 deg", {"load_factor": 1.5}, "limits.load_factor is 1.5"),
        ("elevator", "-1 deg", {"load_factor": 1.5}, ""),
        ("elevator", "6 deg", {"least_load_factor": 0.5}, "limits.least_load_factor is 0.5"),
        ("elevator", "-6 deg", {"angle_of_attack": "7 deg"}, "limits.angle_of_attack is 7 deg"),
        ("aileron", "15 deg", {"bank": "10 deg"}, "limits.bank is 10 deg"),
        ("rudder", "15 deg", {"sideslip": "3 deg"}, "limits.sideslip is 3 deg"),
        ("rudder", "1 deg", {"sideslip": "3 deg", "bank": "10 deg"}, ""),
    ],
)
def test_an_input_is_flown_before_the_flight(
    surface: str, amplitude: str, limits: dict[str, object], beyond: str
) -> None:
    """Elevator per g of the profile's derivatives is 9 deg at 110 kt, by hand; a second of 6 deg and its way back stay
    below 3 g and go beyond 1.5."""
    card = Card.model_validate({"name": "x", "aircraft": "", "rig": "", "limits": limits})
    said = beyond_flight(step(doublet(surface, amplitude), condition={"speed": "110 kt"}), AIRCRAFT, card)
    assert len(said) == bool(beyond)
    assert all(beyond in words for words in said)
    if "load_factor" in limits and beyond:
        assert 1.5 < float(said[0].split("leads to ")[1].split(" by")[0]) < 3.0


def test_of_an_aircraft_that_flies_by_the_profile_no_trim_is_no_go() -> None:
    card = load_card("crew_ice").card
    slow = step(doublet("elevator", "2 deg"), condition={"speed": "30 kt"})
    (said,) = beyond_flight(slow, AIRCRAFT, card)
    assert "no trim at 15.4 m/s" in said
    assert beyond_flight(slow, AIRCRAFT, card.model_copy(update={"emulate": False})) == []
    others = Limits.model_validate({"bank": "50 deg"})
    assert beyond_flight(slow, AIRCRAFT, card.model_copy(update={"emulate": False, "limits": others})) == []


def test_check_says_no_go(tmp_path, capsys) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(ICE.replace('CL_alpha = "15 %", Cm_q = "20 %"', 'Cl_p = "15 %"', 1))
    assert not print_steps(load_card(str(path)), SIGNALS)
    assert "NO-GO" in capsys.readouterr().out
    assert print_steps(load_card("crew_ice"), SIGNALS)


def test_simulate_says_what_the_elevator_cannot_do(tmp_path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(ICE.replace('amplitude = "3.5 deg"', 'amplitude = "40 deg"', 1))
    profiles = load_card(str(path))
    said = list(travel_remarks(profiles.card, profiles.aircraft))
    assert len(said) == 1
    assert said[0].startswith("TP 5, ice building up: an input of 40 deg, the elevator moves 20 deg")
    assert write_simulated(str(path), tmp_path / "a.mcap", {}, None, 1.0).remarks[0] == said[0]
