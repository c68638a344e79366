"""A recording as columns: frames as they are, imports on their own grid, the rest aligned at 50 Hz; test points."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from station.conventions import SIGNAL_INDEX, SIGNALS, TICK_NS, Stream
from station.log import About, points, table, write_log
from station.profile import load_aircraft, load_rig
from station.rows import Code, Event, Extra, Frame, LogError, Quality, Rows, Sample, Tick, Truth

AIRCRAFT = load_aircraft("twin_otter")
FAST = Stream("can.gyro", ("p", "q"), 200.0, 0.1, "can", 0.010)
SLOW = Stream("autopilot.attitude", ("psi",), 10.0, 0.5, "autopilot")


def frame(k: int, **values: float) -> Frame:
    row, quality = [math.nan] * len(SIGNALS), [int(Quality.MISSING)] * len(SIGNALS)
    for name, value in values.items():
        row[SIGNAL_INDEX[name]], quality[SIGNAL_INDEX[name]] = value, int(Quality.FRESH)
    return Frame(10**9 + k * TICK_NS, k, tuple(row), (0.0,) * len(SIGNALS), tuple(quality))


def test_frames_are_the_table(tmp_path: Path) -> None:
    rows: list[Rows] = [Sample(10**9, "can.gyro", None, 0, (9.0, 9.0))]
    rows += [frame(k, q=0.1 * k, alpha_vane=math.nan if k == 2 else 0.05) for k in range(5)]
    write_log(tmp_path / "a.mcap", About(AIRCRAFT, (FAST,)), rows)
    found = table(tmp_path / "a.mcap")
    assert found.t_s.tolist() == [0.0, 0.02, 0.04, 0.06, 0.08]
    assert list(found.columns) == ["alpha_vane", "q"]
    assert found.columns["q"].tolist() == [0.1 * k for k in range(5)]
    assert np.isnan(found.columns["alpha_vane"]).tolist() == [False, False, True, False, False]
    assert found.quality["q"].tolist() == [0] * 5
    assert found.t0_ns == 10**9
    assert found.rate_hz == pytest.approx(50.0)
    assert found.record_ns is None
    assert found.aircraft == AIRCRAFT
    part = found.between(0.02, 0.06)
    assert part.t_s.tolist() == [0.02, 0.04, 0.06]
    assert part.columns["q"].tolist() == [0.1 * k for k in (1, 2, 3)]
    assert part.quality["q"].tolist() == [0] * 3


def test_the_noise_of_a_table_is_that_of_its_rows(tmp_path: Path) -> None:
    # A gyro at 200 Hz: four of its samples are averaged in a 50 Hz frame.
    rig = load_rig("bench")
    (gyro,) = [s for d in rig.devices for s in d.streams if "q" in s.signals]
    about = About(AIRCRAFT, (FAST,), rig)
    stated = gyro.signals["q"].noise_si()
    rows: dict[str, list[Rows]] = {
        "frames": [frame(k, q=0.1 * k) for k in range(5)],
        "samples": [Sample(10**9 + k * 5_000_000, "can.gyro", None, k, (0.0, 0.1 * k)) for k in range(5)],
    }
    found = {}
    for name, those in rows.items():
        write_log(tmp_path / f"{name}.mcap", about, those)
        noise = about.noise_si(table(tmp_path / f"{name}.mcap").aligned)
        assert noise is not None
        found[name] = noise["q"]
    assert gyro.rate == 200.0
    assert found == {"frames": pytest.approx(stated / 2), "samples": pytest.approx(stated)}
    assert About(AIRCRAFT, (FAST,)).noise_si(True) is None


def test_streams_on_different_times_are_interpolated_with_their_latency(tmp_path: Path) -> None:
    rows: list[Rows] = []
    for i in range(400):
        t = 10**9 + i * 5_000_000
        # True 10 ms before it arrives.
        rows.append(Sample(t, "can.gyro", None, i, (3.0 * (i * 0.005 - 0.010), math.nan)))
    for i in range(20):
        t_s = i * 0.1
        heading = math.remainder(3.0 + 0.5 * t_s, 2 * math.pi)
        rows.append(Sample(10**9 + i * 100_000_000, "autopilot.attitude", None, i, (heading,)))
    write_log(tmp_path / "a.mcap", About(AIRCRAFT, (FAST, SLOW)), rows)
    found = table(tmp_path / "a.mcap")
    assert found.t0_ns == 10**9 - 10_000_000
    assert np.diff(found.t_s) == pytest.approx(0.02)
    assert set(found.columns) == {"p", "psi"}
    true_s = found.t_s - 0.010
    good = ~np.isnan(found.columns["p"])
    assert good.sum() >= 99
    np.testing.assert_allclose(found.columns["p"][good], 3.0 * true_s[good], atol=1e-9)
    good = ~np.isnan(found.columns["psi"])
    wrapped = np.remainder(3.0 + 0.5 * true_s[good] + np.pi, 2 * np.pi) - np.pi
    np.testing.assert_allclose(found.columns["psi"][good], wrapped, atol=1e-9)


def test_the_age_of_a_value_is_as_recorded_else_since_a_held_one_was_new(tmp_path: Path) -> None:
    """A fix every 0.1 s, of an instant 0.05 s before: frames say so; where nothing does, marks and values tell."""
    rows: list[Rows] = []
    for k in range(10):
        made = frame(k, q=0.1 * k, v_down=float(k // 5) if k != 7 else math.nan)
        column = SIGNAL_INDEX["v_down"]
        ages, quality = list(made.age_s), list(made.quality)
        ages[column], quality[column] = 0.05 + 0.02 * (k % 5), int(Quality.HELD)
        rows.append(Frame(made.t_ns, k, made.values, tuple(ages), tuple(quality)))
    write_log(tmp_path / "a.mcap", About(AIRCRAFT, (FAST,)), rows)
    found = table(tmp_path / "a.mcap")
    late = np.array([0.05, 0.07, 0.09, 0.11, 0.13, 0.05, 0.07, math.nan, 0.11, 0.13])
    np.testing.assert_allclose(found.age_s("v_down"), late)
    np.testing.assert_allclose(found.age_s("q"), np.zeros(10))
    np.testing.assert_allclose(found.between(0.1, 0.12).age_s("v_down"), late[5:7])
    without = replace(found, ages={})
    np.testing.assert_allclose(without.age_s("v_down"), late - 0.05, atol=1e-12)


def test_truth_and_other_columns_come_on_the_tables_times(tmp_path: Path) -> None:
    rows: list[Rows] = [frame(k, q=0.0) for k in range(5)]
    rows += [Truth(10**9 + i * 5_000_000, {"alpha": 0.1 * i}) for i in range(17)]
    rows += [Extra(10**9 + k * TICK_NS, {"iyy": 5.0}) for k in range(5)]
    write_log(tmp_path / "a.mcap", About(AIRCRAFT, (FAST,)), rows)
    found = table(tmp_path / "a.mcap")
    np.testing.assert_allclose(found.truth["alpha"], [0.0, 0.4, 0.8, 1.2, 1.6])
    assert found.extra["iyy"].tolist() == [5.0] * 5


def test_a_recording_without_anything_measured_is_an_error(tmp_path: Path) -> None:
    write_log(tmp_path / "a.mcap", About(AIRCRAFT, (FAST,)), [Tick(1, 0, 0)])
    with pytest.raises(LogError, match="neither frames nor samples"):
        table(tmp_path / "a.mcap")


def test_points_are_numbered_and_timed_on_the_tables_axis(tmp_path: Path) -> None:
    def at(seconds: float) -> int:
        return 10**9 + round(seconds * 1e9)

    rows: list[Rows] = [frame(k, q=0.0) for k in range(500)]
    rows += [
        Event(at(1.0), "operator", Code.POINT_START, 1, "doublets"),
        Event(at(3.0), "operator", Code.POINT_END, 1),
        Event(at(4.0), "operator", Code.MARK, 1, "bump"),
        Event(at(5.0), "operator", Code.POINT_START, 2, "sweep"),
    ]
    write_log(tmp_path / "a.mcap", About(AIRCRAFT, (FAST,)), rows)
    first, second = points(tmp_path / "a.mcap")
    assert (first.n, first.note, second.n, second.note) == (1, "doublets", 2, "sweep")
    assert (first.start_s, first.end_s, second.start_s) == pytest.approx((1.0, 3.0, 5.0))
    assert second.end_s == pytest.approx(499 * 0.02)
