"""Probes of pressure holes, against a sphere in potential flow: Cp = 1 - 9/4 sin^2 of the angle to the stagnation point
(L. M. Milne-Thomson, Theoretical Hydrodynamics, 15.30), of which no formula is in the station."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.adapter import Adapter, check_devices
from drivers.emulated_messages import DeviceScript
from drivers.probe_pressures import ProbePressures, ProbeReader
from drivers.protocols import protocol_named
from station.clock import ManualClock
from station.profile import Rig, SerialDevice, StreamProfile, load_card, load_rig, profiles_dir
from station.rows import Code, Event, ProfileError, Rows, Sample

HOLES = math.radians(45)
RIG = profiles_dir() / "rigs" / "five_hole.toml"
FIVE = {"c0": (0, 0), "c1": (0, -HOLES), "c2": (0, HOLES), "c3": (-HOLES, 0), "c4": (HOLES, 0)}
"""Field: how far the hole is to the right and below the axis."""


def sphere(holes: Mapping[str, tuple[float, float]], alpha: float, beta: float, q: float) -> dict[str, float]:
    """Pressures of holes on a sphere against static pressure."""
    wind = np.array([math.cos(alpha) * math.cos(beta), math.sin(beta), math.sin(alpha) * math.cos(beta)])
    found = {}
    for name, (right, below) in holes.items():
        hole = np.array([math.cos(right) * math.cos(below), math.sin(right), math.cos(right) * math.sin(below)])
        cosine = float(wind @ hole)
        found[name] = q * (1 - 9 / 4 * (1 - cosine**2))
    return found


def five_hole() -> StreamProfile:
    return load_rig("five_hole").devices[0].streams[0]


def stream(probe: Mapping[str, Any], **signals: Mapping[str, Any]) -> StreamProfile:
    raw = {"name": "air", "message": "line", "rate": "100 Hz", "signals": signals, "probe": probe}
    return StreamProfile.model_validate(raw)


@pytest.mark.parametrize("q", [60.0, 1800.0])
def test_five_holes_of_a_sphere_give_its_angles_within_what_the_rig_says_of_its_calibration(q: float) -> None:
    reader = ProbeReader(five_hole())
    air = {"c5": 90_000.0, "c6": 5.0}
    for alpha in range(-16, 17, 4):
        for beta in range(-16, 17, 4):
            fields = sphere(FIVE, math.radians(alpha), math.radians(beta), q) | air
            made, news = reader.read(fields)
            assert news == []
            assert made["probe.alpha"] == pytest.approx(alpha, abs=0.04)
            assert made["probe.beta"] == pytest.approx(beta, abs=0.04)
            assert made["probe.dynamic_pressure"] == pytest.approx(q, rel=0.0013)
            speed = math.sqrt(2 * q * 287.05287 * 278.15 / 90_000.0)
            assert made["probe.airspeed"] == pytest.approx(speed, rel=0.00065)


def knots() -> list[list[float]]:
    """Of three holes of a sphere, 2 cot(holes) tan(2 alpha) is the ratio: solved for alpha, in deg."""
    return [[2 / math.tan(HOLES) * math.tan(2 * a), math.degrees(a)] for a in np.radians(range(-20, 21, 2)).tolist()]


THREE = {port: {"field": f"c{i}", "unit": "hPa", "slope": 0.01} for i, port in enumerate(("centre", "up", "down"))}
ALPHA = {"field": "probe.alpha", "unit": "deg"}


def test_a_table_is_exact_at_its_points_and_straight_between_them() -> None:
    reader = ProbeReader(stream({"ports": THREE, "alpha": {"unit": "deg", "table": knots()}}, alpha_vane=ALPHA))
    holes = {"c0": (0.0, 0.0), "c1": (0.0, -HOLES), "c2": (0.0, HOLES)}
    for alpha in np.arange(-19.5, 19.6, 0.5).tolist():
        made, _ = reader.read(sphere(holes, math.radians(alpha), 0.0, 900.0))
        # A chord of atan(ratio/2)/2 lies within h^2/8 of its greatest curvature, 0.0812 rad; h is at most 0.226.
        allowed = 1e-9 if alpha % 2 == 0 else math.degrees(0.226**2 / 8 * 0.0812)
        assert made["probe.alpha"] == pytest.approx(alpha, abs=allowed)


def test_differential_transducers_are_ratios_to_the_pitot() -> None:
    ports = {"down_minus_up": {"field": "c0", "unit": "Pa"}, "reference": {"field": "c1", "unit": "Pa"}}
    curve = {"unit": "rad", "table": [[-2, -0.4], [0, 0.0], [2, 0.4]]}
    reader = ProbeReader(stream({"ports": ports, "alpha": curve}, alpha_vane={"field": "probe.alpha", "unit": "deg"}))
    made, _ = reader.read({"c0": 500.0, "c1": 1000.0})
    assert made["probe.alpha"] == pytest.approx(math.degrees(0.1))


def test_beyond_the_calibration_nothing_is_said_of_the_flow_but_once_that_it_is_so() -> None:
    reader = ProbeReader(five_hole())
    far = sphere(FIVE, math.radians(30), 0.0, 1800.0)
    for i in range(5):
        made, news = reader.read(far)
        assert all(math.isnan(made[f"probe.{n}"]) for n in ("alpha", "beta", "dynamic_pressure", "airspeed"))
        assert len(news) == (i == 0)
        if news:
            assert "the alpha ratio is +2.77, calibrated from -1.6 to +1.6" in news[0]
    assert not math.isnan(reader.read(sphere(FIVE, 0.1, 0.0, 1800.0))[0]["probe.alpha"])


@pytest.mark.parametrize("q", [-5.0, 0.0, 10.0])
def test_standing_still_gives_no_angles_and_no_division_by_zero(q: float) -> None:
    reader = ProbeReader(five_hole())
    made, news = reader.read(sphere(FIVE, 0.0, 0.0, q))
    assert math.isnan(made["probe.alpha"])
    assert "below 39.2 Pa" in news[0]
    assert reader.read(sphere(FIVE, 0.0, 0.0, q))[1] == []


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_hole_without_a_reading_takes_what_needs_it_with_it(bad: float) -> None:
    made, _ = ProbeReader(five_hole()).read(sphere(FIVE, 0.1, 0.0, 1800.0) | {"c1": bad})
    assert math.isnan(made["probe.alpha"])
    assert math.isnan(made["probe.dynamic_pressure"])


def test_an_emulated_probe_shows_pressures_of_which_its_angles_are_read() -> None:
    air = five_hole()
    reader, pressures = ProbeReader(air), ProbePressures(air)
    random = np.random.default_rng(3)
    for alpha, beta, q in random.uniform((-18, -9, 60), (18, 9, 3000), (200, 3)).tolist():
        given = {"probe.alpha": alpha, "probe.beta": beta, "probe.dynamic_pressure": q, "c5": 9e4, "c6": 10.0}
        fields = pressures.fields_of(given)
        assert fields.keys() == {f"c{i}" for i in range(7)}
        made, news = reader.read(fields)
        assert news == []
        assert made["probe.alpha"] == pytest.approx(alpha, abs=1e-6)
        assert made["probe.beta"] == pytest.approx(beta, abs=1e-6)
        assert made["probe.dynamic_pressure"] == pytest.approx(q)


def test_an_emulated_probe_beyond_its_calibration_is_not_believed() -> None:
    air = five_hole()
    reader, pressures = ProbeReader(air), ProbePressures(air)
    for alpha in (35.0, -60.0, math.nan):
        given = {"probe.alpha": alpha, "probe.beta": 0.0, "probe.dynamic_pressure": 1500.0}
        assert math.isnan(reader.read(pressures.fields_of(given))[0]["probe.alpha"])
    fields = pressures.fields_of({"probe.alpha": 3.0, "probe.beta": 1.0, "probe.dynamic_pressure": 1500.0})
    assert reader.read(fields)[0]["probe.alpha"] == pytest.approx(3.0, abs=1e-6)


def test_bytes_of_the_emulated_device_become_samples_and_one_event() -> None:
    device, card = load_rig("five_hole").devices[0], load_card("five_hole").card
    protocol = protocol_named("lines")
    script = DeviceScript(0, device, card, 0, protocol.encode)
    n = 40
    truth = {"alpha_vane": 0.05, "beta_vane": -0.02, "dynamic_pressure": 1800.0, "airspeed": 57.0}
    rows = np.tile(
        [{**truth, "static_pressure": 92_000.0, "air_temperature": 283.0}[s] for s in script.signals], (n, 1)
    )
    data = [script.encode(m) for m in script.extend(rows)]
    assert data[0].startswith(b"probe,")
    clock, rows_put = ManualClock(), list[Rows]()
    adapter = Adapter(device, protocol.codec(), lambda: pytest.fail("not opened"), clock, rows_put.append)
    # The first line of a stream may lack its beginning and is passed over.
    for block in [data[0], *data, b"probe,0,0,0,0,0,92000,10\r\n", b"probe,0,0,0,0,0,92000,10\r\n"]:
        adapter.take(block)
    samples = [r for r in rows_put if isinstance(r, Sample)]
    values = np.array([s.values for s in samples])
    alpha = values[: len(data), 0]
    # Noise of 0.05 deg, its mean over these messages within four standard errors.
    assert alpha.mean() == pytest.approx(0.05, abs=4 * math.radians(0.05) / math.sqrt(len(data)))
    assert np.isnan(values[-2:, :4]).all()
    assert values[-1, 4] == 92_000.0
    events = [r for r in rows_put if isinstance(r, Event) and r.code == Code.RANGE]
    assert [e.detail.split(":")[0] for e in events] == ["probe.air"]
    assert not any(t.name.startswith("adapter-") for t in threading.enumerate())


def altered(tmp_path: Path, old: str, new: str) -> str:
    """What is said of the rig with one piece of its text another."""
    text = RIG.read_text()
    assert old in text
    path = tmp_path / "mine.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ProfileError) as caught:
        check_devices(load_rig(str(path)), path)
    assert str(path) in str(caught.value)
    assert "it is {" not in str(caught.value), "a whole table says nothing"
    return str(caught.value)


UP = 'up = { field = "c1", unit = "Pa" }\n'
FIRST = "[[14.3077, 1, 0],"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (UP, "", "up is missing"),
        ('centre = { field = "c0"', 'center = { field = "c0"', "center"),
        ('up = { field = "c1"', 'up = { field = "c2"', "up and down are both c2: their difference is always 0"),
        ('up = { field = "c1"', 'up = { field = "d1"', "probe.ports.up: probe has no field d1"),
        ('up = { field = "c1", unit = "Pa"', 'up = { field = "c1", unit = "deg"', "is none of pressure"),
        ("alpha_ratio = [-1.6, 1.6]", "alpha_ratio = [1.6, -1.6]", "nothing is calibrated from 1.6 to -1.6"),
        ("alpha_ratio = [-1.6, 1.6]\n", "", "give alpha_ratio = [lowest, highest]"),
        (FIRST, "[[1.0, 1, 0],", "alpha: not monotonic: the angle turns back at a ratio of"),
        (FIRST, "[[14.3, 1],", "a row is [c, i, j]"),
        (FIRST, "[[14.3, 0.5, 0],", "no whole numbers"),
        (FIRST, "[[14.3, -1, 0],", "its powers 0 or more"),
        ("[[0.889185, 0, 0],", "[[-0.889185, 0, 0],", "must be above 0"),
        ('unit = "deg"\npolynomial', 'unit = "Pa"\npolynomial', "unit 'Pa' does not fit"),
        ('unit = "deg"\npolynomial', 'unit = "deg"\ntable = [[0, 0], [1, 1]]\npolynomial', "one of them"),
        ('field = "probe.alpha", unit = "deg"', 'field = "probe.alfa", unit = "deg"', "did you mean probe.alpha?"),
        ('field = "probe.alpha", unit = "deg"', 'field = "probe.alpha", unit = "Pa"', "Pa"),
        ('field = "probe.beta"', 'field = "probe.alpha"', "probe.alpha is alpha_vane already"),
        ("static_pressure = {", "# static_pressure = {", "probe.airspeed lacks dynamic_pressure, and static_pressure"),
    ],
)
def test_what_is_wrong_with_a_probe_is_said(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert words in altered(tmp_path, old, new)


def test_a_table_that_turns_back_and_one_without_change_are_refused() -> None:
    for table in ([[-1, -10], [0, 5], [1, 4]], [[-1, 3], [1, 3]]):
        with pytest.raises(ValueError, match=r"not monotonic|does not change"):
            stream({"ports": THREE, "alpha": {"unit": "deg", "table": table}}, alpha_vane=ALPHA)


def test_a_field_of_a_probe_without_a_probe_and_a_probe_without_a_field_are_refused() -> None:
    raw = {"name": "air", "message": "line", "rate": "100 Hz", "signals": {"alpha_vane": ALPHA}}
    with pytest.raises(ValueError, match=r"needs a \[devices.streams.probe\]"):
        StreamProfile.model_validate(raw)
    with pytest.raises(ValueError, match="no signal is made of it"):
        stream({"ports": THREE, "alpha": {"unit": "deg", "table": knots()}}, beta_vane={"field": "c5", "unit": "deg"})


def test_two_probes_in_one_message_are_refused() -> None:
    device = load_rig("five_hole").devices[0].model_dump()
    device["streams"] = [device["streams"][0], {**device["streams"][0], "name": "again"}]
    with pytest.raises(ValueError, match="two streams of message 'probe' have a probe"):
        SerialDevice.model_validate(device, context="si")


def test_a_recorded_rig_keeps_its_probe() -> None:
    from station.profile import from_json, to_json

    rig = load_rig("five_hole")
    assert from_json(Rig, to_json(rig)) == rig
