"""Drag from energy: by the glide ratio, of simulated flights whose drag is known, and where the thrust is not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from station.conventions import LONGITUDINAL, SIGNALS
from station.estimation.engine_thrust import EngineThrust
from station.identification.analysis import identify
from station.identification.drag_results import UNKNOWN, DragResult, drag_json, drag_lines, drag_of
from station.identification.preparation import flight_record
from station.identification.request import Request
from station.log import Table
from station.model.coefficients import Airframe
from station.model.energy_drag import drag_by_energy
from station.model.thrust import thrust_by_engine
from station.profile import Aircraft, Card, Doublet, Flight, Propeller, ThrustTable, load_aircraft
from station.profile.profile_text import to_toml
from station.rows import Frame
from station.simulation.sensors import STANDARD
from station.simulation.sortie import fly

PROPELLER = Propeller.model_validate({"kind": "propeller", "efficiency": [0.7, 0.8], "speeds": ["80 kt", "140 kt"]})
TABLE = ThrustTable.model_validate(
    {
        "kind": "table",
        "signal": "engine_speed",
        "settings": [0.6, 0.8, 1.0],
        "speeds": ["40 m/s", "80 m/s"],
        "altitudes": ["0 m", "2000 m"],
        "thrust": [[[2000.0, 1500.0], [1700.0, 1300.0]], [[5000.0, 4200.0], [4400.0, 3700.0]],
                   [[9000.0, 8000.0], [8000.0, 7100.0]]],
    }
)  # fmt: skip


def flown(aircraft: Aircraft, profile: Aircraft, *, without: tuple[str, ...] = (), truth: dict | None = None):
    """A record of two minutes in light turbulence: of one aircraft, by the profile of another."""
    flight = {"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": "5 ft/s", "seed": 3, "truth": truth or {}}
    card = Card(name="t", aircraft="", rig="", flight=Flight.model_validate(flight))
    shown, exact = fly(aircraft, STANDARD, card, 120.0, 3)
    columns = {n: x for n, x in shown.items() if n not in without}
    table = Table(exact["time"], columns, profile, 0)
    return flight_record(table.between(10.0, 120.0), profile)[0]


def test_a_glide_has_the_drag_of_its_ratio() -> None:
    """Without thrust, unaccelerated, CD/CL is the tangent of the glide's angle; CL = m g cos(gamma)/(qbar S)."""
    aircraft = load_aircraft("twin_otter")
    n, gamma, alpha, v, rho = 600, math.radians(-5.0), math.radians(4.0), 60.0, 1.1
    airframe = Airframe.of(aircraft)
    theta, pressure = alpha + gamma, 0.5 * rho * v * v
    steady = {"airspeed": v, "dynamic_pressure": pressure, "thrust": 0.0}
    steady |= {"ax": 9.80665 * math.sin(theta), "az": -9.80665 * math.cos(theta)}
    motion = {name: np.full(n, x) for name, x in steady.items()}
    made = drag_by_energy(motion, airframe, aircraft, np.full(n, alpha), np.arange(n) * 0.02)
    lift = airframe.mass * 9.80665 * math.cos(gamma) / (pressure * airframe.area)
    assert np.allclose(made.CL, lift, rtol=1e-9)
    assert np.allclose(made.CD, lift * math.tan(-gamma), rtol=1e-9)
    assert len(made.t_s) == 2  # of 12 s, two windows of 5 s
    assert aircraft.drag is not None
    polar = aircraft.drag.zero_lift + aircraft.drag.induced * lift**2
    assert np.allclose(made.imbalance, (lift * math.tan(-gamma) - polar) * pressure * airframe.area * v)


def test_a_vane_of_another_scale_makes_drag_of_motion() -> None:
    """As much as the profile says the scale may be wrong by: what drag by the larger angles is more, on the mean."""
    aircraft = load_aircraft("twin_otter")
    record = flown(aircraft, aircraft)
    alpha = record.alpha
    wrong = np.nanmean(alpha) + (1 + aircraft.uncertainty.vane_scale) * (alpha - np.nanmean(alpha))
    right, high = (drag_by_energy(record.motion, record.airframe, aircraft, a, record.t_s) for a in (alpha, wrong))
    assert np.mean(high.CD) - np.mean(right.CD) == pytest.approx(right.by_motion, rel=0.1)
    known = aircraft.uncertainty.model_copy(update={"vane_scale": 0.0})
    sure = aircraft.model_copy(update={"uncertainty": known})
    assert drag_by_energy(record.motion, record.airframe, sure, alpha, record.t_s).by_motion == 0.0


def test_the_polar_comes_out_and_half_as_much_again_is_told() -> None:
    aircraft = load_aircraft("twin_otter")
    assert aircraft.drag is not None
    clean = drag_of(flown(aircraft, aircraft))
    assert isinstance(clean, DragResult)
    assert clean.thrust == "recorded"
    assert abs(clean.change[0]) < 2 * clean.random  # thrust is exact here: only the scatter is left
    assert clean.random < 0.02 * clean.CD[0]
    assert clean.systematic_share > 0.03
    more = 0.5 * aircraft.drag.zero_lift
    draggy = aircraft.model_copy(
        update={"drag": aircraft.drag.model_copy(update={"zero_lift": aircraft.drag.zero_lift + more})}
    )
    iced = drag_of(flown(draggy, aircraft))
    assert isinstance(iced, DragResult)
    assert iced.change[0] == pytest.approx(more, rel=0.03)
    assert "the polar does not hold" in drag_lines(iced)[1]
    assert "as the polar has it" in drag_lines(clean)[1]


@pytest.mark.parametrize("engine", [PROPELLER, TABLE])
def test_an_engine_tells_the_thrust_that_is_not_recorded(engine: Propeller | ThrustTable) -> None:
    aircraft = load_aircraft("twin_otter").model_copy(update={"engine": engine})
    record = flown(aircraft, aircraft, without=("thrust",))
    found = drag_of(record)
    assert isinstance(found, DragResult)
    assert found.thrust == "engine"
    assert any("thrust by the profile's engine" in words for words in record.remarks)
    assert abs(found.change[0]) < 3 * found.random
    assert drag_json(found)["parameters"]["CD"]["std_error"] == pytest.approx(found.CD[1])


def test_without_thrust_nothing_is_said_of_drag() -> None:
    aircraft = load_aircraft("twin_otter")
    record = flown(aircraft, aircraft, without=("thrust",))
    assert drag_of(record) == UNKNOWN
    assert drag_json(UNKNOWN) == {"status": "not_applicable", "why": UNKNOWN}


def test_a_propeller_and_a_table_by_hand() -> None:
    """0.75 of 300 kW at 110 kt are 225 kW/56.6 m/s; half-way in each direction of the table its eight corners' mean."""
    aircraft = load_aircraft("twin_otter")
    v = np.array([110 * 1852 / 3600])
    made = thrust_by_engine(
        aircraft.model_copy(update={"engine": PROPELLER}), {"airspeed": v, "shaft_power": np.array([3e5])}
    )
    assert made == pytest.approx(0.75 * 3e5 / v)
    weak = PROPELLER.model_copy(update={"static_thrust": 3000.0})
    made = thrust_by_engine(
        aircraft.model_copy(update={"engine": weak}), {"airspeed": v, "shaft_power": np.array([3e5])}
    )
    assert made == pytest.approx([3000.0])
    at = {"airspeed": np.array([60.0, 60.0, 90.0]), "altitude": np.full(3, 1000.0)}
    at["engine_speed"] = np.array([0.7, 0.9, 0.9])
    made = thrust_by_engine(aircraft.model_copy(update={"engine": TABLE}), at)
    assert made is not None
    first = np.mean(np.array(TABLE.thrust)[:2])
    assert made[:2] == pytest.approx([first, np.mean(np.array(TABLE.thrust)[1:])])
    assert np.isnan(made[2])  # beyond the table's speeds


def test_a_table_that_is_exceeded_is_told() -> None:
    aircraft = load_aircraft("twin_otter").model_copy(update={"engine": TABLE})
    slow = TABLE.model_copy(update={"speeds": (20.0, 30.0)})
    record = flown(aircraft, aircraft.model_copy(update={"engine": slow}), without=("thrust",))
    assert any("says nothing of 100% of the record" in words for words in record.remarks)
    assert not record.thrust_known
    assert drag_json(drag_of(record))["why"].startswith("the engine's table says nothing of 100% of the record")


def test_in_flight_the_engine_takes_the_place_of_the_recorded_thrust() -> None:
    """eta P/V of a frame's own setting; one of six seconds ago is too old."""
    aircraft = load_aircraft("twin_otter").model_copy(update={"engine": PROPELLER})
    estimator = EngineThrust(aircraft)
    values = {"airspeed": 60.0, "shaft_power": 3e5, "altitude": 800.0}
    row = tuple(values.get(name, math.nan) for name in SIGNALS)
    fresh = tuple(0 for _ in row)
    eta = float(np.interp(60.0, PROPELLER.speeds, PROPELLER.efficiency))
    assert estimator.step(Frame(0, 0, row, (0.0,) * len(row), fresh)) == pytest.approx(eta * 3e5 / 60.0)
    assert math.isnan(estimator.step(Frame(0, 0, row, (6.0,) * len(row), fresh)))


@pytest.mark.slow
def test_derivatives_are_those_of_the_recorded_thrust() -> None:
    """Which the simulated engine gives exactly."""
    aircraft = load_aircraft("twin_otter").model_copy(update={"engine": PROPELLER})
    doublet = {"kind": "doublet", "start": "12 s", "repeat": "12 s", "amplitude": "3 deg", "width": "0.8 s"}
    flight = Flight.model_validate({"speed": "110 kt", "altitude": "2500 ft", "seed": 3})
    card = Card(name="t", aircraft="", rig="", flight=flight, manoeuvres=(Doublet.model_validate(doublet),))
    shown, exact = fly(aircraft, STANDARD, card, 50.0, 3)
    found = []
    for left_out in ("thrust", "shaft_power"):
        columns = {n: x for n, x in {**shown, "thrust": exact["thrust"]}.items() if n != left_out}
        table = Table(exact["time"], columns, aircraft, 0)
        result = identify(table, aircraft, Request(["II"], 5.0, card=card)).methods["II"]
        found.append([p.value for p in result.parameters if p.name in LONGITUDINAL])
    assert np.allclose(found[0], found[1], rtol=2e-3)


@pytest.mark.parametrize("engine", [PROPELLER, TABLE])
def test_a_written_profile_keeps_its_engine(engine: Propeller | ThrustTable, tmp_path) -> None:
    aircraft = load_aircraft("twin_otter").model_copy(update={"engine": engine})
    (tmp_path / "mine.toml").write_text(to_toml(aircraft, ""))
    assert load_aircraft(str(tmp_path / "mine.toml")).engine == engine
