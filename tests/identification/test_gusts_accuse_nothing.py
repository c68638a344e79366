"""Instruments and surfaces of sound flights in gusts are not doubted, and late ones are told as late as they are."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from station.estimation.flight_record import FlightRecord
from station.identification.by_input import by_input, is_flown
from station.identification.instrument_bias import biases, out_of_time
from station.identification.instrument_table import GUSTED, InstrumentTable, instrument_table
from station.identification.preparation import prepare
from station.identification.request import Request
from station.log import Table
from station.profile import Card, load_aircraft
from station.simulation.sensors import STANDARD
from station.simulation.sortie import fly

AIRCRAFT = load_aircraft("twin_otter")
DOUBLETS = {"kind": "doublet", "start": "25 s", "repeat": "20 s", "amplitude": "3 deg", "width": "0.8 s"}
MULTISINE = {"kind": "multisine", "start": "25 s", "duration": "30 s", "amplitude": "2 deg"}


def flown(flight: dict[str, Any], inputs: dict[str, str], seed: int, late: float = 0.0) -> FlightRecord:
    flight = {"speed": "110 kt", "altitude": "2500 ft", **flight}
    card = Card.model_validate(
        {"name": "t", "aircraft": "twin_otter", "rig": "", "flight": flight, "manoeuvres": [inputs]}
    )
    sensors = {**STANDARD, "elevator": replace(STANDARD["elevator"], latency=late)}
    shown, truth = fly(AIRCRAFT, sensors, card, 90.0, seed)
    table = Table(truth["time"], {**shown, "thrust": truth["thrust"]}, AIRCRAFT, 0)
    return prepare(table, AIRCRAFT, Request(("split+gust",), 10.0, card=card)).record


@pytest.mark.parametrize("late", [0.0, 0.04])
@pytest.mark.parametrize("seed", [1, 3])
def test_an_elevator_is_as_late_in_gusts_as_it_is(seed: int, late: float) -> None:
    """Gusts that the vane shows at the boom moved the moment as a late elevator does: 30 to 40 ms came out."""
    found = out_of_time(flown({"gust_sigma": "7 ft/s"}, DOUBLETS, seed, late), "wind")
    assert found.keys() == ({"elevator"} if late else set())
    if late:
        assert found["elevator"].late == pytest.approx(late, abs=0.015)


def test_a_sideslip_vane_that_only_gusts_move_is_not_held_against_a_motion_that_answers_them() -> None:
    """Nor is an aileron late that only levels the wings. Both were doubted in six of ten such flights."""
    record = flown({"turbulence": "light", "field": "plane"}, MULTISINE, 1)
    table = instrument_table(record)
    assert isinstance(table, InstrumentTable)
    (vane,) = (row for row in table.rows if row.signal == "beta_vane")
    assert vane.lag.why == vane.scale.why == GUSTED
    words = biases(record, table, "wind", by_input(record, "wind", longitudinal=False)).words
    assert not {"beta_vane", "aileron"} & set(words.split())
    assert is_flown(record, ("elevator",), "q")
    assert not is_flown(record, ("aileron", "rudder"), "r")
