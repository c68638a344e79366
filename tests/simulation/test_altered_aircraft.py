"""Flights of an aircraft that changes: what it becomes is what a profile with that number is from the start on."""

from __future__ import annotations

import math

import numpy as np
import pytest

from station.profile import Aircraft, AlteredAircraft, Card, load_aircraft, load_card
from station.profile.profile_changes import cg_aft, icing
from station.rows import ProfileError
from station.simulation import Simulation, fly
from station.simulation.airframe import find_trim
from station.simulation.sortie import source_of

FAR = 150.0
"""s: thirty of the time constants with which the pilot retrims, and six of those of the phugoid, after the change."""
DOUBLET = {"kind": "doublet", "start": f"{FAR} s", "width": "1 s", "amplitude": "3.5 deg"}


def card(truth: dict[str, object], *manoeuvres: dict[str, object], **flight: object) -> Card:
    words = {"name": "t", "aircraft": "twin_otter", "rig": "bench", "manoeuvres": list(manoeuvres)}
    return Card.model_validate({**words, "flight": {**flight, "truth": truth}})


def altered(**truth: dict[str, object]) -> AlteredAircraft:
    return AlteredAircraft(load_aircraft("twin_otter"), card(truth).flight.truth)


def iced() -> Aircraft:
    return icing(load_aircraft("twin_otter"), 1.0)


def test_ends_as_the_aircraft_that_it_has_become() -> None:
    """Calm air: trim by trim's equations, and a doublet's answer as that of an aircraft which began so."""
    truth = {"icing": {"at": ["1 s", "31 s"], "value": [0.0, 1.0]}}
    flown = source_of(load_aircraft("twin_otter"), card(truth, DOUBLET)).advance(200 * 155)
    whole = source_of(iced(), card({}, DOUBLET)).advance(200 * 155)
    trim = find_trim(iced(), 56.59, 762.0)
    before = slice(200 * 149, 200 * 150)
    assert flown["alpha"][before].mean() == pytest.approx(trim.alpha, abs=math.radians(0.02))
    assert flown["elevator"][before].mean() == pytest.approx(trim.elevator, abs=math.radians(0.001))
    assert flown["thrust"][before].mean() == pytest.approx(trim.thrust, rel=0.02)
    began = flown["alpha"][before].mean() - whole["alpha"][before].mean()
    answer = slice(200 * 150, 200 * 155)
    apart = flown["alpha"][answer] - began - whole["alpha"][answer]
    # The clean aircraft answers by 8 % more; what is left of the phugoid moves both by less than a thousandth of a rad.
    clean = source_of(load_aircraft("twin_otter"), card({}, DOUBLET)).advance(200 * 155)
    still = (
        clean["alpha"][answer] - clean["alpha"][before].mean() - whole["alpha"][answer] + whole["alpha"][before].mean()
    )
    assert np.abs(apart).max() < 0.2 * np.abs(still).max()


def test_without_a_change_nothing_does() -> None:
    held = {"drag.zero_lift": {"at": ["5 s"], "factor": [1.0]}}
    whole = Simulation(load_aircraft("twin_otter"), card({}, gust_sigma="5 ft/s").flight).advance(4000)
    same = Simulation(load_aircraft("twin_otter"), card(held, gust_sigma="5 ft/s").flight).advance(4000)
    for name in ("alpha_vane", "q", "az", "airspeed"):
        np.testing.assert_allclose(same[name], whole[name], rtol=0, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("surface", ["elevator", "rudder"])
def test_the_same_bits_in_any_chunks(surface: str) -> None:
    truth = {"derivatives": {"CL_alpha": {"at": ["2 s", "9 s"], "factor": [1.0, 0.8]}}}
    flown = card(truth, {**DOUBLET, "start": "3 s", "surface": surface}, gust_sigma="5 ft/s")
    whole = source_of(load_aircraft("twin_otter"), flown).advance(2000)
    pieces = source_of(load_aircraft("twin_otter"), flown)
    parts = [pieces.advance(n) for n in (1, 19, 7, 373, 1, 399, 1200)]
    for name in ("alpha_vane", "q", "az", "airspeed", "beta_vane"):
        np.testing.assert_array_equal(np.concatenate([p[name] for p in parts]), whole[name], err_msg=name)


def test_what_changed_is_recorded_as_truth() -> None:
    truth = {
        "inertia.mass": {"at": ["0 s", "10 s"], "value": ["4900 kg", "4800 kg"]},
        "instruments.alpha_vane.bias": {"at": ["4 s", "4.5 s"], "value": [0.0, 0.02]},
    }
    shown, true = fly(load_aircraft("twin_otter"), {}, card(truth), 10.0)
    np.testing.assert_allclose(true["inertia.mass"], 4900 - 10 * true["time"], atol=1e-9)
    np.testing.assert_allclose(true["mass"], true["inertia.mass"], atol=1.0)  # renewed every 0.1 s: 1 kg
    off = shown["alpha_vane"] - true["alpha_vane"]
    assert np.abs(off[: 4 * 50]).max() < 1e-12
    np.testing.assert_allclose(off[5 * 50 :], 0.02, atol=1e-12)


def test_patterns_are_the_catalogue_s() -> None:
    """cg_aft and icing, stated of an aircraft elsewhere: moments about the CG, and the reference icing condition."""
    made = altered(cg_aft={"at": ["0 s", "10 s"], "value": ["0 m", "0.2 m"]}).at(5.0)
    assert made == cg_aft(load_aircraft("twin_otter"), 0.1)
    ice = altered(icing={"at": ["0 s", "10 s"], "value": [0.0, 1.0]}).at(10.0)
    assert ice.value("CL_alpha") == pytest.approx(0.9 * 5.66)
    assert ice.drag is not None
    assert ice.drag.zero_lift == pytest.approx(1.5 * 0.04)


@pytest.mark.parametrize(
    ("key", "change", "words"),
    [
        ("drag.zero_lif", {"at": ["0 s"], "factor": [1.1]}, "did you mean zero_lift?"),
        ("drag", {"at": ["0 s"], "factor": [1.1]}, "not a number"),
        ("inertia.mass", {"at": ["0 s"], "value": [4900.0]}, "missing unit"),
        ("inertia.mass", {"at": ["0 s"], "value": ["-3 kg"]}, "greater than 0"),
        ("derivatives.CL_alpha2", {"at": ["0 s"], "factor": [1.1]}, "no such number to multiply"),
        ("derivatives.CL_alfa", {"at": ["0 s"], "value": [1.1]}, "did you mean CL_alpha?"),
        ("derivatives.CL_alfa", {"at": ["0 s"], "factor": [1.1]}, "unknown derivative CL_alfa; did you mean CL_alpha?"),
        ("instruments.airspeeed.bias", {"at": ["0 s"], "factor": [1.1]}, "did you mean airspeed?"),
        ("derivatives.CL_alpha.sd", {"at": ["0 s"], "value": [1.1]}, "it is not flown"),
        ("unsteady.memory", {"at": ["0 s"], "value": [1.0]}, "bool"),
        ("instruments.q.latency", {"at": ["0 s"], "value": ["0.1 s"]}, "gain, bias, cubic"),
        ("icing", {"at": ["0 s"], "factor": [1.1]}, "no such number to multiply: write value"),
    ],
)
def test_what_cannot_change_is_said_with_its_key(key: str, change: dict[str, object], words: str) -> None:
    with pytest.raises(ProfileError, match=r"flight\.truth") as caught:
        altered(**{key: change})
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"at": ["0 s", "0 s"], "factor": [1, 2]}, "the times must increase"),
        ({"at": ["0 s"], "factor": [1, 2]}, "the same number of entries"),
        ({"at": ["0 s"]}, "either factor or value"),
        ({"at": [0.0], "factor": [1.0]}, "missing unit"),
        (0.9, "write { at ="),
    ],
)
def test_a_change_written_wrong(change: object, words: str) -> None:
    with pytest.raises(ProfileError) as caught:
        load_card("bench", {"flight.truth.drag.zero_lift": change})
    assert words in str(caught.value)


def test_an_aircraft_that_cannot_be_trimmed_is_refused_before_the_flight() -> None:
    truth = {"inertia.mass": {"at": ["0 s", "60 s"], "factor": [1.0, 40.0]}}
    with pytest.raises(ProfileError, match=r"flight.truth, 60 s of flight: .*no trim"):
        source_of(load_aircraft("twin_otter"), card(truth))


def test_a_card_with_changes_survives_the_recording() -> None:
    flown = card({"derivatives": {"CL_alpha": {"at": ["2 s", "9 s"], "factor": [1.0, 0.8]}}})
    assert Card.model_validate_json(flown.model_dump_json(), context="si") == flown
