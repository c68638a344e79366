"""Declared and derived signals through frames, recording, table, exports and replay, and their alarms."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from asammdf import MDF
from mcap.reader import make_reader
from pyulog import ULog

from station.api.flown_recording import Recording
from station.conventions import G0, SIGNALS, TICK_NS
from station.convert import export
from station.flight.alignment import Aligner
from station.flight.limits import LimitWatch, limited_signals
from station.flight.loop import Beat, Chain, recorded_beats, run
from station.flight.replay_check import Comparison
from station.log import About, describe, read_rows, summarise, table, write_log
from station.profile import Limits, Rig, load_aircraft
from station.rows import AlphaEstimate, Code, Event, Frame, Quality, Rows, Sample, Tick

AIRCRAFT = load_aircraft("twin_otter")
RIG = Rig.model_validate(
    {
        "name": "r",
        "signals": {
            "torque": {"unit": "lbf ft", "limit_high": "1000 lbf ft", "high": "3000 N m", "positive": "driving"},
            "airspeed": {"unit": "kt", "limit_low": "60 kt"},
        },
        "derived": {
            "per_speed": {"unit": "1", "expression": "torque/airspeed"},
            "twice": {"unit": "g", "expression": "2*per_speed"},
        },
        "devices": [
            {
                "name": "box",
                "link": "serial",
                "protocol": "boombox",
                "port": "emulated",
                "streams": [
                    {
                        "name": "a",
                        "message": 1,
                        "rate": "50 Hz",
                        "signals": {
                            "torque": {"field": "v0", "unit": "N m"},
                            "airspeed": {"field": "v1", "unit": "m/s"},
                        },
                    }
                ],
            }
        ],
    }
)
STREAMS = tuple(RIG.streams())
ABOUT = About(AIRCRAFT, STREAMS, RIG)
COLUMN = RIG.further.index
TICKS = 200


def torque(k: int) -> float:
    return 500.0 + k


def speed(k: int) -> float:
    """Down to nothing from tick 50 to 70, no faster than an airspeed changes."""
    return float(min(max(2 * abs(k - 60) - 20, 0), 40))


class Nothing:
    """An estimator without an opinion."""

    def step(self, frame: Frame) -> tuple[AlphaEstimate, tuple[()]]:
        return AlphaEstimate(frame.t_ns, *[0.0] * 12, "calm", *[0.0] * 3, True, ""), ()

    def start_point(self) -> None:
        pass


class Log:
    def __init__(self) -> None:
        self.rows: list[Rows] = []

    def append(self, rows: object) -> None:
        self.rows += rows  # type: ignore[operator]

    def flush(self) -> None:
        pass


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    log = Log()
    beats = [
        Beat(Tick(k * TICK_NS, k, (k - 3) * TICK_NS), [Sample(k * TICK_NS, "box.a", None, k, (torque(k), speed(k)))])
        for k in range(TICKS)
    ]
    run(beats, Aligner(STREAMS, {}, further=RIG.further), lambda: Chain(Nothing()), log)
    path = tmp_path_factory.mktemp("declared") / "flight.mcap"
    write_log(path, ABOUT, log.rows)
    return path


def test_frames_hold_declared_and_derived_values_and_division_by_zero_is_told_once(flown: Path) -> None:
    frames = [f for f in read_rows(flown, (Frame,)) if isinstance(f, Frame)]
    assert {len(f.values) for f in frames} == {len(SIGNALS) + 3}
    for f in frames[3:]:
        k = f.t_ns // TICK_NS
        assert f.values[COLUMN["torque"]] == pytest.approx(torque(k))
        if speed(k):
            assert f.values[COLUMN["per_speed"]] == pytest.approx(torque(k) / speed(k))
            assert f.values[COLUMN["twice"]] == pytest.approx(2 * torque(k) / speed(k) * G0)
            assert f.quality[COLUMN["twice"]] == Quality.FRESH
        else:
            assert math.isnan(f.values[COLUMN["per_speed"]])
            assert math.isnan(f.values[COLUMN["twice"]])
            assert f.quality[COLUMN["per_speed"]] == Quality.SUSPECT
    told = [e for e in read_rows(flown, (Event,)) if isinstance(e, Event) and e.code is Code.RANGE]
    assert [(e.source, e.count) for e in told] == [("per_speed", 1)]
    assert told[0].detail.startswith("divides by zero")


def test_a_replay_gives_the_same_bits(flown: Path) -> None:
    found = Comparison()
    about = Recording(flown).info.about
    aligner = Aligner(about.streams, {}, about.clock_law, about.further)
    run(recorded_beats(read_rows(flown)), aligner, lambda: Chain(Nothing()), None, None, found.take)
    assert (found.rows, found.different) == (2 * TICKS, 0), found.first


def test_an_impossible_value_is_left_out_and_told() -> None:
    aligner = Aligner(STREAMS, {}, further=RIG.further)
    aligner.accept(Sample(0, "box.a", None, 0, (3001.0, 40.0)))
    frame, events, _ = aligner.frame(0, TICK_NS, 0)
    assert math.isnan(frame.values[COLUMN["torque"]])
    assert [e.detail for e in events if e.code is Code.RANGE] == ["torque = 3001 cannot be true"]


def test_limits_of_the_rig_alarm_in_its_own_units() -> None:
    def told(**values: float) -> list[str]:
        watch = LimitWatch(Limits(bank=None, nose_up=None, nose_down=None), limited_signals(RIG))
        row = [math.nan] * len(COLUMN)
        for name, value in values.items():
            row[COLUMN[name]] = value
        found = []
        for k in range(20):
            found += watch.step(Frame(k * TICK_NS, k, tuple(row), (), ()), None)
        return [f"{e.source} {e.code} {e.detail}" for e in found]

    assert told(torque=1355.0, airspeed=31.0) == []
    assert told(torque=1400.0) == ["torque LIMIT +1.03e+03 lbf ft: the limit is +1e+03 lbf ft"]
    assert told(airspeed=30.0) == ["airspeed LIMIT +58.3 kt: the limit is +60 kt"]


def test_table_info_and_library_know_them(flown: Path) -> None:
    made = table(flown)
    np.testing.assert_allclose(made.columns["torque"][3:], [torque(k) for k in range(TICKS - 3)])
    words = describe(summarise(flown))
    assert "declared: torque [N m]" in words
    assert "derived: per_speed = torque/airspeed [1]" in words
    signals = Recording(flown).signals
    assert signals["torque"].attrs == {"units": "N m", "positive": "driving"}
    assert signals["twice"].attrs["units"] == "m/s2"


@pytest.mark.parametrize("form", ["csv", "parquet", "mdf4", "ulog", "mcap"])
def test_every_export_has_them_with_units(flown: Path, tmp_path: Path, form: str) -> None:
    out = tmp_path / f"out.{form}"
    export(flown, form, out)
    if form == "csv":
        lines = list(csv.reader(out.read_text().splitlines()))
        assert {"torque [N m]", "twice [m/s2]"} <= set(lines[0])
        found = [float(r[lines[0].index("torque [N m]")] or "nan") for r in lines[1:]]
    elif form == "parquet":
        read = pq.read_table(out)
        assert read.schema.field("twice").metadata == {b"unit": b"m/s2"}
        found = read["torque"].to_pylist()
    elif form == "mdf4":
        with MDF(out) as mdf:
            signal = mdf.get("torque", group=0)
            assert signal.unit == "N m"
            found = signal.samples
    elif form == "ulog":
        found = {d.name: d.data for d in ULog(str(out)).data_list}["station_signals"]["torque"]
    else:
        with out.open("rb") as file:
            frames = [(s, m) for s, c, m in make_reader(file).iter_messages(["/frame"])]
        known = json.loads(frames[0][0].data)["properties"]
        assert known["torque"]["unit"] == "N m"
        found = [json.loads(m.data).get("torque", np.nan) for _, m in frames]
    values = np.array(found, dtype=float)
    np.testing.assert_allclose(values[-150:], [torque(k) for k in range(TICKS - 153, TICKS - 3)], rtol=1e-6)


def test_a_recording_of_samples_alone_has_what_is_derived(tmp_path: Path) -> None:
    """As `simulate` writes them: worked out of the columns afterwards."""
    rows: list[Rows] = [Sample(k * TICK_NS, "box.a", None, k, (torque(k), speed(k))) for k in range(100)]
    write_log(tmp_path / "a.mcap", ABOUT, rows)
    made = table(tmp_path / "a.mcap").columns["per_speed"]
    expected = [torque(k) / speed(k) if speed(k) else np.nan for k in range(100)]
    np.testing.assert_allclose(made, expected)
