"""Elevator, aileron and rudder moved at once by orthogonal multisines: each axis is known as if flown alone."""

from collections import defaultdict

import numpy as np
import pytest

from station.conventions import LATERAL, LONGITUDINAL
from station.identification.analysis import identify
from station.identification.request import Request
from station.log import Table
from station.profile import Card, Flight, Multisine, load_aircraft
from station.simulation.sensors import STANDARD
from station.simulation.sortie import fly


def _multisine(surface: str, amplitude: str) -> Multisine:
    same = {"kind": "multisine", "start": "30 s", "duration": "20 s", "repeat": "20 s", "high": "1.5 Hz"}
    return Multisine.model_validate({**same, "surface": surface, "amplitude": amplitude})


THREE = (_multisine("elevator", "2 deg"), _multisine("aileron", "4 deg"), _multisine("rudder", "4 deg"))


def _identified(inputs, sigma: str, seed: int, *methods: str, sift: bool = False):
    aircraft = load_aircraft("twin_otter")
    flight = Flight.model_validate({"speed": "110 kt", "gust_sigma": sigma, "seed": seed})
    card = Card(name="test", aircraft="twin_otter", rig="", lateral=True, flight=flight, manoeuvres=inputs)
    shown, truth = fly(aircraft, STANDARD, card, 90.0, seed)
    flown = Table(truth["time"], {**shown, "thrust": truth["thrust"]}, aircraft, 0)
    return identify(flown, aircraft, Request(methods, 30.0, card=card, sift=sift))


@pytest.mark.slow
def test_lines_of_every_axis_are_sifted_apart() -> None:
    """In calm air the profile's lateral derivatives, which the quasi-steady equations have as they are, come out."""
    found = _identified(THREE, "0 ft/s", 5, "II", sift=True)
    made = found.methods["II"]
    assert made.status == "ok", made.why
    assert isinstance(found.sifted, dict)
    # 0.1 to 1.5 Hz by 0.05 Hz: the elevator's ten lines, and the nineteen of aileron and rudder.
    assert found.sifted["II"].lines_hz == pytest.approx(np.arange(2, 31) / 20)
    for name in ("CY_beta", "CY_r", "CY_dr", "Cl_beta", "Cl_p", "Cl_r", "Cl_da", "Cn_beta", "Cn_p", "Cn_r", "Cn_dr"):
        p = made.parameter(name)
        assert p is not None
        assert p.value == pytest.approx(found.aircraft.value(name), rel=0.01), name
    alpha = made.parameter("CL_alpha")
    assert alpha is not None
    assert alpha.value == pytest.approx(found.aircraft.value("CL_alpha"), rel=0.02)


@pytest.mark.slow
def test_one_manoeuvre_tells_as_much_as_two() -> None:
    """In light turbulence: against an elevator manoeuvre, and one of aileron and rudder, each as long as the one.

    By the median of three flights: in one of twenty an instrument is doubted by chance, and every interval holds that.
    """
    rows: dict[str, list[float]] = defaultdict(list)
    for seed in (10, 11, 12):
        one = _identified(THREE, "5 ft/s", seed, "split", "physical").methods
        flown = {
            "longitudinal": _identified(THREE[:1], "5 ft/s", seed, "split", "physical").methods,
            "lateral": _identified(THREE[1:], "5 ft/s", seed, "split").methods,
        }
        for axis, method, names in (("longitudinal", "physical", LONGITUDINAL), ("lateral", "split", LATERAL)):
            for name in names:
                a, b = one[method].parameter(name), flown[axis][method].parameter(name)
                assert a is not None
                assert b is not None
                assert abs(a.value - b.value) < 2 * np.hypot(a.sd, b.sd), name
                rows[name].append(a.sd / b.sd)
    # Of the same power as alone, so of like intervals; at worst a derivative rests on the number of lines, of which the
    # elevator has 10 for the 29 that it has alone.
    of_each = [float(np.median(r)) for r in rows.values()]
    assert np.median(of_each) < 1.1
    assert max(of_each) < np.sqrt(29 / 10)
