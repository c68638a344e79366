"""Standard errors of methods that go by the vane, in gusts that the vane meets before the CG does."""

from __future__ import annotations

import math

import numpy as np
import pytest

from station.conventions import LONGITUDINAL
from station.estimation.acceptance import UNEXPLAINED, worded
from station.estimation.results import MethodResult, not_applicable, widened
from station.identification.analysis import identify
from station.identification.identification_json import as_json
from station.identification.request import Request
from station.log import Table
from station.profile import Card, Doublet, Flight, load_aircraft, load_rig
from station.rows import ParamEstimate, Status
from station.simulation.sortie import fly

AIRCRAFT, RIG = load_aircraft("twin_otter"), load_rig("bench")


def test_an_error_holds_the_distance_from_the_witness_and_the_witness_s_own() -> None:
    mine = (
        ParamEstimate("CL_alpha", 5.0, 0.3, Status.ESTIMATED),
        ParamEstimate("CL_q", 30.0, 4.0, Status.ESTIMATED),
        ParamEstimate("CY_da", -0.042, 0.008, Status.ESTIMATED),
        ParamEstimate("Cm_q", math.nan, math.nan, Status.INVALID, "no iyy"),
        ParamEstimate("Cl_p", -0.034, 0.021, Status.ESTIMATED),
        ParamEstimate("Cl_beta", -0.1, 0.02, Status.ESTIMATED),
    )
    theirs = (
        ParamEstimate("CL_alpha", 5.4, 1.2, Status.ESTIMATED),
        ParamEstimate(
            "CL_q", 10.0, 1.0, Status.INVALID, "collinear with the other regressors (VIF > 100): vary the input"
        ),
        ParamEstimate(
            "CY_da", 0.001, 0.003, Status.UNESTIMATED, "not significant: 2 sigma > estimate and profile value"
        ),
        ParamEstimate("Cl_p", -0.257, 0.327, *worded(UNEXPLAINED + 12)),
        ParamEstimate("Cl_beta", 0.3, 0.1, Status.INVALID, "the sideslip vane stands still"),
    )
    found = widened(MethodResult("ok", "", mine), MethodResult("ok", "", theirs), "split")
    assert found.parameters[0].sd == pytest.approx(1.3)  # 0.3, 0.4, 1.2
    assert found.parameters[0].value == 5.0
    # A collinear one has a wide error, and that says so.
    assert found.parameters[1].sd == pytest.approx(math.hypot(4.0, 20.0, 1.0))
    assert found.statistical == {"CL_alpha": 0.3, "CL_q": 4.0, "CY_da": 0.008, "Cl_p": 0.021}
    assert found.parameters[2].sd == pytest.approx(math.hypot(0.008, 0.043, 0.003))
    assert found.parameters[3] == mine[3]
    # Gusts that leave the witness next to nothing to explain are why the other is wrong.
    assert found.parameters[4].sd == pytest.approx(math.hypot(0.021, 0.223, 0.327))
    assert found.parameters[5] == mine[5]
    # Its status goes by the error that it has then: 2 x 0.044 is more than 0.042.
    judged = widened(MethodResult("ok", "", mine), MethodResult("ok", "", theirs), "split", AIRCRAFT)
    assert [p.status for p in judged.parameters[:3]] == [Status.ESTIMATED, Status.UNESTIMATED, Status.UNESTIMATED]
    assert judged.parameters[2].why == "not significant: 2 sigma > estimate and profile value"
    alone = widened(MethodResult("ok", "", mine[2:3]), MethodResult("ok", "", theirs[2:3]), "split", AIRCRAFT)
    assert (alone.status, alone.why) == ("not_applicable", "not significant: 2 sigma > estimate and profile value")
    assert "distance from split" in found.settings["standard_errors"]
    alone = MethodResult("ok", "", mine)
    assert widened(alone, not_applicable("none", LONGITUDINAL), "split") is alone


def flown(sigma: str, seed: int) -> tuple[Table, Card]:
    gusts = Flight.model_validate({"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": sigma})
    doublet = Doublet.model_validate({"kind": "doublet", "start": "32 s", "amplitude": "3.5 deg", "width": "1.3 s"})
    card = Card(name="t", aircraft="t", rig="bench", flight=gusts, manoeuvres=(doublet,))
    shown, _ = fly(AIRCRAFT, RIG, card, 60.0, seed)
    for name in ("thrust", "mass", "pdot", "qdot", "rdot"):
        shown.pop(name, None)
    return Table(np.arange(len(shown["q"])) * 0.02, shown, AIRCRAFT, 0), card


def made(sigma: str, seed: int, methods: list[str]) -> dict[str, dict[str, tuple[float, float]]]:
    table, card = flown(sigma, seed)
    request = Request(methods, 30.0, card=card, imu_position=RIG.imu_position, noise=RIG.noise_si())
    found = identify(table, AIRCRAFT, request).methods
    return {m: {p.name: (p.value, p.sd) for p in one.parameters} for m, one in found.items()}


def test_the_statistical_error_stands_beside_the_whole_one() -> None:
    """In gusts it is smaller, by far so for split, which leaves the late tail out; in calm air nearly the same, had the
    profile's vane, mass and inertia no error: the rest is what linear equations leave out of a manoeuvre."""
    for sigma, vane, least, most in (("5 ft/s", 1.0, 0.0, 0.5), ("0 ft/s", 0.0, 0.8, 1.0), ("0 ft/s", 1.0, 0.1, 0.85)):
        table, card = flown(sigma, 1)
        known = AIRCRAFT.uncertainty
        parts = {name: vane * getattr(known, name) for name in ("vane_scale", "vane_delay", "vane_x")}
        parts |= {"mass": 0.0, "inertia": 0.0}
        aircraft = AIRCRAFT.model_copy(update={"uncertainty": known.model_copy(update=parts)})
        request = Request(["split", "physical"], 30.0, card=card, noise=RIG.noise_si())
        found = as_json(identify(table, aircraft, request))["methods"]
        p = found["split"]["parameters"]["Cm_alpha"]
        assert least * p["std_error"] < p["std_error_statistical"] <= most * p["std_error"]
        for p in found["physical"]["parameters"].values():
            assert 0 < p["std_error_statistical"] <= p["std_error"]


@pytest.mark.slow
def test_two_standard_errors_of_filters_and_regression_cover_calm_air_s_values_in_turbulence() -> None:
    """Wanted: what split gives in calm air, 0.3 % off what a perfect angle of attack does."""
    calm = [made("0 ft/s", seed, ["split"])["split"] for seed in (21, 22, 23)]
    wanted = {n: np.mean([c[n][0] for c in calm]) for n in LONGITUDINAL}
    methods = ["I", "VI", "fe", "oe"]
    inside: dict[str, list[bool]] = {m: [] for m in methods}
    for seed in range(1, 13):
        found = made("5 ft/s", seed, methods)
        for m in methods:
            inside[m] += [abs(found[m][n][0] - wanted[n]) <= 2 * found[m][n][1] for n in LONGITUDINAL]
    # 72 each: 0.90 is four standard deviations below 0.98; by its residuals alone VI covers 0.86, fe 0.59, I 0.43.
    assert all(np.mean(hits) > 0.9 for hits in inside.values()), {m: np.mean(h) for m, h in inside.items()}
