"""Exports read back by the libraries that others use, with the same values and their units."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from asammdf import MDF
from scipy.io import loadmat

from station.conventions import SIGNAL_INDEX, SIGNALS, TICK_NS, Stream
from station.convert import export, import_file
from station.convert.mat_file import MatrixFile
from station.log import About, read_rows, table, write_log
from station.profile import load_aircraft
from station.rows import (
    AlphaEstimate,
    Frame,
    LogError,
    MethodEstimate,
    ParamEstimate,
    Quality,
    Rows,
    Sample,
    Status,
    Tick,
    Truth,
)

AIRCRAFT = load_aircraft("twin_otter")
STREAM = Stream("can.gyro", ("p", "q"), 100.0, 0.1, "can")
FLOWN = ("alpha_vane", "airspeed", "q", "theta", "az", "elevator", "thrust")


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    rng = np.random.default_rng(3)
    rows: list[Rows] = []
    for k in range(60):
        t = 10**9 + k * TICK_NS
        rows += [
            Sample(t + i * 10**7, "can.gyro", t + i * 10**7 + 5, 2 * k + i, tuple(rng.normal(size=2).tolist()))
            for i in (0, 1)
        ]
        values, quality = [math.nan] * len(SIGNALS), [int(Quality.MISSING)] * len(SIGNALS)
        for name in FLOWN:
            values[SIGNAL_INDEX[name]], quality[SIGNAL_INDEX[name]] = float(rng.normal()), 0
        rows.append(Tick(t, k, t))
        rows.append(Frame(t, k, tuple(values), (0.0,) * len(SIGNALS), tuple(quality)))
        numbers = rng.normal(size=15).tolist()
        rows.append(AlphaEstimate(t, *numbers[:12], "light", *numbers[12:], k > 3, ""))
        parameters = (ParamEstimate("CL_alpha", 5.0 + k, 0.1, Status.ESTIMATED),)
        rows.append(MethodEstimate(t, "split+gust", parameters if k > 10 else ()))
        rows.append(Truth(t, {"alpha": 0.01 * k}))
    path = tmp_path / "flight.mcap"
    write_log(path, About(AIRCRAFT, (STREAM,)), rows, station_ns=0, utc_ns=1_790_000_000 * 10**9)
    return path


def test_csv_of_a_flight_can_be_imported_again(flight: Path, tmp_path: Path) -> None:
    made = export(flight, "csv", tmp_path / "out.csv")
    assert [p.name for p in made] == [
        "out.csv",
        "out.can.gyro.csv",
        "out.alpha.csv",
        "out.method_split+gust.csv",
        "out.truth.csv",
    ]
    import_file(tmp_path / "out.csv", tmp_path / "again.mcap", AIRCRAFT)
    first, second = table(flight), table(tmp_path / "again.mcap")
    assert np.array_equal(first.t_s, second.t_s)
    assert all(np.array_equal(first.columns[n], second.columns[n]) for n in FLOWN)
    stream = (tmp_path / "out.can.gyro.csv").read_text().splitlines()
    assert stream[0] == "time [s],p [rad/s],q [rad/s],time_device [s],quality [1]"
    assert len(stream) == 121
    derivatives = (tmp_path / "out.method_split+gust.csv").read_text().splitlines()
    assert derivatives[0] == "time [s],CL_alpha [1/rad],CL_alpha_sd [1/rad]"
    assert derivatives[1] == "0.0,,"
    assert derivatives[-1] == "1.18,64.0,0.1"


def test_parquet_holds_the_same_bits_and_the_units(flight: Path, tmp_path: Path) -> None:
    made = export(flight, "parquet", tmp_path / "out.parquet")
    assert len(made) == 5
    found = pq.read_table(made[0])
    flown = table(flight)
    assert found.column_names == ["time", *flown.columns]
    assert np.array_equal(found["time"].to_numpy(), flown.t_s)
    for name in flown.columns:
        assert np.array_equal(found[name].to_numpy(), flown.columns[name], equal_nan=True)
        assert found.schema.field(name).metadata[b"unit"].decode() == SIGNALS[name].unit
    assert json.loads(found.schema.metadata[b"aircraft"])["name"] == "twin_otter"


@pytest.mark.parametrize("name", ["out.mf4", "out.mdf"])
def test_mdf4_holds_every_time_base_with_the_same_bits(flight: Path, tmp_path: Path, name: str) -> None:
    assert export(flight, "mdf4", tmp_path / name) == (tmp_path / name,)
    flown = table(flight)
    with MDF(tmp_path / name) as mdf:
        # The first frame's, a second after the clock was read, not the export's.
        assert mdf.start_time.timestamp() == 1_790_000_001
        names = [group.channel_group.comment for group in mdf.groups]
        assert names == ["table", "can.gyro", "alpha", "method split+gust", "truth"]
        for signal in FLOWN:
            found = mdf.get(signal, group=0)
            assert np.array_equal(found.samples, flown.columns[signal])
            assert np.array_equal(found.timestamps, flown.t_s)
            assert found.unit == SIGNALS[signal].unit
        assert len(mdf.get("q", group=1).samples) == 120
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(["flight.mcap", name])


def test_mat_of_a_flight_is_fdata(flight: Path, tmp_path: Path) -> None:
    export(flight, "mat", tmp_path / "out.mat")
    fdata = loadmat(tmp_path / "out.mat")["fdata"]
    flown = table(flight)
    assert fdata.shape == (60, 90)
    np.testing.assert_allclose(fdata[:, 5], np.degrees(flown.columns["q"]))
    np.testing.assert_allclose(fdata[:, 80], np.degrees(flown.columns["alpha_vane"]))
    np.testing.assert_allclose(fdata[:, 12], flown.columns["az"] / (32.174 * 0.3048))
    np.testing.assert_allclose(fdata[:, 37], flown.columns["thrust"] / 4.4482216152605)
    np.testing.assert_allclose(fdata[0, 76:79], (420.0, 65.0, 6.5))
    np.testing.assert_allclose(fdata[0, 47:52], (340.0, 17302.0, 24640.0, 38626.0, 1190.0))
    qhat = flown.columns["q"] * 6.5 * 0.3048 / (2 * flown.columns["airspeed"])
    np.testing.assert_allclose(fdata[:, 71], qhat)
    # Channel 4 is the angle of attack at the CG that the station estimated, not the vane's.
    assert not np.allclose(fdata[:, 3], fdata[:, 80])


def test_frames_before_the_links_come_up_are_not_in_fdata(flight: Path, tmp_path: Path) -> None:
    """They hold nothing, and SIDPAC's least squares would be NaN by them; times stay those of the recording."""

    def before(k: int) -> Frame:
        count = len(SIGNALS)
        return Frame(k * TICK_NS, k, (math.nan,) * count, (0.0,) * count, (int(Quality.MISSING),) * count)

    write_log(tmp_path / "late.mcap", About(AIRCRAFT, (STREAM,)), [*map(before, range(7)), *read_rows(flight)])
    export(tmp_path / "late.mcap", "mat", tmp_path / "late.mat")
    export(flight, "mat", tmp_path / "out.mat")
    late, whole = (loadmat(tmp_path / f"{name}.mat")["fdata"] for name in ("late", "out"))
    np.testing.assert_array_equal(late[:, 1:], whole[:, 1:])
    np.testing.assert_allclose(late[:, 0], 1.0 + whole[:, 0])
    write_log(tmp_path / "never.mcap", About(AIRCRAFT, (STREAM,)), map(before, range(7)))
    with pytest.raises(LogError, match="the links never came up"):
        export(tmp_path / "never.mcap", "mat", tmp_path / "never.mat")


def test_mat_written_in_blocks_is_the_same(flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    export(flight, "mat", tmp_path / "whole.mat")
    monkeypatch.setattr("station.convert.exporter.ROWS", 7)
    export(flight, "mat", tmp_path / "blocks.mat")
    whole, blocks = (loadmat(tmp_path / f"{name}.mat") for name in ("whole", "blocks"))
    np.testing.assert_array_equal(blocks["fdata"], whole["fdata"])
    for name in ("npts", "sarea", "cbar", "dt"):
        assert blocks[name].item() == whole[name].item()


def test_a_column_whose_first_value_comes_late_is_missing_before(tmp_path: Path) -> None:
    """Two blocks of three rows: of column 2 nothing until row 5; of column 3 nothing at all; column 4 is filled."""
    block, nan = np.arange(12.0).reshape(3, 4), np.nan
    block[:, 1:] = nan
    late = block.copy()
    late[1, 1] = 5.0
    with MatrixFile(tmp_path / "a.mat", {"n": 6}, "m", 6, 4) as file:
        file.add(block)
        file.add(late)
        file.fill(0, 9.0)
        file.fill(3, 7.0)
    found = loadmat(tmp_path / "a.mat")
    expected = [[0, nan, 0, 7], [4, nan, 0, 7], [8, nan, 0, 7], [0, nan, 0, 7], [4, 5, 0, 7], [8, nan, 0, 7]]
    np.testing.assert_array_equal(found["m"], expected)
    assert found["n"].item() == 6


@pytest.mark.parametrize("form", ["csv", "parquet", "mat", "mdf4"])
def test_nothing_is_overwritten(flight: Path, tmp_path: Path, form: str) -> None:
    out = tmp_path / "taken.mf4"
    out.write_text("precious")
    with pytest.raises(LogError, match="exists already"):
        export(flight, form, out)  # type: ignore[arg-type]
    assert out.read_text() == "precious"


def test_an_export_that_cannot_be_written_is_a_short_error(flight: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(LogError, match="cannot be written"):
        export(flight, "csv", tmp_path / "file" / "out.csv")
