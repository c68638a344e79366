"""The kinematic part through identify and report: a simulated flight, and the records of real booms."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from records import record

from station.convert import import_file
from station.identification.analysis import identify
from station.identification.flown import fly as refly
from station.identification.identification_json import as_json, kinematics_json
from station.identification.identification_report import write_report
from station.identification.instrument_pages import kinematic_pages
from station.identification.kinematics import kinematics
from station.identification.model_structure import structures
from station.identification.preparation import flight_record
from station.identification.request import Request
from station.log import Table, table
from station.profile import Card, Flight, Multisine, load_aircraft
from station.simulation.sensors import STANDARD
from station.simulation.sortie import fly


@pytest.mark.slow
def test_gusts_give_the_vane_s_arrival_offset() -> None:
    aircraft = load_aircraft("twin_otter")
    flight = Flight.model_validate({"speed": "110 kt", "gust_sigma": "5 ft/s", "seed": 2})
    card = Card(name="test", aircraft=aircraft.name, rig="", flight=flight)
    shown, truth = fly(aircraft, STANDARD, card, 100.0, 2)
    flown = Table(truth["time"], {**shown, "thrust": truth["thrust"]}, aircraft, 0)
    record, refusal = flight_record(flown, aircraft)
    assert not refusal
    made = kinematics(record)
    found = kinematics_json(made, record)
    json.dumps(found, allow_nan=False)
    delay = found["gust_delay"]
    assert delay["status"] == "ok"
    assert delay["equations_agree"]
    assert delay["profile_fits"]
    for lead in (delay["parameters"], *delay["by_equation"].values()):
        assert lead["delay"]["estimate"] == pytest.approx(5.3 / 56.6, abs=0.005)
    page = "".join(kinematic_pages(made, record))
    for words in ("Gust arrival offset", "Lift and moment give the same delay", "Data compatibility"):
        assert words in page


@pytest.mark.parametrize(("memory", "preferred"), [(True, "split+gust"), (False, "split")])
def test_f_test_and_prediction_select_the_late_tail_only_where_there_is_one(memory: bool, preferred: str) -> None:
    aircraft = load_aircraft("twin_otter")
    aircraft = aircraft.model_copy(update={"unsteady": aircraft.unsteady.model_copy(update={"memory": memory})})
    flight = Flight.model_validate({"speed": "110 kt", "gust_sigma": "5 ft/s", "seed": 3})
    inputs = {"kind": "multisine", "start": "20 s", "amplitude": "2 deg", "duration": "20 s", "repeat": "20 s"}
    card = Card(
        name="test", aircraft=aircraft.name, rig="", flight=flight, manoeuvres=(Multisine.model_validate(inputs),)
    )
    shown, truth = fly(aircraft, STANDARD, card, 80.0, 3)
    flown = Table(truth["time"], {**shown, "thrust": truth["thrust"]}, aircraft, 0)
    record, _ = flight_record(flown.between(20.0, 80.0), aircraft)
    seen = refly(flown, record, ("split",), Request(start_s=20.0))
    made = structures(record, seen.t_s, seen.alphas)
    assert not isinstance(made, str)
    for equation in ("CL", "Cm"):
        assert made[equation].preferred == preferred
        if memory:
            # Two angles of attack (equation 65) do not do what a tail that meets the gust later does.
            both = made[equation].structures
            assert both["split+gust"].held_out < 0.5 * both["eq65"].held_out


@pytest.mark.slow
@pytest.mark.parametrize("name", ["onspeed/vac_decel_run.csv", "thor/thor_flight75.mat"])
def test_real_booms_are_calibrated_and_no_derivative_is_made_up(name: str, tmp_path: Path) -> None:
    import_file(record(name), tmp_path / "a.mcap", load_aircraft("unknown"))
    flown = table(tmp_path / "a.mcap")
    if "thor" in name:
        flown = flown.between(230.0, 330.0)
    identification = identify(flown, flown.aircraft)
    found = as_json(identification)
    assert found["recommended"] is None
    assert all("no aerodynamic data" in m["why"] for m in found["methods"].values())
    assert found["gust_delay"]["status"] == "not_applicable"
    vane = found["vane_calibration"]
    assert vane["status"] == "ok"
    zero, scale, delay = (vane["parameters"][n] for n in ("zero", "scale", "delay"))
    assert vane["rms_after_rad"] < vane["rms_before_rad"]
    assert all(p["std_error"] > 0 for p in (zero, scale, delay))
    if "onspeed" in name:
        # Seen by eye: 7.4 to 15.8 deg of motion against 11.6 to 22.0 deg of vane.
        assert scale["estimate"] == pytest.approx((22.0 - 11.6) / (15.8 - 7.4), abs=0.15)
        assert zero["status"] == "estimated"
        assert vane["rms_after_rad"] < math.radians(1.0) < math.radians(5.0) < vane["rms_before_rad"]
        # The reconstruction, which knows neither attitude's nor velocity's blending, finds the same scale.
        other = found["compatibility"]["parameters"]["alpha_scale"]
        assert abs(other["estimate"] - scale["estimate"]) < 2 * np.hypot(other["std_error"], scale["std_error"])
    else:
        assert zero["status"] == "unestimated"
        assert scale["estimate"] == pytest.approx(0.95, abs=0.25)
    page = write_report(identification, tmp_path).read_text(encoding="utf-8")
    assert "Vane against the inertial angle of attack" in page
    assert "Data compatibility" in page
