"""identify on made-up records: what it refuses, what it says, and that refusals never look like numbers."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from identification.glider import AIRCRAFT, DT, TRUTH, flight, record

from station.commands.cards import about_air, about_vane
from station.identification.analysis import identify
from station.identification.identification_json import as_json
from station.identification.request import Request
from station.log import Table
from station.profile import Aircraft, Card, Doublet, Flight, load_aircraft, load_rig
from station.profile.told_by_flight import Calibrated
from station.rows import UsageError
from station.simulation.sortie import fly


def identified(of: Table, aircraft: Aircraft, methods: Sequence[str] = ("all",), *span: float, **options: Any) -> Any:
    """What identify finds, as its JSON has it."""
    return as_json(identify(of, aircraft, Request(methods, *span, **options)))


def parameters(found: dict[str, Any], method: str) -> dict[str, Any]:
    inner: dict[str, Any] = found["methods"][method]["parameters"]
    return inner


def sound(found: dict[str, Any]) -> None:
    """No number without a status, no NaN, a reason for everything that is not estimated."""
    json.dumps(found, allow_nan=False)
    for name, method in found["methods"].items():
        assert method["status"] in ("ok", "not_applicable")
        assert (method["status"] == "ok") == (not method["why"]), name
        for p in method["parameters"].values():
            assert p["status"] in ("estimated", "unestimated", "invalid")
            assert (p["status"] == "estimated") == (not p["why"]), (name, p)
            if p["status"] == "estimated":
                assert p["estimate"] is not None
                assert p["ci95"][0] < p["estimate"] < p["ci95"][1]
    assert found["recommended"] is None or found["methods"][found["recommended"]]["status"] == "ok"


@pytest.mark.parametrize("method", ["I", "II", "VI", "oe", "fe", "sidpac"])
def test_methods_find_the_derivatives(method: str) -> None:
    found = identified(record(flight()), AIRCRAFT, [method])
    sound(found)
    for name, value in TRUTH.items():
        p = parameters(found, method)[name]
        if name in ("CL_alpha", "Cm_alpha", "Cm_q", "Cm_de"):
            assert p["estimate"] == pytest.approx(value, rel=0.06), name
            assert p["status"] == "estimated"


def test_body_axes_negate_the_lift_derivatives() -> None:
    found = identified(record(flight()), AIRCRAFT, ["I", "VI"], axes="body")
    sound(found)
    for method in ("I", "VI"):
        p = parameters(found, method)
        assert set(p) == {"CZ_alpha", "CZ_q", "CZ_de", "Cm_alpha", "Cm_q", "Cm_de"}
        assert p["CZ_alpha"]["estimate"] == pytest.approx(-TRUTH["CL_alpha"], rel=0.06)


def test_a_delayed_vane_shows_as_one_transformation_of_both_equations() -> None:
    columns = flight()
    late = columns | {"alpha_vane": np.roll(columns["alpha_vane"], 4)}
    found = identified(record(columns), AIRCRAFT, ["I", "II"])
    assert all(pair["agree"] for pair in found["consistency"]["pairs"])
    one = parameters(identified(record(columns), AIRCRAFT, ["I"]), "I")
    two = parameters(identified(record(late), AIRCRAFT, ["I"]), "I")
    by_lift = (two["CL_q"]["estimate"] - one["CL_q"]["estimate"]) / one["CL_alpha"]["estimate"]
    by_moment = (two["Cm_q"]["estimate"] - one["Cm_q"]["estimate"]) / one["Cm_alpha"]["estimate"]
    assert by_lift == pytest.approx(by_moment, rel=0.1)
    assert by_lift > 2


def test_without_excitation_no_derivative_is_estimated() -> None:
    found = identified(record(flight(amplitude=0.0)), AIRCRAFT)
    sound(found)
    assert found["recommended"] is None
    for name, method in found["methods"].items():
        assert method["status"] == "not_applicable", name
        assert all(p["status"] != "estimated" for p in method["parameters"].values())
    assert "no elevator input" in found["methods"]["I"]["why"]


def test_collinear_regressors_are_refused() -> None:
    columns = flight()
    columns["q"] = 30 * columns["elevator"]
    found = identified(record(columns), AIRCRAFT, ["I", "sidpac"])
    sound(found)
    p = parameters(found, "I")
    assert p["CL_q"]["status"] == p["CL_de"]["status"] == "invalid"


def test_rows_that_a_stopped_recorder_repeats_are_excluded() -> None:
    """Two seconds in the middle of the doublet at 4 s: taken for measured, Cm_q comes out a fifth too small."""
    columns = flight()
    frozen = {name: np.concatenate([c[:226], np.full(99, c[225]), c[325:]]) for name, c in columns.items()}
    found = identified(record(frozen), AIRCRAFT, ["I", "II", "oe"])
    sound(found)
    assert any(r.startswith("the profile has no boom") for r in found["remarks"])
    assert "1.98 s of rows repeat the row before, first at 4.52 s" in found["remarks"][0]
    assert found["methods"]["I"]["settings"]["samples"] == pytest.approx(1200 - 99, abs=10)
    for name, true in TRUTH.items():
        p = parameters(found, "II")[name]
        assert abs(p["estimate"] - true) < 3 * p["std_error"], name
    assert "1.98 s lack a needed signal" in found["methods"]["oe"]["why"]
    # A trim made up without noise is no gap.
    columns = {name: np.concatenate([np.full(100, c[0]), c]) for name, c in flight(seed=2).items()}
    quiet = {name: c - c[100] + c[0] if name in ("q", "alpha_vane", "az") else c for name, c in columns.items()}
    assert not [r for r in identified(record(quiet), AIRCRAFT, ["I"])["remarks"] if "repeat" in r]


def test_spikes_are_excluded() -> None:
    """A lost bit within the signal's range moves CL_q of method I by many of its errors; no motion is taken for one."""
    columns = flight()
    assert not [r for r in identified(record(columns), AIRCRAFT, ["I"])["remarks"] if "spike" in r]
    columns["q"][700] -= 8.0
    columns["az"][300:302] += 60.0
    columns["alpha_vane"][900:905] = 10.0
    found = identified(record(columns), AIRCRAFT, ["I"])
    sound(found)
    told = " ".join(found["remarks"])
    assert "q: 1 value is a spike, first at 14.00 s: excluded" in told
    assert "az: 2 values are spikes, first at 6.00 s: excluded" in told
    # Five impossible values are no wrong unit.
    assert not found["hint"]
    for name, true in TRUTH.items():
        p = parameters(found, "I")[name]
        assert abs(p["estimate"] - true) < 3 * p["std_error"], name


def test_an_interval_that_begins_in_motion_is_unbiased_or_refused() -> None:
    """4.6 s lies in the doublet. With flight before it in the recording nothing is made up; alone it is refused where
    it is shorter than a period of 0.1 Hz, and said of where it is longer. Output error finds the state it begins in."""
    whole, methods = record(flight()), ["II", "oe"]
    for end in (12.0, 24.0):
        found = identified(whole, AIRCRAFT, methods, 4.6, end)
        assert found["methods"]["II"]["settings"]["filters_settled_on"] == "a held trim and 5 s of flight"
        assert not [r for r in found["remarks"] if "pitching" in r]
        for method in methods:
            for name, true in TRUTH.items():
                p = parameters(found, method)[name]
                assert abs(p["estimate"] - true) < 3 * p["std_error"], (method, name, end)
        for name, true in TRUTH.items():
            if name != "CL_q":
                assert parameters(found, "oe")[name]["estimate"] == pytest.approx(true, rel=0.05), name
    alone = record({name: column[230:] for name, column in flight().items()})
    refused = identified(alone, AIRCRAFT, methods, 0.0, 7.0)
    sound(refused)
    assert "has to begin in trim" in refused["methods"]["II"]["why"]
    longer = identified(alone, AIRCRAFT, methods)
    assert any("the record begins pitching at" in r for r in longer["remarks"])
    # With the first sample smoothed and held for the state, 3 to 6 % off; straight lines between samples leave 0.3 %.
    assert parameters(longer, "oe")["Cm_alpha"]["estimate"] == pytest.approx(TRUTH["Cm_alpha"], rel=0.01)


def test_held_and_impossible_values_are_remarked_on() -> None:
    columns = flight(10.0)
    assert not [r for r in identified(record(columns), AIRCRAFT, ["I"])["remarks"] if "repeats" in r or "unit" in r]
    columns["q"] = columns["q"][np.arange(len(columns["q"])) // 10 * 10]
    columns["alpha_vane"] = np.round(columns["alpha_vane"] / 0.02) * 0.02
    columns["theta"] = np.degrees(columns["theta"]) + 90
    told = identified(record(columns), AIRCRAFT, ["I"])["remarks"]
    assert any(r.startswith("q repeats its last value in 90% of the rows: held") for r in told), told
    assert any("alpha_vane repeats" in r and "rounded to steps of 0.02 rad" in r for r in told), told
    assert any(r.startswith("theta: ") and "is its unit right?" in r for r in told), told


def test_a_rig_without_air_density_is_remarked_on() -> None:
    bench, aircraft = load_rig("bench"), load_aircraft("twin_otter")
    assert about_air(bench, aircraft) == []
    boom = bench.model_copy(update={"devices": bench.devices[:1]})
    assert "with no air density" in about_air(boom, aircraft)[0]
    assert about_air(boom, aircraft.model_copy(update={"air_density": 1.1})) == []


def test_a_vane_zero_that_no_calibration_flight_has_told_is_remarked_on() -> None:
    aircraft = load_aircraft("twin_otter")
    (words,) = about_vane(aircraft)
    assert "0.13 deg off" in words  # 0.15 deg by a protractor, 1/1.177 of the flow's angle
    of = {"date": "unknown", "recordings": ["a"], "lowest_speed": "50 m/s", "highest_speed": "70 m/s"}
    told = Calibrated.model_validate({**of, "vane_zero_sd": "0.1 deg"})
    assert about_vane(aircraft.model_copy(update={"calibrated": told})) == []
    assert about_vane(aircraft.model_copy(update={"boom": None})) == []


def test_the_level_of_turbulence_is_one_of_four_or_null() -> None:
    found = identified(record(flight(1.0)), AIRCRAFT, ["I"])
    assert found["turbulence"] == {"level": None, "w_std_2_7hz_mps": None}
    assert identified(record(flight(10.0)), AIRCRAFT, ["I"])["turbulence"]["level"] == "calm"


def test_an_elevator_that_follows_q_is_no_input_for_the_methods_that_integrate() -> None:
    """Process noise fits what the model cannot: VI said Cm_q -1100 ± 83, fe -1700 ± 53."""
    columns = flight()
    columns["elevator"] = -0.8 * columns["q"]
    found = identified(record(columns), AIRCRAFT, ["VI", "oe", "fe"])
    sound(found)
    for method in found["methods"]:
        p = parameters(found, method)
        assert all(p[n]["status"] == "invalid" for n in ("CL_q", "CL_de", "Cm_q", "Cm_de")), method


def test_a_profile_without_inertia_gives_lift_but_no_moment() -> None:
    bare = AIRCRAFT.model_copy(update={"inertia": AIRCRAFT.inertia.model_copy(update={"iyy": None})})
    found = identified(record(flight(), bare), bare)
    sound(found)
    for method in ("I", "II", "sidpac"):
        p = parameters(found, method)
        assert p["CL_alpha"]["status"] == "estimated"
        assert p["Cm_alpha"]["status"] == "invalid"
        assert p["Cm_alpha"]["estimate"] is None
        assert "iyy" in p["Cm_alpha"]["why"]
    for method in ("VI", "oe", "fe"):
        assert "iyy" in found["methods"][method]["why"]


def test_a_dropout_in_the_manoeuvre_is_excluded_or_refused() -> None:
    columns = flight()
    columns["alpha_vane"][round(4.2 / DT) : round(6.2 / DT)] = np.nan
    found = identified(record(columns), AIRCRAFT)
    sound(found)
    assert parameters(found, "I")["CL_alpha"]["estimate"] == pytest.approx(TRUTH["CL_alpha"], rel=0.06)
    for method in ("sidpac", "oe", "fe", "VI"):
        assert "2.00 s lack a needed signal, first at 4.20 s" in found["methods"][method]["why"]


def test_a_few_missing_samples_are_bridged() -> None:
    columns = flight()
    for name in ("alpha_vane", "q", "az"):
        columns[name][200:203] = np.nan
    found = identified(record(columns), AIRCRAFT, ["I", "sidpac", "oe"])
    sound(found)
    assert all(m["status"] == "ok" for m in found["methods"].values())


def test_held_samples_of_the_vane_count_as_missing() -> None:
    columns = flight()
    quality = {"alpha_vane": np.zeros(len(columns["q"]), dtype=np.uint8)}
    quality["alpha_vane"][250:400] = 1
    columns["alpha_vane"][250:400] = columns["alpha_vane"][249]
    found = identified(replace(record(columns), quality=quality), AIRCRAFT, ["I", "sidpac"])
    sound(found)
    assert "lack a needed signal" in found["methods"]["sidpac"]["why"]
    assert parameters(found, "I")["CL_alpha"]["estimate"] == pytest.approx(TRUTH["CL_alpha"], rel=0.06)


def test_too_short_a_record_is_refused_by_every_method() -> None:
    columns = {n: c[200:240] for n, c in flight().items()}
    found = identified(record(columns), AIRCRAFT)
    sound(found)
    assert all(m["status"] == "not_applicable" for m in found["methods"].values())


def test_an_interval_of_a_flight_settles_the_filters_on_what_came_before() -> None:
    found = identified(record(flight(50.0)), AIRCRAFT, ["II"], 25.0, 49.0)
    assert found["interval_s"] == [25.0, 49.0]
    assert found["methods"]["II"]["settings"]["filters_settled_on"] == "25 s of flight"


def test_near_zero_speed_is_refused() -> None:
    columns = flight() | {"airspeed": np.full(1200, 0.5)}
    with pytest.raises(UsageError, match="airspeed stays below"):
        identified(record(columns), AIRCRAFT)


def test_method_iv_measures_the_whole_flight_first_and_refuses_a_short_or_a_calm_one() -> None:
    aircraft, rig = load_aircraft("twin_otter"), load_rig("bench")
    doublet = Doublet.model_validate({"kind": "doublet", "start": "92 s", "amplitude": "3.5 deg", "width": "1.3 s"})
    found = {}
    for sigma in ("5 ft/s", "0 ft/s"):
        gusts = Flight.model_validate({"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": sigma})
        card = Card(name="t", aircraft="t", rig="bench", flight=gusts, manoeuvres=(doublet,))
        shown, _ = fly(aircraft, rig, card, 120.0, 2)
        flown = record(shown, aircraft)
        found[sigma] = identified(flown, aircraft, ["IV"], 90.0, card=card, imu_position=rig.imu_position)
        sound(found[sigma])
    made = found["5 ft/s"]["methods"]["IV"]
    assert made["status"] == "ok"
    assert parameters(found["5 ft/s"], "IV")["CL_alpha"]["status"] == "estimated"
    spectra = made["settings"]["spectra"]
    at = np.interp([1.0, 2.0], spectra["frequency_hz"], spectra["delay_s"])
    # From gusts alone another simulation has 57 and 91 ms for its aircraft; x/V is 94 ms.
    assert 0.05 < at[0] < at[1] < 0.11
    assert min(spectra["coherence"]) > 0.5
    assert found["0 ft/s"]["methods"]["IV"]["why"] == "calm air: the delay would do harm"
    forced = identified(flown, aircraft, ["IV"], 90.0, card=card, imu_position=rig.imu_position, force=True)
    assert forced["methods"]["IV"]["status"] == "ok"
    assert forced["methods"]["IV"]["why"].startswith("forced in calm air: all of alpha is delayed as if it were gust")
    short = flown.between(90.0, 120.0)
    refused = identified(short, aircraft, ["IV"], card=card, imu_position=rig.imu_position)
    sound(refused)
    assert "too short to measure spectra" in refused["methods"]["IV"]["why"]


def test_an_unknown_method_an_empty_interval_and_a_record_without_anything_are_refused() -> None:
    flown = record(flight())
    with pytest.raises(UsageError, match=r"no method named spilt; did you mean split\?"):
        identified(flown, AIRCRAFT, ["spilt"])
    with pytest.raises(UsageError, match=r"no data from 30 to 40 s: the recording has 0 to 23\.98 s"):
        identified(flown, AIRCRAFT, ["I"], 30.0, 40.0)
    columns = flight()
    del columns["elevator"], columns["theta"]
    with pytest.raises(UsageError, match="the record has no elevator"):
        identified(record(columns), AIRCRAFT)


def test_without_elevator_or_aerodynamic_data_only_the_kinematics_are_identified() -> None:
    bare = AIRCRAFT.model_copy(update={"kinematics_only": True})
    no_elevator = flight()
    del no_elevator["elevator"]
    for columns, aircraft, why in ((no_elevator, AIRCRAFT, "no elevator"), (flight(), bare, "no aerodynamic data")):
        found = identified(record(columns, aircraft), aircraft)
        assert found["recommended"] is None
        for method in found["methods"].values():
            assert method["status"] == "not_applicable"
            assert why in method["why"]
            assert all(p["estimate"] is None and p["status"] == "invalid" for p in method["parameters"].values())
        assert found["compatibility"]["status"] == "ok"
        assert found["compatibility"]["residual_rms"]["theta"] < 1e-3
        assert found["vane_calibration"]["status"] == "not_applicable"
        assert "v_down" in found["vane_calibration"]["why"]
        json.dumps(found, allow_nan=False)


def test_uneven_times_are_interpolated_and_remarked_on() -> None:
    columns = flight()
    t = np.arange(1200) * DT + np.random.default_rng(4).uniform(0, 0.008, 1200)
    flown = Table(t, {n: np.interp(t, np.arange(1200) * DT, c) for n, c in columns.items()}, AIRCRAFT, 0)
    found = identified(flown, AIRCRAFT, ["I", "II"])
    sound(found)
    assert any("interpolated" in remark for remark in found["remarks"])
    assert parameters(found, "I")["CL_alpha"]["estimate"] == pytest.approx(TRUTH["CL_alpha"], rel=0.06)
