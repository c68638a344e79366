"""Method `ml` on flights of the second simulation, whose aircraft, noise and air differ from all that the station
assumes; beside `physical`, which is fitted line by line of a spectrum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.conventions import LATERAL, LONGITUDINAL
from station.diagnosis import derivative_fit
from station.estimation.results import MethodResult
from station.identification.analysis import identify
from station.identification.identified import Identification
from station.identification.request import Request
from station.log import Table
from station.profile import Aircraft, load_aircraft
from station.rows import ParamEstimate, Status
from tests.second_simulation.flights import QUIET, Flown, flown, identify_case

GUSTY, OTHERS = 41, (17, 45)
"""Flights in 10 and 12 ft/s, at 50, 12.5 and 25 Hz."""
PROFILE = load_aircraft("twin_otter")
NEAR = ("CL_alpha", "Cm_alpha", "Cm_q", "Cm_de")
"""What an aircraft is trimmed, steered and flown by; gusts leave CL_q and CL_de nearly unknown."""


def found(flight: Flown, *methods: str, aircraft: Aircraft = PROFILE, **asked: object) -> Identification:
    return identify(Table(flight.time, flight.shown, aircraft, 0), aircraft, Request(methods, QUIET, **asked))


def off(result: MethodResult, flight: Flown, definition: str) -> np.ndarray:
    """(6,) from the truth, in standard errors; all of them called estimated."""
    told = result.parameters if definition == "derivatives" else result.quasi_steady
    assert [p.status for p in told] == [Status.ESTIMATED] * len(LONGITUDINAL)
    return np.array([(p.value - flight.answers[definition][p.name]) / p.sd for p in told])


@pytest.mark.parametrize("index", [GUSTY, *(pytest.param(k, marks=pytest.mark.slow) for k in OTHERS)])
def test_in_gusts_it_holds_both_definitions_and_is_nearer_than_one_line_by_line(index: int) -> None:
    flight = flown(identify_case(1, index))
    made = found(flight, "physical", "ml")
    assert made.recommended == "ml"
    for definition in ("derivatives", "quasi_steady"):
        assert np.abs(off(made.methods["ml"], flight, definition)).max() < 3
    ml, physical = (
        np.mean([abs(made.methods[m].parameter(n).value / flight.answers["derivatives"][n] - 1) for n in NEAR])
        for m in ("ml", "physical")
    )
    assert ml < physical


def test_what_the_profile_does_not_give_or_is_sure_of_is_found_all_the_same() -> None:
    """Without CL_q and CL_de, and with a wrong Cm_de that it calls exact."""
    flight, stated = flown(identify_case(1, GUSTY)), dict(PROFILE.derivatives)
    del stated["CL_q"]
    stated["CL_de"] = stated["CL_de"].model_copy(update={"value": 0.0})
    stated["Cm_de"] = stated["Cm_de"].model_copy(update={"value": 1.5 * stated["Cm_de"].value, "sd": 0.0})
    made = found(flight, "ml", aircraft=PROFILE.model_copy(update={"derivatives": stated})).methods["ml"]
    assert np.abs(off(made, flight, "derivatives")).max() < 3
    assert all(p.sd > 0.01 * abs(p.value) for p in made.parameters)


def test_what_it_cannot_tell_it_says() -> None:
    flight = flown(replace(identify_case(1, GUSTY), seconds=20.0))
    assert found(flight, "ml", axes="body").methods["ml"].why == "estimates wind-axes derivatives only"
    still = replace(flight, shown={**flight.shown, "elevator": 0.0 * flight.time})
    made = found(still, "ml").methods["ml"]
    assert made.status == "not_applicable"
    assert {p.status for p in made.parameters} == {Status.UNESTIMATED}
    assert "elevator" in made.why


ACROSS = 12
"""Of the 15 lateral derivatives, called estimated in 12 ft/s; by the surfaces' pulses of 1 deg alone none is."""


def test_laterally_the_answer_to_gusts_tells_what_small_pulses_leave_unknown() -> None:
    flight = flown(identify_case(3, 0, lateral=True))
    made = found(flight, "split+gust", "ml")
    assert made.recommended == "ml"
    count = {m: len(lateral(made.methods[m])) for m in made.methods}
    assert count["ml"] >= ACROSS
    assert count["split+gust"] < ACROSS / 2
    told = lateral(made.methods["ml"])
    apart = [(p.value - flight.answers["derivatives"][p.name]) / p.sd for p in told]
    assert np.abs(apart).max() < 3


def lateral(result: MethodResult) -> list[ParamEstimate]:
    """Those called estimated."""
    return [p for p in result.parameters if p.name in LATERAL and p.status is Status.ESTIMATED]


def test_laterally_it_says_what_it_cannot_tell() -> None:
    flight = flown(replace(identify_case(3, 5, lateral=True), seconds=30.0))
    still = replace(flight, shown={**flight.shown, "aileron": 0.0 * flight.time})
    why = {p.name: p.why for p in found(still, "ml").methods["ml"].parameters}
    assert {why[n] for n in LATERAL if n.endswith("_da")} == {"no aileron input"}
    stated = PROFILE.model_copy(update={"inertia": PROFILE.inertia.model_copy(update={"ixx": None})})
    why = {p.name: p.why for p in found(flight, "ml", aircraft=stated).methods["ml"].parameters}
    assert {why[n] for n in LATERAL} == {"the profile gives no inertia.ixx"}
    neither = replace(still, shown={**still.shown, "rudder": 0.0 * flight.time})
    assert not {p.name for p in found(neither, "ml").methods["ml"].parameters} & set(LATERAL)


def test_of_a_long_record_the_pieces_with_most_input_are_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Six of 45 s, of which the elevator moves twice as much in four."""
    flight, given = flown(replace(identify_case(1, GUSTY), seconds=270.0)), []
    loud = [1, 2, 4, 5]
    large = np.where(np.isin((flight.time - QUIET) // 45, loud), 2.0, 1.0)
    moved = replace(flight, shown={**flight.shown, "elevator": large * flight.shown["elevator"]})
    monkeypatch.setattr(derivative_fit, "_fitted", lambda *call: given.append(call) or MethodResult("ok"))
    found(moved, "ml")
    records, settings, *_ = given[0]
    assert sorted(round((r.start_s - QUIET) / 45) for r in records) == loud
    assert (settings["manoeuvres"], settings["of"]) == (derivative_fit.MOST, 6)


def test_a_fit_that_fails_leaves_the_other_methods_theirs(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise np.linalg.LinAlgError("it is singular")

    monkeypatch.setattr(derivative_fit, "Problem", fails)
    made = found(flown(replace(identify_case(1, GUSTY), seconds=20.0)), "split", "ml")
    assert made.methods["ml"].why == "numerical failure: it is singular"
    assert made.recommended == "split"
