"""A surface's sensor of the wrong scale: no other instrument shows it, and the interval holds what the profile says."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from station.identification.analysis import identify
from station.identification.by_input import Shown
from station.identification.request import Request
from station.identification.surface_scales import contradicted, wrong_by
from station.log import Table
from station.model.airframe_error import relative_errors
from station.profile import Aircraft, Card, load_aircraft
from station.simulation.sensors import STANDARD, Sensor
from station.simulation.sortie import fly

SHORT = 0.8
"""The aileron's pot over the aileron."""


def sure_to(share: float) -> Aircraft:
    aircraft = load_aircraft("twin_otter")
    return aircraft.model_copy(update={"uncertainty": aircraft.uncertainty.model_copy(update={"surface_scale": share})})


def test_derivatives_by_surfaces_alone_have_it() -> None:
    names = ("CL_alpha", "CL_de", "Cl_p", "Cl_da", "Cn_dr", "CY_dr")
    exact, unsure = (relative_errors(sure_to(share), names) for share in (0.0, 0.1))
    expected = [[math.hypot(e, 0.1) if "_d" in n else e for n, e in zip(names, row, strict=True)] for row in exact]
    np.testing.assert_allclose(unsure, expected)


def test_a_surface_turned_over_is_told_from_one_that_is_sound() -> None:
    """Its derivative is that of the profile, once as it is and once of the other sign; -1 is no scale of 1."""
    aircraft = load_aircraft("twin_otter")
    stated = {n: aircraft.value(n) for n in ("Cl_da", "Cl_beta", "Cl_p")}
    shown = {n: Shown(x, abs(x) / 50, 0.0) for n, x in stated.items()}
    assert contradicted(aircraft, shown) == {}
    turned = {**shown, "Cl_da": Shown(-stated["Cl_da"], abs(stated["Cl_da"]) / 50, 0.0)}
    found = contradicted(aircraft, turned)
    assert found["aileron"].worded("aileron") == "aileron of the wrong sign (Cl_da is -1 times the profile's)"
    assert wrong_by(found, {"Cl_da": 0.2}) == {"Cl_da": pytest.approx(0.4)}


@pytest.fixture(scope="module")
def record() -> Table:
    shape = {"kind": "multisine", "start": "30 s", "duration": "20 s", "repeat": "20 s", "high": "1.5 Hz"}
    inputs = [{**shape, "surface": surface, "amplitude": "4 deg"} for surface in ("aileron", "rudder")]
    flight = {"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": "0 ft/s"}
    card = Card.model_validate(
        {"name": "t", "aircraft": "twin_otter", "rig": "", "flight": flight, "manoeuvres": inputs, "lateral": True}
    )
    sensors = {**STANDARD, "aileron": replace(STANDARD.get("aileron", Sensor()), gain=SHORT)}
    shown, truth = fly(load_aircraft("twin_otter"), sensors, card, 70.0, 1)
    return Table(truth["time"], {**shown, "thrust": truth["thrust"]}, load_aircraft("twin_otter"), 0)


@pytest.mark.slow
@pytest.mark.parametrize(("share", "is_told"), [(0.0, True), (0.02, True), (0.15, False)])
def test_a_pot_that_is_short_is_held_by_the_interval(record: Table, share: float, is_told: bool) -> None:
    """Cl_da comes out 1/0.8 too large, and the profile's derivatives say so where its doubt of the scale is no excuse;
    15 % of it is two standard deviations of 0.3."""
    aircraft = sure_to(share)
    found = identify(record, aircraft, Request(("II", "split"), 30.0))
    assert any("aileron scale" in remark for remark in found.remarks) is is_told
    for method in ("II", "split"):
        p = next(p for p in found.methods[method].parameters if p.name == "Cl_da")
        assert p.value == pytest.approx(aircraft.value("Cl_da") / SHORT, rel=0.05), method
        assert abs(p.value - aircraft.value("Cl_da")) < 1.96 * p.sd, method
