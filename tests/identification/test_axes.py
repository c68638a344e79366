"""Wind and body axes: one moment, one error of it."""

from __future__ import annotations

import numpy as np
import pytest

from station.identification.analysis import identify
from station.identification.request import Request
from station.log import Table
from station.profile import Card, Doublet, Flight, load_aircraft, load_rig
from station.simulation.sortie import fly

AIRCRAFT, RIG = load_aircraft("twin_otter"), load_rig("bench")
METHODS = ["II", "split", "split+gust"]


@pytest.mark.parametrize("sigma", ["0 ft/s", "5 ft/s"])
def test_the_moment_and_its_error_do_not_depend_on_the_axes_of_the_force(sigma: str) -> None:
    """CZ_alpha is -(CL_alpha + CD) at small angles: only the drag differs. The moment's equation is the same one;
    what unsteady lift does to it goes by the lift, whichever sign the force has."""
    gusts = Flight.model_validate({"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": sigma})
    doublet = Doublet.model_validate({"kind": "doublet", "start": "32 s", "amplitude": "3.5 deg", "width": "1.3 s"})
    card = Card(name="t", aircraft="t", rig="bench", flight=gusts, manoeuvres=(doublet,))
    shown, _ = fly(AIRCRAFT, RIG, card, 50.0, 1)
    table = Table(np.arange(len(shown["q"])) * 0.02, shown, AIRCRAFT, 0)
    wind, body = (
        identify(table, AIRCRAFT, Request(METHODS, 30.0, axes=axes, card=card, noise=RIG.noise_si())).methods
        for axes in ("wind", "body")
    )
    for method in METHODS:
        for name in ("Cm_alpha", "Cm_q", "Cm_de"):
            one, other = wind[method].parameter(name), body[method].parameter(name)
            assert one is not None
            assert other is not None
            assert other.value == pytest.approx(one.value, rel=1e-6)
            # The short period that the error is reckoned with has CD beside CL_alpha.
            assert other.sd == pytest.approx(one.sd, rel=0.05), (method, name)
        lift, down = wind[method].parameter("CL_alpha"), body[method].parameter("CZ_alpha")
        assert lift is not None
        assert down is not None
        assert down.sd == pytest.approx(lift.sd, rel=0.1)
