"""A profile that says what it knows exactly: that is not estimated, and what shows besides is named sooner."""

from __future__ import annotations

import pytest
from blind import BIASES, MODEL_BIASES, SIGMAS, Case, aircraft, records
from known import surely

from station.diagnosis.free_parameters import free_parameters
from station.diagnosis.procedure import diagnose
from station.profile import Calibrated, load_aircraft
from station.profile.profile_text import to_toml

OF_THE_DAY = {**{f"{n}_zero": x for n, x in BIASES.items()}, **MODEL_BIASES}
"""What the flights draw anew, as the profile then states it."""


@pytest.mark.parametrize("name", ["twin_otter", "attas"])
def test_nothing_is_free_where_everything_is_known(name):
    """Of an aircraft whose boom is not stated, the place of the vane stays unknown."""
    known = surely(load_aircraft(name))
    assert free_parameters(known, 56.6) == []
    assert free_parameters(known, 56.6, mass_recorded=True) == []


def test_a_derivative_without_an_error_is_known_and_the_others_are_not():
    plain = aircraft()
    sure = plain.derivatives["CL_q"].model_copy(update={"sd": 0.0})
    known = plain.model_copy(update={"derivatives": {**plain.derivatives, "CL_q": sure}})
    left = [f.name for f in free_parameters(plain, 56.6)]
    assert [f.name for f in free_parameters(known, 56.6)] == [n for n in left if n != "CL_q"]


def test_every_constant_can_be_known_by_itself():
    """One key at nought after the other: each takes what it is about, and nothing else, out of the fit."""
    plain = aircraft()
    every = {f.name for f in free_parameters(plain, 56.6)} | {f.name for f in free_parameters(plain, 56.6, True)}
    about = {"CL_0": {"CL_0"}, "Cm_0": {"Cm_0"}, "CD_0": {"CD_0"}, "induced_drag": {"induced drag"},
             "thrust": {"thrust scale"}, "vane_zero": {"vane zero"}, "theta_zero": {"theta bias"},
             "q_zero": {"q bias"}, "ax_zero": {"ax bias"}, "az_zero": {"az bias"}}  # fmt: skip
    for key, names in about.items():
        doubt = plain.uncertainty.model_copy(update={key: 0.0})
        left = {f.name for f in free_parameters(plain.model_copy(update={"uncertainty": doubt}), 56.6)}
        assert every - left == names, key


def test_a_calibrated_upwash_is_as_uncertain_as_its_calibration():
    """Without one, the vane's scale is uncertain by the wing's share; a flight that told the sum leaves the share open
    and the sum not."""
    plain = aircraft()
    doubt = plain.uncertainty.model_copy(update={"vane_scale": 0.008, "dynamic_pressure": 0.006})
    told = Calibrated.model_validate(
        {
            "date": "2026-01-01",
            "recordings": ["a.mcap"],
            "lowest_speed": "45 m/s",
            "highest_speed": "70 m/s",
            "upwash_sd": 0.01,
        }
    )
    known = plain.model_copy(update={"uncertainty": doubt, "calibrated": told})
    frees = {f.name: f for f in free_parameters(known, 56.6)}
    assert frees["vane scale"].sd == 0.008
    share = frees["upwash wing"].extend(known, 0.03)
    assert plain.boom is not None
    assert share.boom is not None
    assert share.boom.upwash_wing == pytest.approx(plain.boom.upwash_wing + 0.03)
    assert share.boom.steady_calibration == pytest.approx(plain.boom.steady_calibration)
    pitot = frees["dynamic pressure"]
    assert pitot.sd == 0.006
    high = pitot.extend(known, 0.006).instruments
    assert high["dynamic_pressure"].gain == pytest.approx(1.006)
    assert high["airspeed"].gain ** 2 == pytest.approx(1.006)
    assert "dynamic pressure" not in {f.name for f in free_parameters(plain, 56.6)}


def test_what_is_known_is_written_and_read_back(tmp_path):
    known = surely(aircraft(), az_zero=0.02, drift=0.3)
    path = tmp_path / "known.toml"
    path.write_text(to_toml(known, "all known"))
    assert load_aircraft(str(path)) == known


@pytest.mark.slow
@pytest.mark.parametrize(("name", "value"), [("mass.scale", 0.06), ("inertia.scale", 0.12), ("elevator.scale", 0.2)])
def test_what_no_handbook_excludes_is_found_where_the_profile_is_sure(name, value):
    """The sizes that are no finding by the profile as shipped (test_blind_diagnosis)."""
    fit, kept = records(Case(seed=941, sigma=SIGMAS[1], effects={name: value}, hold_out=("multisine",)))
    d = diagnose(fit, kept, surely(aircraft(), **OF_THE_DAY))
    assert [e.term.id for e in d.effects] == [name]
    assert d.effects[0].ci95[0] < value < d.effects[0].ci95[1]
