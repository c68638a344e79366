"""The library gives what the recording's rows hold, reads no more than is looked at, and says what is not there."""

from __future__ import annotations

import random
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import station
from station.api.signal_arrays import BLOCK
from station.conventions import SIGNAL_INDEX, SIGNALS, TICK_NS, Stream
from station.log import About, read_rows, write_log
from station.log.reading import PartReader
from station.profile import load_aircraft
from station.rows import Code, Event, Frame, LogError, MethodEstimate, ParamEstimate, Rows, Sample, Status, UsageError

STREAM = Stream("box.vanes", ("alpha_vane", "beta_vane"), 50.0, 0.2)
TICKS = 3 * BLOCK + 7
ZERO = 10**9


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    noise, rows = random.Random(5), list[Rows]()
    for k in range(TICKS):
        t = ZERO + k * TICK_NS
        values = [float("nan")] * len(SIGNALS)
        values[SIGNAL_INDEX["alpha_vane"]] = noise.random()
        rows.append(Frame(t, k, tuple(values), (0.0,) * len(SIGNALS), (0,) * len(SIGNALS)))
        if k % 100 == 0:
            rows.append(Sample(t, "box.vanes", None, k, (noise.random(), noise.random())))
            rows.append(MethodEstimate(t, "II", (ParamEstimate("CL_alpha", 5.0 + k, 0.1, Status.ESTIMATED),)))
    rows.append(Event(ZERO + 50 * TICK_NS, "operator", Code.POINT_START, 1, "doublet; calm"))
    rows.append(Event(ZERO + 150 * TICK_NS, "operator", Code.POINT_END, 1, ""))
    path = tmp_path_factory.mktemp("library") / "flight.mcap"
    write_log(path, About(load_aircraft("twin_otter"), (STREAM,)), rows)
    return path


def test_signals_are_those_of_the_frames_with_their_units(log: Path) -> None:
    frames = [r for r in read_rows(log, (Frame,)) if isinstance(r, Frame)]
    vane = station.open(log).signals["alpha_vane"]
    assert vane.attrs == {"units": "rad", "positive": SIGNALS["alpha_vane"].positive}
    expected = np.array([f.values[SIGNAL_INDEX["alpha_vane"]] for f in frames])
    assert np.array_equal(vane.values, expected)
    assert np.array_equal(vane["time"].values, np.arange(TICKS) * TICK_NS / 1e9)
    assert np.array_equal(vane[::-500].values, expected[::-500])
    assert float(vane[-3]) == expected[-3]


def test_only_the_minute_that_is_looked_at_is_read(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    signals = station.open(log).signals
    spans = []
    read = PartReader.select

    def watched(self: PartReader, kinds: set[str], first_ns: int, last_ns: int):  # type: ignore[no-untyped-def]
        spans.append((first_ns, last_ns))
        return read(self, kinds, first_ns, last_ns)

    monkeypatch.setattr(PartReader, "select", watched)
    part = signals["alpha_vane"].sel(time=slice(70.0, 80.0))
    assert spans == []
    assert len(part.values) == 501
    assert float(part.mean()) > 0
    assert spans == [(ZERO + BLOCK * TICK_NS, ZERO + (2 * BLOCK - 1) * TICK_NS)]


def test_points_events_streams_and_estimates_are_tables(log: Path) -> None:
    flight = station.open(log)
    assert flight.points.loc[1].to_dict() == {"start_s": 1.0, "end_s": 3.0, "note": "doublet; calm"}
    assert flight.events["code"].tolist() == ["POINT_START", "POINT_END"]
    assert flight.events["time_s"].tolist() == [1.0, 3.0]
    assert flight.stream("box.vanes", 2.0, 6.0)["time"].values.tolist() == [2.0, 4.0, 6.0]
    assert flight.stream("box.vanes")["beta_vane"].attrs["units"] == "rad"
    derivatives = flight.derivatives("II")
    assert derivatives["CL_alpha"].values[:3].tolist() == [5.0, 105.0, 205.0]
    assert derivatives["CL_alpha_sd"].attrs["units"] == "1/rad"
    assert len(flight.alpha["alpha"]) == 0
    assert "box.vanes" in flight._repr_html_()


def test_what_is_not_there_is_named(log: Path, tmp_path: Path) -> None:
    flight = station.open(log)
    with pytest.raises(LogError, match=r"no stream vanes\nstreams in it: box.vanes"):
        flight.stream("vanes")
    with pytest.raises(LogError, match=r"no estimates by split\nmethods in it: II"):
        flight.derivatives("split")
    with pytest.raises(UsageError, match=r"no test point 7\nmarked in it: 1"):
        station.identify(flight, point=7)
    for call in (station.open, station.identify, station.diagnose):
        with pytest.raises(LogError, match=r"none\.mcap: no such"):
            call(tmp_path / "none.mcap")
    with pytest.raises(UsageError, match="--scheduler"):
        station.campaign("a_short_one", tmp_path / "c", engine="dask")
    with pytest.raises(UsageError, match="a flight takes a second or more"):
        station.simulate("bench", tmp_path / "a.mcap", duration=float("nan"))


def test_a_cut_recording_is_said_to_be_cut_and_gives_what_it_has(log: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    with pytest.warns(UserWarning, match="cut.mcap is truncated: what can be read of it is here"):
        flight = station.open(cut)
    whole = station.open(log).signals["alpha_vane"].values
    there = flight.signals["alpha_vane"].values
    assert 1000 < len(there) < TICKS
    assert np.array_equal(there, whole[: len(there)])
    assert "truncated: not all of it is here" in flight._repr_html_()


def test_naming_the_package_imports_nothing_large() -> None:
    words = (
        "import station, sys; print(sorted({'numpy', 'pandas', 'xarray', 'pydantic', 'msgspec'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_campaign_is_a_function_whatever_is_imported() -> None:
    words = "import station, station.campaign.spec; print(callable(station.campaign), station.campaign.__module__)"
    done = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "True station.api.monte_carlo"


def test_every_name_of_the_library_is_there_and_says_what_it_does() -> None:
    ours = [n for n in station.__all__ if getattr(station, n).__module__.startswith("station.api")]
    assert len(ours) == 10
    assert [name for name in ours if not getattr(station, name).__doc__] == []
    with pytest.raises(AttributeError, match="no attribute 'identfy'"):
        station.identfy  # noqa: B018
