"""A sign or a unit taken wrong leaves no estimate valid, and is named; a sound record of any kind is left in peace."""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from records import record as real

from station.conventions import SIGNALS
from station.convert import import_file
from station.convert.delimited import write_csv
from station.diagnosis.effects import extended
from station.identification.signs_and_units import mistakes
from station.log import table
from station.profile import Aircraft, Card, load_aircraft, load_rig
from station.simulation.sortie import fly

RIG, AIRCRAFT = load_rig("bench"), load_aircraft("twin_otter")
DEG, KT, FT, PSF = 180 / math.pi, 3600 / 1852, 1 / 0.3048, 1 / 47.880259
ANGLES = ("alpha_vane", "theta", "elevator", "q")
SPEEDS = ("airspeed", "v_north", "v_east", "v_down")
PLANTED = [
    *(({name: -1.0}, f"{name} of the wrong sign") for name in ("az", "ax", "theta", "q", "elevator", "alpha_vane")),
    ({"v_down": -1.0}, "v_down of the wrong sign"),
    *(({name: DEG}, f"{name} in the wrong unit: deg for rad") for name in ANGLES),
    *(({name: 1 / DEG}, f"{name} in the wrong unit: rad for deg") for name in ANGLES),
    (
        dict.fromkeys(("alpha_vane", "theta", "elevator", "q"), DEG),
        "alpha_vane, theta, elevator and q in the wrong unit",
    ),
    ({"airspeed": KT}, "airspeed in the wrong unit: kt for m/s"),
    ({"airspeed": 1 / KT}, "airspeed in the wrong unit: m/s for kt"),
    ({"airspeed": FT}, "airspeed in the wrong unit: ft/s for m/s"),
    (dict.fromkeys(SPEEDS, KT), "airspeed, v_north, v_east and v_down in the wrong unit: kt for m/s"),
    ({"az": 1 / 9.80665}, "az in the wrong unit: g for m/s2"),
    ({"ax": 9.80665}, "ax in the wrong unit: m/s2 for g"),
    ({"dynamic_pressure": PSF}, "dynamic_pressure in the wrong unit: psf for Pa"),
]


@functools.cache
def flown(sigma: float, effects: tuple[tuple[str, float], ...] = (), seed: int = 5) -> Mapping[str, Any]:
    card = {
        "name": "t",
        "aircraft": "twin_otter",
        "rig": "bench",
        "flight": {"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": f"{sigma} ft/s", "wind_north": "-12 m/s"},
        "manoeuvres": [
            {"kind": "doublet", "start": "12 s", "amplitude": "3.5 deg", "width": "0.9 s"},
            {"kind": "doublet", "start": "24 s", "amplitude": "2 deg", "width": "0.6 s"},
        ],
    }
    shown, _ = fly(extended(AIRCRAFT, dict(effects)), RIG, Card.model_validate(card), 40.0, seed)
    return {n: c for n, c in shown.items() if n not in ("mass", "thrust", "pdot", "qdot", "rdot")}


def named(columns: Mapping[str, Any], aircraft: Aircraft = AIRCRAFT) -> list[str]:
    return [m.sentence for m in mistakes(np.arange(len(columns["q"])) * 0.02, columns, aircraft)]


@pytest.mark.parametrize("sigma", [3.0, pytest.param(0.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("factors", "sentence"), PLANTED, ids=[s for _, s in PLANTED])
def test_a_planted_mistake_is_named_first(factors: Mapping[str, float], sentence: str, sigma: float) -> None:
    columns = {n: c * factors.get(n, 1.0) for n, c in flown(sigma).items()}
    found = named(columns)
    assert any(words.startswith(sentence) for words in found)
    # Feet per second and kilometres per hour lie 10 % apart: a wind may hide which.
    assert found[0].split(" in the ")[0] == sentence.split(" in the ")[0]


@pytest.mark.parametrize("missing", [("v_north", "v_east", "v_down"), ("theta",), ("dynamic_pressure",)])
def test_fewer_instruments_name_a_reversed_accelerometer_too(missing: tuple[str, ...]) -> None:
    columns = {n: c for n, c in flown(3.0).items() if n not in missing}
    assert named(columns) == []
    assert named({**columns, "az": -columns["az"]}) == ["az of the wrong sign"]


@pytest.mark.parametrize("sigma", [0.0, 3.0, 10.0])
def test_sound_records_show_no_mistake_under_any_profile(sigma: float) -> None:
    for aircraft in ("twin_otter", "twin_otter_martos", "dhc6_jsbsim", "hfb320", "unknown"):
        assert named(flown(sigma), load_aircraft(aircraft)) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "effects",
    [
        {"theta.bias": 0.075}, {"theta.bias": -0.075}, {"alpha_vane.scale": 1.0}, {"alpha_vane.bias": 0.1},
        {"elevator.scale": -0.6}, {"inertia.scale": -0.6}, {"alpha_vane.delay": 0.2}, {"elevator.lag": 0.2},
        {"dynamic_pressure.scale": 0.5}, {"mass.scale": 0.5}, {"accelerometer.scale": -0.25}, {"q.scale": 0.3},
    ],
    ids=str,
)  # fmt: skip
def test_a_poor_instrument_is_no_wrong_sign_or_unit(effects: Mapping[str, float]) -> None:
    """Far larger errors than any that an instrument passes a ground check with."""
    for sigma in (0.0, 3.0, 10.0):
        assert named(flown(sigma, tuple(effects.items()), 3)) == []


PITCHED = ("az", "q", "theta", "alpha_vane", "elevator")


@pytest.mark.parametrize(
    ("file", "own", "turned_over"),
    [
        ("twin_otter/totter_demo_data.mat", "twin_otter", PITCHED),
        ("twin_otter/totter_f1_017_data.mat", "twin_otter", ("az",)),  # a lateral manoeuvre
        ("hfb320/hfb320_1_10.asc", "hfb320", PITCHED),
    ],
)
def test_real_records_show_a_mistake_only_where_one_is_planted(
    file: str, own: str, turned_over: tuple[str, ...], tmp_path: Path
) -> None:
    """Sound as they are, by their own and by another aircraft's profile; named where one signal is turned over."""
    log = tmp_path / "record.mcap"
    import_file(real(file), log, load_aircraft(own))
    record = table(log)
    for profile in ("twin_otter", "hfb320", "unknown"):
        assert mistakes(record.t_s, record.columns, load_aircraft(profile)) == ()
    for name in turned_over:
        turned = {**record.columns, name: -record.columns[name]}
        words = [m.sentence for m in mistakes(record.t_s, turned, load_aircraft(own))]
        assert f"{name} of the wrong sign" in words, name


def test_an_imported_record_with_az_reversed_gives_no_valid_estimate(tmp_path: Path, station: Any) -> None:
    columns = {**flown(0.0)}
    columns["az"] = -columns["az"]
    file, log = tmp_path / "record.csv", tmp_path / "record.mcap"
    write_csv(file, {n: SIGNALS[n].unit for n in columns}, [(np.arange(len(columns["q"])) * 0.02, columns)])
    assert station("import", file, "-o", log, "--aircraft", "twin_otter")[0] == 0
    code, out, err = station("identify", log, "--method", "I,II", "--json", "-")
    found = json.loads(out)
    assert code == 3
    assert found["recommended"] is None
    assert found["hint"].startswith("az of the wrong sign: no estimate is valid")
    assert found["hint"] in err
    for method in found["methods"].values():
        assert method["status"] == "not_applicable"
        assert {(p["status"], p["why"]) for p in method["parameters"].values()} == {("invalid", "az of the wrong sign")}
    code, out, _ = station("identify", log, "--method", "I,II")
    assert code == 3
    assert "I, II: az of the wrong sign" in out
    assert "±" not in out.split("\n", 2)[2]
