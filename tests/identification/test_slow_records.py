"""Records slower than the station's ticks, down to 5 Hz: every method, from the lines that the rate supports."""

from __future__ import annotations

import functools
import gzip
import json
import math
from pathlib import Path

import numpy as np
import pytest
from records import record as real

from station.conventions import SIGNAL_INDEX
from station.convert import import_file
from station.identification.analysis import identify
from station.identification.identified import Identification
from station.identification.request import Request
from station.identification.signs_and_units import mistakes
from station.identification.table_frames import frames
from station.log import Table, table
from station.profile import Card, Doublet, Flight, load_aircraft, load_rig
from station.rows import Quality, Status
from station.simulation.sortie import fly

AIRCRAFT, RIG = load_aircraft("twin_otter"), load_rig("bench")
FOUR = ("CL_alpha", "Cm_alpha", "Cm_q", "Cm_de")


def slow(t: np.ndarray, **columns: np.ndarray) -> Table:
    return Table(t, columns, AIRCRAFT, 0)


@pytest.mark.parametrize("rate", [5, 10, 25, 32])
def test_frames_of_a_slow_record_follow_it_to_a_fifth_of_its_rate(rate: int) -> None:
    """A sine sampled slowly keeps what a cubic spline has of it, sinc^4(x)/((2 + cos 2 pi x)/3) at x = 1/5 of the rate:
    99.5 %, and no phase. (A straight line has sinc^2: 87.5 %.)"""
    t = np.arange(0.0, 20.0, 1 / rate)
    omega = 2 * math.pi * rate / 5
    made = frames(slow(t, q=0.1 * np.sin(omega * t)))
    at = np.array([f.t_ns * 1e-9 for f in made])
    q = np.array([f.values[SIGNAL_INDEX["q"]] for f in made])
    assert np.allclose(np.diff(at), 0.02)
    inside = (at > 2) & (at < 18)
    sine = np.column_stack([np.sin(omega * at), np.cos(omega * at)])[inside]
    there = np.linalg.lstsq(sine, q[inside], rcond=None)[0]
    kept = np.sinc(0.2) ** 4 / ((2 + math.cos(0.4 * math.pi)) / 3)
    assert there == pytest.approx([0.1 * kept, 0.0], abs=3e-5)


def test_a_hole_and_a_held_signal_stay_what_they_are() -> None:
    t = np.arange(0.0, 20.0, 0.1)
    t = t[(t < 8.0) | (t > 9.0)]
    down = np.floor(t)  # a velocity once a second, held between
    quality = {"v_down": np.where(np.isclose(t, down), Quality.FRESH, Quality.HELD).astype(np.uint8)}
    made = frames(Table(t, {"q": np.sin(t), "v_down": down}, AIRCRAFT, 0, quality=quality))
    at = np.array([f.t_ns * 1e-9 for f in made])
    q, v = (np.array([f.values[SIGNAL_INDEX[n]] for f in made]) for n in ("q", "v_down"))
    hole = (at > 7.901) & (at < 9.099)
    assert np.isnan(q[hole]).all()
    assert np.isfinite(q[~hole]).all()
    assert set(v[~hole]) <= set(down)


@functools.cache
def flown() -> dict[str, np.ndarray]:
    """Calm air: what the rate loses is then all that differs."""
    gentle = {"kind": "doublet", "amplitude": "2.5 deg", "width": "2 s"}
    doublets = tuple(Doublet.model_validate({**gentle, "start": f"{s} s"}) for s in (22, 34))
    flight = Flight.model_validate({"speed": "110 kt", "altitude": "2500 ft"})
    card = Card(name="t", aircraft="t", rig="bench", flight=flight, manoeuvres=doublets)
    return fly(AIRCRAFT, RIG, card, 46.0, 9)[0]


@functools.cache
def at_rate(rate: int) -> Identification:
    every = 50 // rate
    shown = {n: c[::every] for n, c in flown().items() if n not in ("pdot", "qdot", "rdot")}
    rows = slow(np.arange(len(shown["q"])) * 0.02 * every, **shown)
    return identify(rows, AIRCRAFT, Request(["physical", "split", "II"], 20.0, noise=RIG.noise_si()))


@pytest.mark.parametrize("rate", [25, 10, 5])
def test_a_slow_record_gives_the_derivatives_of_the_fast_one(rate: int) -> None:
    fast, found = at_rate(50), at_rate(rate)
    for method in ("physical", "split"):
        for name in FOUR:
            one, other = fast.methods[method].parameter(name), found.methods[method].parameter(name)
            assert one is not None
            assert other is not None
            assert other.status is Status.ESTIMATED
            # Airframe errors are the same in both.
            assert abs(other.value - one.value) < 2 * math.hypot(one.sd, other.sd), (method, name)
    assert found.methods["split"].settings["frequencies_hz"][2] == min(2.0, rate / 5)
    said = [r for r in found.remarks if r.startswith("recorded at")]
    assert said == ([] if rate > 5 else ["recorded at 5 Hz: lines from 0.1 to 1 Hz are used"])


def test_below_5_hz_nothing_is_made_of_the_flight() -> None:
    shown = {n: c[::20] for n, c in flown().items()}
    found = identify(slow(np.arange(len(shown["q"])) * 0.4, **shown), AIRCRAFT, Request(["split"], 20.0))
    assert found.methods["split"].why == "recorded at 2.5 Hz: needs 5 Hz or more"


@pytest.mark.parametrize("number", [19, 33])
def test_at_25_hz_in_turbulence_the_gusts_are_told_apart(number: int, tmp_path: Path) -> None:
    """Foreign flights at 25 Hz: only the vane's methods were left, 20 to 46 % off and sure of it."""
    name = f"identify_{number}"
    answers = json.loads(real("flights/answers.json").read_text())[name]
    text, log = tmp_path / "a.csv", tmp_path / "a.mcap"
    text.write_bytes(gzip.decompress(real(f"flights/{name}.csv.gz").read_bytes()))
    import_file(text, log, AIRCRAFT)
    found = identify(table(log), AIRCRAFT, Request(["physical", "split", "split+gust", "I"], 20.0))
    assert answers["rate_hz"] == 25
    assert found.recommended in ("physical", "split+gust")
    best, plain = found.methods[found.recommended], found.methods["I"]
    for p in best.parameters:
        assert p.status is Status.ESTIMATED
    for p in plain.parameters:
        truth = answers["quasi_steady"][p.name]
        assert p.status is not Status.ESTIMATED or abs(p.value - truth) < 2.5 * p.sd


@pytest.mark.parametrize("number", [31, 37])
def test_a_zero_of_the_accelerometer_in_level_flight_is_no_wrong_unit(number: int, tmp_path: Path) -> None:
    """At a steady speed along a level path all forward accelerations are smaller than instruments' zeros."""
    text, log = tmp_path / "a.csv", tmp_path / "a.mcap"
    text.write_bytes(gzip.decompress(real(f"flights/identify_{number}.csv.gz").read_bytes()))
    import_file(text, log, AIRCRAFT)
    rows = table(log).between(20.0, 1e3)
    assert mistakes(rows.t_s, rows.columns, AIRCRAFT) == ()
