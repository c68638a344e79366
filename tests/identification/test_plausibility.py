"""A profile that cannot be the recorded aircraft's is told; one that is, never."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from records import record as real

from station.convert import import_file
from station.identification.analysis import identify
from station.identification.request import Request
from station.log import Table, table
from station.profile import Aircraft, Card, load_aircraft, load_rig
from station.simulation.sortie import fly

RIG, AIRCRAFT = load_rig("bench"), load_aircraft("twin_otter")
SETTINGS = {
    "name": "t",
    "aircraft": "twin_otter",
    "rig": "bench",
    "flight": {"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": "3 ft/s"},
    "manoeuvres": [{"kind": "doublet", "start": "12 s", "amplitude": "3.5 deg", "width": "0.9 s"}],
}


@functools.cache
def flown() -> Table:
    shown, _ = fly(AIRCRAFT, RIG, Card.model_validate(SETTINGS), 24.0, 5)
    columns = {n: c for n, c in shown.items() if n not in ("mass", "thrust", "pdot", "qdot", "rdot")}
    return Table(np.arange(len(shown["q"])) * 0.02, columns, AIRCRAFT, 0)


def said(of: Table, aircraft: Aircraft, method: str = "split") -> str:
    return identify(of, aircraft, Request([method], imu_position=RIG.imu_position)).hint


def changed(**inertia: float) -> Aircraft:
    return AIRCRAFT.model_copy(update={"inertia": AIRCRAFT.inertia.model_copy(update=inertia)})


def test_the_aircraft_s_own_profiles_are_not_doubted() -> None:
    lighter = changed(mass=0.85 * AIRCRAFT.inertia.mass)
    renamed = AIRCRAFT.model_copy(update={"name": "extended", "imu_offset": (0.2, 0.0, 0.0)})
    for aircraft in (AIRCRAFT, lighter, renamed, load_aircraft("twin_otter_martos"), load_aircraft("dhc6_jsbsim")):
        assert said(flown(), aircraft) == "", aircraft.name


def test_another_aircraft_s_profile_is_hinted_at_with_what_contradicts_it() -> None:
    words = said(flown(), load_aircraft("hfb320"))
    assert words.startswith("is hfb320 the aircraft recorded? the recording says twin_otter, wing 39.0 m2 and not 30.1")
    assert "it flew at CL" in words
    assert "\n" not in words


def test_a_wrong_mass_is_hinted_at_from_the_lift_it_would_need() -> None:
    """Half the mass: half the lift coefficient, half the slope."""
    words = said(flown(), changed(mass=0.45 * AIRCRAFT.inertia.mass))
    assert "it flew at CL 0.3" in words
    assert "CL_alpha is 0.4" in words
    inertia = AIRCRAFT.inertia.iyy
    assert inertia is not None
    assert "Cm_de is 3" in said(flown(), changed(iyy=3 * inertia))


@pytest.mark.slow
def test_an_aircraft_without_aerodynamic_data_contradicts_nothing() -> None:
    assert identify(flown(), load_aircraft("unknown"), Request(imu_position=RIG.imu_position)).hint == ""


@pytest.mark.parametrize(
    ("file", "own", "other", "words"),
    [
        ("twin_otter/totter_demo_data.mat", "twin_otter", "hfb320", ("recorded mass 49", "it flew at CL 0.6")),
        ("hfb320/hfb320_1_10.asc", "hfb320", "twin_otter", ("the recording says hfb320", "the profile gives 0.85")),
    ],
)
def test_real_records_contradict_only_another_aircraft_s_profile(
    file: str, own: str, other: str, words: tuple[str, ...], tmp_path: Path, station: Any
) -> None:
    log = tmp_path / "record.mcap"
    import_file(real(file), log, load_aircraft(own))
    assert said(table(log), load_aircraft(own), "I") == ""
    code, out, err = station("identify", log, "--aircraft", other, "--method", "I", "--json", "-")
    assert code == 0
    assert len(err.strip().splitlines()) == 1
    for part in words:
        assert part in err
        assert part in json.loads(out)["hint"]
