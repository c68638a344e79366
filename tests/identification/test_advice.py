"""What identify says of a multisine's lines and of the input to fly next."""

import json

import numpy as np
import pytest

from station.estimation.results import EquationFit, MethodResult
from station.identification.advice import NextInput, next_input, sifted
from station.identification.analysis import identify
from station.identification.flown import fly as refly
from station.identification.identification_json import as_json
from station.identification.input_ranking import RESIDUAL
from station.identification.preparation import flight_record
from station.identification.request import Request
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


def test_sifted_lines_give_the_derivatives_in_light_turbulence() -> None:
    card = _card("5 ft/s", MULTISINE)
    flown, record, _ = _record(card, 4)
    seen = refly(flown, record, ("split",), Request(start_s=20.0, card=card))
    made = sifted(record, {"II": record.alpha, "split": seen.alpha("split", record)}, card, "wind")
    assert not isinstance(made, str)
    found = made["split"]
    assert found.lines_hz == pytest.approx(np.arange(1, 21) / 10)
    # The tail meets the gust later: gust lines tell another story than forced ones, which are nearer to calm air's.
    assert not found.agree
    assert found.parameters["CL_alpha"][0] == pytest.approx(5.66, rel=0.04)
    assert found.parameters["Cm_alpha"][0] == pytest.approx(-1.2, abs=0.2)


def test_identify_takes_ii_and_split_from_the_sifted_lines_where_asked() -> None:
    card = _card("5 ft/s", MULTISINE)
    flown, record, _ = _record(card, 4)
    found = as_json(identify(flown, record.aircraft, Request(["II", "split", "I"], 20.0, card=card, sift=True)))
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
    by_all = identify(flown, record.aircraft, Request(["split"], 20.0, card=card)).methods["split"]
    whole, by_lines = by_all.parameter("Cm_alpha"), found["methods"]["split"]["parameters"]["Cm_alpha"]
    assert whole is not None
    assert abs(by_lines["estimate"] + 1.105) < abs(whole.value + 1.105)
    unlike = identify(flown, record.aircraft, Request(["II", "I"], 20.0, card=_card("5 ft/s"), sift=True))
    assert unlike.methods["II"].why == "lines cannot be sifted: no multisine on the card"
    assert unlike.recommended == "I"


def test_without_a_multisine_no_lines_are_sifted() -> None:
    doublet = Doublet.model_validate({"kind": "doublet", "start": "25 s", "amplitude": "3 deg", "width": "0.6 s"})
    card = _card("0 ft/s", doublet)
    _, record, _ = _record(card, 1)
    assert sifted(record, {"II": record.alpha}, card, "wind") == "no multisine on the card"
    claimed = _card("0 ft/s", MULTISINE)
    assert "no distinct lines" in str(sifted(record, {"II": record.alpha}, claimed, "wind"))


def test_the_next_input_is_for_the_poorest_derivative() -> None:
    _, record, _ = _record(_card("0 ft/s", MULTISINE), 1)
    values = {"CL_alpha": 5.6, "CL_q": 18.0, "CL_de": 0.6, "Cm_alpha": -1.3, "Cm_q": -34.0, "Cm_de": -1.7}
    errors = {name: 0.01 * abs(v) for name, v in values.items()} | {"CL_q": 6.0}
    result = MethodResult(
        "ok", "", tuple(ParamEstimate(n, v, errors[n], Status.ESTIMATED, "") for n, v in values.items())
    )
    made = next_input(record, result)
    assert isinstance(made, NextInput)
    assert made.poorest == "CL_q"
    assert made.relative == pytest.approx(12 / 19.97)
    predicted = [one.relative["CL_q"] for one in made.ranking]
    assert predicted == sorted(predicted)
    # Errors are proportional to the equations' residuals.
    quiet = next_input(record, result, {"CZ": EquationFit(0.99, 0.001), "Cm": EquationFit(0.99, 0.001)})
    assert isinstance(quiet, NextInput)
    assert quiet.ranking[0].relative["CL_q"] == pytest.approx(predicted[0] * 0.001 / RESIDUAL["CL"])
    assert quiet.ranking[0].name in {one.name for one in made.ranking}
    unknown = next_input(record, None)
    assert isinstance(unknown, NextInput)
    assert unknown.relative == np.inf
