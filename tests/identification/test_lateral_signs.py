"""A lateral signal of the wrong sign or unit is named, in gusts too, and leaves no estimate valid; sound flights and
real records of lateral manoeuvres are left in peace. What is planted is known."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from real_aircraft import profile
from real_records import attas, dasmat, write_csv
from records import record as real

from station.convert import import_file
from station.identification.analysis import identify
from station.identification.preparation import prepare
from station.identification.request import Request
from station.identification.signs_and_units import mistakes
from station.log import Table, table
from station.profile import Card, load_aircraft, load_card
from station.rows import Status
from station.simulation.sensors import STANDARD
from station.simulation.sortie import fly

AIRCRAFT = load_aircraft("twin_otter")
DEG, G = 180 / math.pi, 9.80665
SHAPE = {"kind": "multisine", "start": "5 s", "duration": "20 s", "repeat": "20 s", "high": "1.5 Hz"}
INPUTS = [{**SHAPE, "surface": surface, "amplitude": "4 deg"} for surface in ("aileron", "rudder")]
SIGNALS = ("beta_vane", "ay", "p", "r", "phi", "psi", "aileron", "rudder")
PLANTED = [
    *(({n: -1.0}, f"{n} of the wrong sign") for n in SIGNALS),
    *(({n: DEG}, f"{n} in the wrong unit: deg for rad") for n in SIGNALS if n != "ay"),
    *(({n: 1 / DEG}, f"{n} in the wrong unit: rad for deg") for n in SIGNALS if n != "ay"),
    ({"ay": 1 / G}, "ay in the wrong unit: g for m/s2"),
    (dict.fromkeys(("aileron", "rudder"), 1 / DEG), "aileron and rudder in the wrong unit: rad for deg"),
    (dict.fromkeys(("p", "q", "r"), DEG), "p, q and r in the wrong unit: deg for rad"),
]


@functools.cache
def flown(sigma: float, field: str, seed: int) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
    flight = {"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": f"{sigma} ft/s", "field": field}
    card = Card.model_validate({"name": "t", "aircraft": "twin_otter", "rig": "", "flight": flight,
                                "manoeuvres": INPUTS, "lateral": True})  # fmt: skip
    shown, truth = fly(AIRCRAFT, STANDARD, card, 45.0, seed)
    return truth["time"], {**shown, "thrust": truth["thrust"]}


def named(t: np.ndarray, columns: Mapping[str, np.ndarray], aircraft: str = "twin_otter") -> list[str]:
    return [m.sentence for m in mistakes(t, columns, load_aircraft(aircraft))]


@pytest.mark.parametrize(("sigma", "field"), [(5.0, "plane"), pytest.param(10.0, "plane", marks=pytest.mark.slow)])
@pytest.mark.parametrize(("factors", "sentence"), PLANTED, ids=[s for _, s in PLANTED])
def test_a_planted_mistake_is_named_first(
    factors: Mapping[str, float], sentence: str, sigma: float, field: str
) -> None:
    t, columns = flown(sigma, field, 3)
    assert named(t, {n: c * factors.get(n, 1.0) for n, c in columns.items()})[0] == sentence


@pytest.mark.parametrize("name", ["beta_vane", "ay", "aileron", "rudder"])
def test_without_a_profile_and_without_velocities_a_sign_shows_too(name: str) -> None:
    t, columns = flown(5.0, "plane", 3)
    columns = {n: c for n, c in columns.items() if n not in ("v_north", "v_east", "v_down")}
    assert named(t, {**columns, name: -columns[name]}, "unknown") == [f"{name} of the wrong sign"]


@pytest.mark.parametrize(("sigma", "field"), [(0.0, "line"), (5.0, "plane"), (20.0, "plane")])
def test_sound_flights_show_no_mistake_under_any_profile(sigma: float, field: str) -> None:
    for aircraft in ("twin_otter", "twin_otter_martos", "hfb320", "unknown"):
        assert named(*flown(sigma, field, 3), aircraft) == []


@pytest.mark.slow
@pytest.mark.parametrize("card", ["bench", "lateral", "gusty_plane", "multisine", "feedback"])
def test_flights_of_shipped_cards_show_none(card: str) -> None:
    made = load_card(card)
    for seed in (1, 2):
        shown, truth = fly(AIRCRAFT, made.rig, made.card, 100.0, seed)
        assert named(truth["time"], shown) == []


@pytest.mark.parametrize("factor", [-1.0, 1 / DEG])
def test_identify_calls_no_derivative_estimated_by_a_wrong_rudder(factor: float) -> None:
    """Before, Cn_dr +0.13 and -7.1 were, of an aircraft with -0.14."""
    t, columns = flown(5.0, "plane", 3)
    wrong = Table(t, {**columns, "rudder": factor * columns["rudder"]}, AIRCRAFT, 0)
    found = identify(wrong, AIRCRAFT, Request(("II", "split+gust"), 5.0))
    sound = identify(Table(t, columns, AIRCRAFT, 0), AIRCRAFT, Request(("II", "split+gust"), 5.0))
    assert found.hint.startswith("rudder ")
    assert found.hint.endswith("correct it where the record was made or imported")
    assert {p.status for r in found.methods.values() for p in r.parameters} == {Status.INVALID}
    assert any(p.status is Status.ESTIMATED for p in sound.methods["split+gust"].parameters)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fAttasAilRud1", "fAttasRud1", "dr3211_1", "totter_f1_017_data"])
def test_real_lateral_manoeuvres_show_a_mistake_only_where_one_is_planted(name: str, tmp_path: Path) -> None:
    """Of the simulation only the rudder moves, and NASA's record has no heading."""
    log = tmp_path / "record.mcap"
    if name.startswith("totter"):
        source, aircraft = real(f"twin_otter/{name}.mat"), AIRCRAFT
    else:
        is_attas = name.startswith("fAttas")
        source = write_csv(attas(name) if is_attas else dasmat(name), tmp_path / "record.csv")
        aircraft = load_aircraft(profile("attas" if is_attas else "citation", tmp_path))
    import_file(source, log, aircraft)
    cut = prepare(table(log), aircraft, Request()).cut
    for other in (aircraft, AIRCRAFT, load_aircraft("hfb320"), load_aircraft("unknown")):
        assert mistakes(cut.t_s, cut.columns, other) == ()
    lacks = {"dr3211_1": {"aileron"}, "totter_f1_017_data": {"psi"}}.get(name, set())
    for signal in (n for n in SIGNALS if n in cut.columns and n not in lacks):
        turned = {**cut.columns, signal: -cut.columns[signal]}
        assert mistakes(cut.t_s, turned, aircraft)[0].sentence == f"{signal} of the wrong sign"
