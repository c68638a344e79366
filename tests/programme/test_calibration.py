"""Calibration flights of the simulation, which shares no formula with the estimate: what is planted is found."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from station.__main__ import app
from station.commands.calibrate import calibrate
from station.commands.simulate import simulate
from station.flight.step_plan import planned
from station.log import About, Table
from station.model.air_data_calibration import headed
from station.model.vane_in_motion import Stretch, vane_in_motion
from station.numerics.regression import NotIdentifiable
from station.profile import Aircraft, Instrument, load_aircraft, load_card
from station.profile.profile_text import write_profile
from station.programme.calibration import Calibration
from station.programme.calibration import calibrate as programme_of
from station.programme.calibration_blocks import opened
from station.rows import UsageError
from station.simulation.sortie import fly

HEAD = """
name = "test"
aircraft = "{aircraft}"
rig = "{rig}"
[flight]
speed = "110 kt"
altitude = "2500 ft"
gust_sigma = "0.5 ft/s"
wind_north = "7 m/s"
wind_east = "-5 m/s"
legs = [{legs}]
"""
LEGS = """
{ start = "40 s", heading = "180 deg" }, { start = "140 s", speed = "130 kt" }, { start = "220 s", heading = "0 deg" },
{ start = "330 s", speed = "90 kt" }
"""
TRUTH = """
[flight.truth]
"boom.zero" = { at = ["0 s"], value = ["0.8 deg"] }
"boom.upwash_body" = { at = ["0 s"], value = [0.12] }
"instruments.airspeed.bias" = { at = ["0 s"], value = [-2.0] }
"instruments.airspeed.gain" = { at = ["0 s"], value = [1.05] }
"static_position" = { at = ["0 s"], value = [0.04] }
"""
INPUT = """
[[manoeuvres]]
kind = "multisine"
start = "108 s"
duration = "24 s"
amplitude = "2.5 deg"
low = "0.1 Hz"
high = "1.5 Hz"
"""
LATE_S = 0.06
LATER = """
[[manoeuvres]]
kind = "3-2-1-1"
start = "25 s"
repeat = "25 s"
amplitude = "-2.5 deg"
unit = "0.5 s"
"""


def flown(
    folder: Path, seconds: float, legs: str = "", more: str = "", rig: str = "boom_thrust", late: float = 0.0
) -> Path:
    """`late`: the vane's, s; the log has that aircraft's profile."""
    card, log, profile = folder / "card.toml", folder / "flight.mcap", folder / "flown.toml"
    vane = {"alpha_vane": Instrument.model_validate({"latency": f"{late} s"})}
    write_profile(load_aircraft("twin_otter").model_copy(update={"instruments": vane}), profile, "flown")
    card.write_text(HEAD.format(aircraft=profile, rig=rig, legs=legs.replace("\n", " ")) + more)
    simulate(str(card), log, None, 3, seconds)
    return log


@pytest.fixture(scope="module")
def programme(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return flown(tmp_path_factory.mktemp("calibration"), 440.0, LEGS, TRUTH + INPUT, late=LATE_S)


def test_finds_what_was_planted_and_writes_it(programme: Path, tmp_path: Path) -> None:
    page, profile = tmp_path / "found.json", tmp_path / "mine.toml"
    calibrate([programme], profile, "twin_otter", str(page), tmp_path / "report")
    found = json.loads(page.read_text())
    assert found["schema"] == "station.calibrate/1"
    constants = found["constants"]
    speed = found["position_error"]["reference_speed_mps"]
    truth = {
        "airspeed_error": -2.0 + 0.05 * speed,
        "airspeed_slope": 0.05,
        "vane_zero": math.radians(0.8),
        "static_position": 0.04,
        "pitot_position": 0.04,
        "upwash": 0.12 + 0.107,
        "vane_delay": LATE_S,
        "vane_x": 5.3,
    }
    accuracy = {"airspeed_error": 0.5, "vane_zero": math.radians(0.3), "upwash": 0.05, "vane_delay": 0.02}
    for name, true in truth.items():
        c = constants[name]
        assert c["status"] == "estimated", name
        assert abs(c["estimate"] - true) < 3.5 * c["std_error"], name
        assert c["std_error"] < accuracy.get(name, 1.0), name
    wind = found["wind"]
    assert np.mean(wind["north_mps"]) == pytest.approx(7.0, abs=0.7)
    assert np.mean(wind["east_mps"]) == pytest.approx(-5.0, abs=0.7)
    made = load_aircraft(str(profile))
    assert made.boom is not None
    assert made.calibrated is not None
    assert made.calibrated.date == "simulated"
    assert made.static_position == pytest.approx(constants["static_position"]["estimate"])
    assert made.calibrated.static_position_sd == pytest.approx(constants["static_position"]["std_error"])
    assert abs(constants["upwash_slope"]["estimate"] or 0.0) < 0.07
    assert made.boom.zero == pytest.approx(constants["vane_zero"]["estimate"])
    assert made.boom.upwash_body + made.boom.upwash_wing == pytest.approx(constants["upwash"]["estimate"])
    assert made.uncertainty.vane_delay == pytest.approx(constants["vane_delay"]["std_error"])
    assert made.uncertainty.dynamic_pressure == pytest.approx(constants["pressure_scale"]["std_error"])
    errors = made.instruments["airspeed"]
    assert errors.gain * speed + errors.bias - speed == pytest.approx(constants["airspeed_error"]["estimate"])
    assert made.calibrated.vane_zero_sd == pytest.approx(constants["vane_zero"]["std_error"])
    shown = (tmp_path / "report" / "calibration.html").read_text()
    assert len(shown) > 50_000
    sentence = shown.partition('<p class="verdict">')[2].partition("</p>")[0]
    zero, half = (
        math.degrees(constants["vane_zero"]["estimate"]),
        math.degrees(constants["vane_zero"]["std_error"]) * 1.96,
    )
    told = re.search(r"its alpha vane reads ([\d.]+) ± ([\d.]+) deg high", sentence)
    assert told is not None
    assert (float(told[1]), float(told[2])) == pytest.approx((zero, half), abs=0.005)
    assert "NOT calibrated" not in sentence
    with pytest.raises(UsageError, match="never replaces"):
        calibrate([programme], profile, "twin_otter", None, None)


@pytest.mark.slow
def test_calibrated_profile_finds_the_same_again(programme: Path, tmp_path: Path) -> None:
    """Stated errors are taken out and found anew, not twice."""
    first, second, profile = tmp_path / "1.json", tmp_path / "2.json", tmp_path / "mine.toml"
    calibrate([programme], profile, "twin_otter", str(first), None)
    calibrate([programme], None, str(profile), str(second), None)
    a, b = (json.loads(p.read_text())["constants"] for p in (first, second))
    for name in ("airspeed_error", "airspeed_slope", "vane_zero", "upwash"):
        assert b[name]["estimate"] == pytest.approx(a[name]["estimate"], abs=a[name]["std_error"]), name
        assert b[name]["before"] == pytest.approx(a[name]["estimate"], abs=1e-6), name


@pytest.mark.slow
def test_the_next_diagnosis_finds_nothing_more(programme: Path, tmp_path: Path) -> None:
    """Another flight of the same aircraft, in other gusts: with the profile written nothing is wrong, with the one
    before the vane is late."""
    profile, next_flight = tmp_path / "mine.toml", tmp_path / "next"
    calibrate([programme], profile, "twin_otter", None, None)
    next_flight.mkdir()
    log = flown(next_flight, 80.0, more=TRUTH + LATER, late=LATE_S)
    found = {}
    for name in (str(profile), "twin_otter"):
        page = tmp_path / f"{Path(name).stem}.json"
        app(["diagnose", str(log), "--aircraft", name, "--json", str(page)], prog_name="station", standalone_mode=False)
        found[name] = json.loads(page.read_text())
    assert found[str(profile)]["verdict"] == "no_effect"
    assert found["twin_otter"]["verdict"] != "no_effect"
    assert "alpha_vane.delay" in {e["id"] for e in found["twin_otter"]["effects"]}


def told_of(log: Path, changed: Callable[[str, np.ndarray, np.ndarray], np.ndarray | None]) -> Calibration:
    """A calibration of the log with its columns changed; `changed` takes name, times and values, None leaves it out."""

    def read(path: Path) -> tuple[Table, About]:
        whole, about = opened(path)
        made = {n: changed(n, whole.t_s, c) for n, c in whole.columns.items()}
        return replace(whole, columns={n: c for n, c in made.items() if c is not None}), about

    return programme_of([log], load_aircraft("twin_otter"), read=read)


@pytest.mark.slow
def test_a_record_that_begins_before_its_frames_keeps_every_signal(programme: Path) -> None:
    """As every live one does: the first 20 s have no values. Heading was lost with them for all of the flight."""
    whole = told_of(programme, lambda _, t, c: c)
    late = told_of(programme, lambda _, t, c: np.where(t - t[0] < 20.0, math.nan, c))
    assert late.constants.keys() == whole.constants.keys()
    assert "psi_zero" in late.constants
    seldom = told_of(programme, lambda n, t, c: np.where(t % 8 > 2, math.nan, c) if n == "ay" else c)
    assert "ay_zero" not in seldom.constants
    assert any("ay is missing in more than half" in words for words in seldom.remarks)
    assert seldom.constants["psi_zero"].sd == pytest.approx(whole.constants["psi_zero"].sd, rel=0.3)


@pytest.mark.slow
def test_turns_tell_the_same_without_a_recorded_heading(tmp_path: Path) -> None:
    """Banked, the nose points off the path by some of the angle of attack: taken for its heading, the path made a
    degree of the vane's zero."""
    legs = """{ start = "40 s", heading = "180 deg" }, { start = "140 s", speed = "85 kt" },
    { start = "240 s", speed = "110 kt", bank = "30 deg" }, { start = "400 s", bank = "-30 deg" }"""
    log = flown(tmp_path, 560.0, legs, TRUTH + INPUT)
    for lacking in ("", "psi"):
        found = told_of(log, lambda n, _, c, lacking=lacking: None if n == lacking else c).constants["vane_zero"]
        assert abs(found.value - math.radians(0.8)) < 3 * found.sd
        assert found.sd < math.radians(0.15)


@pytest.mark.parametrize("bank", [0.0, 30.0, -45.0])
def test_the_heading_of_a_path_by_rotations_of_another_hand(bank: float) -> None:
    angles = np.radians([[120.0, 4.0, bank], [-170.0, -3.0, bank]])
    alpha, beta = np.radians([5.0, 2.0]), np.radians([1.0, -2.0])
    body = 60.0 * np.stack([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)], axis=1)
    air = Rotation.from_euler("ZYX", angles).apply(body)
    assert np.unwrap(headed(air, angles[:, 2], angles[:, 1], beta) - angles[:, 0]) == pytest.approx([0, 0], abs=1e-12)


def told_in_still_air(folder: Path, aircraft: Aircraft) -> Calibration:
    """The card `calibration` flown by the aircraft: all that is left is sensors' noise."""
    profile = folder / "flown.toml"
    write_profile(aircraft, profile, "flown")
    still = {"flight.truth": {}, "flight.gust_sigma": "0 ft/s", "flight.wind_walk": "0 m/s"}
    card = load_card("calibration", overrides={"aircraft": str(profile), **still})
    steps, seconds = planned(card.card)
    shown, truth = fly(card.aircraft, card.rig, steps, math.ceil(seconds), 3)
    recorded = Table(truth["time"], shown, card.aircraft, 0)
    about = About(card.aircraft, (), card.rig, card.card, "simulation", imported=True)
    return programme_of([profile], load_aircraft("twin_otter"), read=lambda _: (recorded, about))


def test_a_wing_whose_upwash_is_another_one(tmp_path: Path) -> None:
    """In a turn the upwash of the wing meets no pitch rate, and its memory has two rates of their own. Either
    taken for the profile's, the vane's zero was six to eight standard errors off here."""
    nominal = load_aircraft("twin_otter")
    assert nominal.boom is not None
    memory = nominal.unsteady.upwash_motion
    assert memory is not None
    other = memory.model_copy(update={"b": (memory.b[0] * 1.4, memory.b[1] / 1.4)})
    boom = nominal.boom.model_copy(update={"upwash_wing": 0.15, "upwash_body": -0.04, "vane_x": 5.7})
    unsteady = nominal.unsteady.model_copy(update={"upwash_motion": other})
    found = told_in_still_air(tmp_path, nominal.model_copy(update={"boom": boom, "unsteady": unsteady}))
    assert "upwash_wing" not in found.constants
    for name, true in {"vane_zero": 0.0, "theta_zero": 0.0, "upwash": 0.11, "vane_x": 5.7, "vane_delay": 0.0}.items():
        told = found.constants[name]
        assert abs(told.value - true) < 3 * told.sd, name
    assert found.constants["vane_x"].sd < 0.15


@pytest.mark.slow
def test_a_boom_that_bends_under_an_airspeed_that_reads_high(tmp_path: Path) -> None:
    """Dynamic pressure over indicated airspeed is no density: 20 % off, it made 0.016 of upwash, seven standard errors.
    Means over the roll from one turn into the other made 0.2 deg of bank."""
    errors = {
        "airspeed": Instrument(gain=1.067, bias=2.4),
        "alpha_vane": Instrument.model_validate({"latency": "45 ms"}),
    }
    nominal = load_aircraft("twin_otter")
    assert nominal.boom is not None
    bending = nominal.boom.model_copy(update={"tip_load": -0.024})
    found = told_in_still_air(tmp_path, nominal.model_copy(update={"instruments": errors, "boom": bending}))
    whole, load = 1 + bending.upwash_body + bending.upwash_wing, found.steady.pressure / 1000
    planted = {
        "upwash": whole * (1 - 0.024 * load) - 1,
        "upwash_slope": -0.024 * whole,
        "vane_delay": 0.045,
        "vane_x": bending.vane_x,
    }
    for name, true in planted.items():
        told = found.constants[name]
        assert abs(told.value - true) < 3.5 * told.sd, name
    assert found.constants["upwash"].sd < 0.004
    assert abs(found.steady.value("phi_zero")) < math.radians(0.1)
    assert abs(found.steady.value("ay_zero")) < 0.02


def test_slow_samples_tell_no_lag() -> None:
    still = np.zeros(200)
    slow = Stretch(still, still, still, still + 60.0, still, still, 0.2)
    with pytest.raises(NotIdentifiable, match="5 Hz or less"):
        vane_in_motion([slow], load_aircraft("twin_otter"), 0.3)


def test_one_heading_at_one_speed_says_what_it_cannot_tell(tmp_path: Path) -> None:
    page = tmp_path / "found.json"
    assert calibrate([flown(tmp_path, 100.0)], None, None, str(page), None) == 3
    constants = json.loads(page.read_text())["constants"]
    assert "one heading" in constants["airspeed_error"]["why"]
    assert constants["airspeed_error"]["estimate"] is None
    assert "one angle of attack" in constants["vane_zero"]["why"]
    assert "no dynamic input" in constants["vane_delay"]["why"]


def test_too_short_and_without_gnss_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="a calibration needs 60 s"):
        calibrate([flown(tmp_path, 30.0)], None, None, None, None)
