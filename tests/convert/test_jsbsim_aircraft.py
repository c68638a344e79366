"""A profile written for JSBSim flies there as it flies here."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import jsbsim
import numpy as np
import pytest

from station.convert.jsbsim_aircraft import THRUST, to_jsbsim, write_jsbsim
from station.profile import Aircraft, Flight, load_aircraft
from station.rows import UsageError
from station.simulation import Simulation
from station.simulation.airframe import find_trim

FT, LBF, PSF = 0.3048, 4.4482216152605, 47.88025898
SECONDS, FINE = 10, 800
LATITUDE = 45.5
"""deg, where JSBSim's gravity is the station's standard one to 0.01 %."""


def loaded(aircraft: Aircraft, folder: Path) -> Any:
    write_jsbsim(aircraft, folder / "aircraft" / aircraft.name / f"{aircraft.name}.xml", "A test's aircraft -- flown.")
    sim = jsbsim.FGFDMExec(str(folder))
    sim.set_debug_level(0)
    sim.set_dt(1 / FINE)  # before its filters are made
    assert sim.load_model(aircraft.name)
    return sim


@pytest.mark.parametrize(("name", "speed"), [("twin_otter", 60.0), ("hfb320", 104.67)])
def test_a_doublet_is_flown_in_jsbsim_as_in_the_station(name: str, speed: float, tmp_path: Path) -> None:
    """Both from our trim, with the same constant thrust, at the same actuators; the quasi-steady aircraft. Steps of two
    integrators, and an elevator late by a part of a step, leave 1 % of the range. hfb320 has a thrust line apart from
    the CG and speed derivatives."""
    aircraft = load_aircraft(name)
    quasi = aircraft.unsteady.model_copy(update={"memory": False})
    aircraft = aircraft.model_copy(update={"unsteady": quasi, "air_density": None})
    height, size, limit = 1000.0, math.radians(2), aircraft.elevator.position_limit
    trim = find_trim(aircraft, speed, height)

    def doublet(t: Any) -> Any:
        return size * (((t >= 1) & (t < 1.8)) * 1.0 - ((t >= 1.8) & (t < 2.6)) * 1.0)

    sim = loaded(aircraft, tmp_path)
    settings = {
        "ic/lat-geod-deg": LATITUDE, "ic/h-sl-ft": height / FT, "ic/vt-fps": speed / FT, "ic/gamma-deg": 0.0,
        "ic/alpha-rad": trim.alpha, "fcs/elevator-cmd-norm": trim.elevator / limit, THRUST: trim.thrust / LBF,
    }  # fmt: skip
    for key, value in settings.items():
        sim[key] = value
    sim.run_ic()
    read = {"q": ("velocities/q-rad_sec", 1.0), "alpha": ("aero/alpha-rad", 1.0), "theta": ("attitude/theta-rad", 1.0),
            "airspeed": ("velocities/vt-fps", FT), "CL": ("aero/CL", 1.0), "Cm": ("aero/Cm", 1.0)}  # fmt: skip
    rows = []
    for k in range(SECONDS * FINE):
        sim["fcs/elevator-cmd-norm"] = (trim.elevator + doublet(np.float64(k / FINE))) / limit
        if k % 4 == 0:
            rows.append([sim[key] * unit for key, unit in read.values()])
        sim.run()
    theirs = dict(zip(read, np.array(rows).T, strict=True))
    flight = Flight().model_copy(update={"speed": speed, "altitude": height, "gust_sigma": 0.0})
    half_steps = doublet(np.arange(400 * SECONDS + 1) / 400)
    ours = Simulation(aircraft, flight, hold=False, deflection=half_steps).advance(200 * SECONDS)
    for signal in ("q", "alpha", "theta", "CL"):
        assert np.abs(theirs[signal] - ours[signal]).max() < 0.01 * np.ptp(ours[signal]), signal
    assert np.abs(theirs["airspeed"] - ours["airspeed"]).max() < 0.002 * speed


def test_lateral_moments_are_the_profile_s(tmp_path: Path) -> None:
    """In sideslip, rolling and yawing, with both surfaces out: qbar S b times the derivatives, by hand; JSBSim's
    forces are those of the state a step of 1/800 s before."""
    aircraft = load_aircraft("twin_otter")
    sim = loaded(aircraft, tmp_path)
    moved = {"beta": 0.05, "p": 0.1, "r": -0.08}
    for key, value in {
        "ic/h-sl-ft": 3000.0, "ic/vt-fps": 200.0, "ic/alpha-rad": 0.0, "ic/beta-rad": moved["beta"],
        "ic/p-rad_sec": moved["p"], "ic/r-rad_sec": moved["r"],
    }.items():  # fmt: skip
        sim[key] = value
    sim.run_ic()
    surfaces = {"da": sim["fcs/aileron-pos-rad"], "dr": sim["fcs/rudder-pos-rad"]}
    for name in ("aileron", "rudder"):
        sim[f"fcs/{name}-cmd-norm"] = 0.3
    for _ in range(FINE // 2):
        sim.run()
    surfaces = {"da": sim["fcs/aileron-pos-rad"], "dr": sim["fcs/rudder-pos-rad"]}
    assert surfaces["da"] == pytest.approx(0.3 * aircraft.aileron.position_limit, rel=0.01)
    half = aircraft.geometry.span / (2 * sim["velocities/vt-fps"] * FT)
    state = {
        "beta": sim["aero/beta-rad"], "p": half * sim["velocities/p-aero-rad_sec"],
        "r": half * sim["velocities/r-aero-rad_sec"], **surfaces,
    }  # fmt: skip
    force = sim["aero/qbar-psf"] * PSF * aircraft.geometry.wing_area
    for c, key, length in (
        ("CY", "forces/fby-aero-lbs", 1.0), ("Cl", "moments/l-aero-lbsft", FT), ("Cn", "moments/n-aero-lbsft", FT),
    ):  # fmt: skip
        expected = force * sum(aircraft.value(f"{c}_{n}") * x for n, x in state.items())
        if c != "CY":
            expected *= aircraft.geometry.span
        assert sim[key] * LBF * length == pytest.approx(expected, rel=1e-3), c


def test_what_is_not_carried_is_said_in_the_file() -> None:
    aircraft = load_aircraft("twin_otter")
    text = to_jsbsim(aircraft, "Extended -- by a test.")
    assert ElementTree.fromstring(text).tag == "fdm_config"
    assert "unsteady lift" in text
    assert "the boom and its vane" in text
    assert "Cl: the profile gives none" in to_jsbsim(load_aircraft("hfb320"), "")


def test_a_profile_without_inertia_and_a_file_that_is_there_are_refused(tmp_path: Path) -> None:
    aircraft = load_aircraft("twin_otter")
    bare = aircraft.model_copy(update={"inertia": aircraft.inertia.model_copy(update={"iyy": None})})
    with pytest.raises(UsageError, match=r"inertia\.iyy: missing"):
        write_jsbsim(bare, tmp_path / "a.xml", "")
    (tmp_path / "b.xml").write_text("mine")
    with pytest.raises(UsageError, match="never replaces"):
        write_jsbsim(aircraft, tmp_path / "b.xml", "")
