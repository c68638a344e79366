"""What identify says of a multisine's lines and of the input to fly next."""

import json

import numpy as np
import pytest

from station.estimation.results import EquationFit, MethodResult
from station.identification.advice import next_input_json, sifted_json
from station.identification.analysis import flight_record, identify
from station.identification.flown import fly as refly
from station.identification.input_ranking import RESIDUAL
from station.log import Table
from station.profile import Card, Doublet, Flight, Multisine, load_aircraft
from station.rows import ParamEstimate, Status
from station.simulation.sensors import STANDARD
from station.simulation.sortie import fly

MULTISINE = Multisine.model_validate(
    {"kind": "multisine", "start": "0 s", "amplitude": "2 deg", "duration": "10 s", "repeat": "10 s"}
)


def _record(card: Card, seed: int):
    aircraft = load_aircraft("twin_otter")
    shown, truth = fly(aircraft, STANDARD, card, 60.0, seed)
    flown = Table(truth["time"], {**shown, "thrust": truth["thrust"]}, aircraft, 0)
    return flown, *flight_record(flown.between(20.0, 60.0), aircraft)


def _card(sigma: str, *inputs) -> Card:
    flight = Flight.model_validate({"speed": "110 kt", "gust_sigma": sigma, "seed": 4})
    return Card(name="test", aircraft="twin_otter", rig="", flight=flight, manoeuvres=inputs)


def test_sifted_lines_of_a_flight_in_light_turbulence() -> None:
    card = _card("5 ft/s", MULTISINE)
    flown, record, _ = _record(card, 4)
    seen = refly(flown, record, ("split",), 20.0, "wind", card, (0.0, 0.0, 0.0), None, False)
    made = sifted_json(record, {"II": record.alpha, "split": seen.alpha("split", record)}, card, "wind")
    json.dumps(made, allow_nan=False)
    assert made["status"] == "ok"
    found = made["methods"]["split"]
    assert found["lines_hz"] == pytest.approx(np.arange(1, 21) / 10)
    # The tail meets the gust later: gust lines tell another story than forced ones, which are nearer to calm air's.
    assert not found["agree"]
    assert found["parameters"]["CL_alpha"]["estimate"] == pytest.approx(5.66, rel=0.04)
    assert found["parameters"]["Cm_alpha"]["estimate"] == pytest.approx(-1.2, abs=0.2)


def test_identify_takes_ii_and_split_from_the_sifted_lines_where_asked() -> None:
    card = _card("5 ft/s", MULTISINE)
    flown, record, _ = _record(card, 4)
    found = identify(flown, record.aircraft, ["II", "split", "I"], 20.0, card=card, sift=True)
    json.dumps(found, allow_nan=False)
    for name in ("II", "split"):
        made = found["methods"][name]
        assert made["status"] == "ok"
        assert made["settings"]["sifted_lines_hz"] == pytest.approx(np.arange(1, 21) / 10)
        lines = found["sifted"]["methods"][name]["parameters"]
        for derivative, p in made["parameters"].items():
            assert p["estimate"] == lines[derivative]["estimate"]
    assert "sifted_lines_hz" not in found["methods"]["I"]["settings"]
    # Lines that the gusts do not drive: nearer to calm air's than all lines together.
    whole = identify(flown, record.aircraft, ["split"], 20.0, card=card)["methods"]["split"]["parameters"]
    sifted = found["methods"]["split"]["parameters"]
    assert abs(sifted["Cm_alpha"]["estimate"] + 1.105) < abs(whole["Cm_alpha"]["estimate"] + 1.105)
    unlike = identify(flown, record.aircraft, ["II", "I"], 20.0, card=_card("5 ft/s"), sift=True)
    assert unlike["methods"]["II"]["why"] == "lines cannot be sifted: no multisine on the card"
    assert unlike["recommended"] == "I"


def test_no_multisine_no_sifting() -> None:
    doublet = Doublet.model_validate({"kind": "doublet", "start": "25 s", "amplitude": "3 deg", "width": "0.6 s"})
    card = _card("0 ft/s", doublet)
    _, record, _ = _record(card, 1)
    assert sifted_json(record, {"II": record.alpha}, card, "wind")["why"] == "no multisine on the card"
    claimed = _card("0 ft/s", MULTISINE)
    assert "do not stand out" in sifted_json(record, {"II": record.alpha}, claimed, "wind")["why"]


def test_the_next_input_is_for_the_poorest_derivative() -> None:
    _, record, _ = _record(_card("0 ft/s", MULTISINE), 1)
    values = {"CL_alpha": 5.6, "CL_q": 18.0, "CL_de": 0.6, "Cm_alpha": -1.3, "Cm_q": -34.0, "Cm_de": -1.7}
    errors = {name: 0.01 * abs(v) for name, v in values.items()} | {"CL_q": 6.0}
    result = MethodResult(
        "ok", "", tuple(ParamEstimate(n, v, errors[n], Status.ESTIMATED, "") for n, v in values.items())
    )
    made = next_input_json(record, result)
    assert made["poorest"] == "CL_q"
    assert made["relative_2sd"] == pytest.approx(12 / 19.97)
    predicted = [one["predicted_relative_2sd"] for one in made["ranking"]]
    assert predicted == sorted(predicted)
    assert len(predicted) == 5
    # Errors are as large as the equations' residuals.
    quiet = next_input_json(record, result, {"CZ": EquationFit(0.99, 0.001), "Cm": EquationFit(0.99, 0.001)})
    usual = {one["input"]: one["predicted_relative_2sd"] for one in made["ranking"]}
    assert quiet["ranking"][0]["predicted_relative_2sd"] == pytest.approx(predicted[0] * 0.001 / RESIDUAL["CL"])
    assert quiet["ranking"][0]["input"] in usual
    json.dumps(next_input_json(record, None), allow_nan=False)
