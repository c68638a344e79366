"""SIDPAC's fdata in and out, against NASA's records where they are at hand and a made-up matrix everywhere."""

from __future__ import annotations

import math
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from records import record
from scipy.io import loadmat, savemat

from station.api.flown_recording import simulate
from station.convert import export, import_file
from station.log import metadata, summarise, table
from station.profile import load_aircraft
from station.rows import LogError

RECORDS = ("totter_demo_data", "totter_pred_data", "totter_f1_017_data")


def ulps(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """The largest difference in units in the last place."""
    return float(np.max(np.abs(a - b) / np.spacing(np.maximum(np.abs(a), np.abs(b)) + 1e-300)))


def made_up(n: int = 50) -> NDArray[np.float64]:
    fdata = np.random.default_rng(1).normal(size=(n, 90))
    fdata[:, 0] = 100.0 + np.arange(n) / 50
    fdata[:, 1] = 200.0
    fdata[:, 47], fdata[:, 48:52] = 340.0, (17302.0, 24640.0, 38626.0, 1190.0)
    fdata[:, 76:79] = (422.5, 65.0, 6.5)
    fdata[:, 37:41] = np.abs(fdata[:, 37:41])
    fdata[:, 18] = 0.0
    return fdata


def test_units_and_signs_by_hand(tmp_path: Path) -> None:
    fdata = np.zeros((2, 79))
    fdata[:, 0] = (10.0, 10.02)
    fdata[:, 1] = 100.0  # ft/s
    fdata[:, 3] = 2.0  # deg
    fdata[:, 5] = 180.0  # deg/s
    fdata[:, 12] = -1.0  # g of 32.174 ft/s2
    fdata[:, 13] = 5.0  # deg
    fdata[:, 26] = 50.0  # lbf/ft2
    fdata[:, 29] = 1000.0  # ft
    fdata[:, 37:41] = (100.0, 200.0, 0.0, 0.0)  # lbf
    fdata[:, 42] = 57.29577951308232  # deg/s2
    fdata[:, 47] = 10.0  # slug
    fdata[:, 49] = 1000.0  # slug ft2
    fdata[:, 76] = 420.0  # ft2
    savemat(tmp_path / "a.mat", {"fdata": fdata})
    import_file(tmp_path / "a.mat", tmp_path / "a.mcap", load_aircraft("twin_otter"))
    found = table(tmp_path / "a.mcap")
    first = {name: float(column[0]) for name, column in found.columns.items()}
    assert first == pytest.approx(
        {
            "airspeed": 30.48,
            "alpha_vane": 0.03490658503988659,
            "q": math.pi,
            "az": -9.8066352,
            "elevator": 0.08726646259971647,
            "dynamic_pressure": 2394.0129491,
            "altitude": 304.8,
            "thrust": 300 * 4.4482216152605,
            "qdot": 1.0,
            "mass": 145.939029,
        },
        rel=1e-8,
    )
    assert found.aircraft.geometry.wing_area == pytest.approx(39.01927680)
    assert found.aircraft.geometry.span == load_aircraft("twin_otter").geometry.span
    assert found.aircraft.inertia.iyy == pytest.approx(1355.8179483)
    assert found.aircraft.inertia.mass == pytest.approx(145.939029)
    assert found.t_s.tolist() == [0.0, 0.02]
    assert found.record_ns is not None
    assert found.record_ns.tolist() == [10_000_000_000, 10_020_000_000]


def test_every_channel_of_a_made_up_matrix_comes_back(tmp_path: Path) -> None:
    original = made_up()
    savemat(tmp_path / "a.mat", {"fdata": original})
    import_file(tmp_path / "a.mat", tmp_path / "a.mcap", load_aircraft("twin_otter"))
    export(tmp_path / "a.mcap", "mat", tmp_path / "b.mat")
    content = loadmat(tmp_path / "b.mat")
    assert ulps(content["fdata"], original) <= 1.0
    assert np.array_equal(content["fdata"][:, 0], original[:, 0])
    assert np.array_equal(content["fdata"][:, 60:73], original[:, 60:73])
    assert content["sarea"][0, 0] == pytest.approx(422.5)
    assert content["dt"][0, 0] == pytest.approx(0.02)
    # A second time round the columns move by no more than a rounding; thrust is a sum of four.
    import_file(tmp_path / "b.mat", tmp_path / "b.mcap", load_aircraft("twin_otter"))
    once, twice = table(tmp_path / "a.mcap"), table(tmp_path / "b.mcap")
    assert all(ulps(once.columns[n], twice.columns[n]) <= 1.0 for n in once.columns if n != "thrust")
    np.testing.assert_allclose(once.columns["thrust"], twice.columns["thrust"], rtol=1e-15)


@pytest.mark.parametrize("name", RECORDS)
def test_nasa_records_come_back(tmp_path: Path, name: str) -> None:
    path = record(f"twin_otter/{name}.mat")
    import_file(path, tmp_path / "a.mcap", load_aircraft("twin_otter"))
    export(tmp_path / "a.mcap", "mat", tmp_path / "b.mat")
    original = loadmat(path, variable_names=["fdata"])["fdata"]
    assert ulps(loadmat(tmp_path / "b.mat")["fdata"], original) <= 1.0


def test_nasa_demonstration_record_is_all_there(tmp_path: Path) -> None:
    path = record("twin_otter/totter_demo_data.mat")
    import_file(path, tmp_path / "a.mcap", load_aircraft("twin_otter"))
    found = table(tmp_path / "a.mcap")
    original = loadmat(path, variable_names=["fdata"])["fdata"]
    assert summarise(tmp_path / "a.mcap").verdict == "complete"
    assert len(found.t_s) == 401
    assert found.rate_hz == pytest.approx(50.0)
    assert found.t_s[-1] == 8.0
    # The moment coefficient from what was imported is the one that SIDPAC wrote into channel 65.
    a, c, x = found.aircraft.geometry, found.columns, found.extra
    force = c["dynamic_pressure"] * a.wing_area
    moment = x["iyy"] * c["qdot"] + (x["ixx"] - x["izz"]) * c["p"] * c["r"] + x["ixz"] * (c["p"] ** 2 - c["r"] ** 2)
    np.testing.assert_allclose(moment / (force * a.chord), original[:, 64], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(c["thrust"] / force, original[:, 69], rtol=1e-12)
    assert np.array_equal(x["CZ"], original[:, 62])
    assert found.aircraft.boom is None


def test_the_recording_says_where_it_is_from(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"fdata": made_up()})
    import_file(tmp_path / "a.mat", tmp_path / "a.mcap", load_aircraft("twin_otter"))
    about = metadata(tmp_path / "a.mcap").about
    assert (about.imported, about.source, about.notes["file"]) == (True, "fdata", "a.mat")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"flight_data": np.zeros((5, 90)), "t": np.zeros(5)}, "holds no variable fdata .* but flight_data, t"),
        ({"fdata": np.zeros((5, 9))}, r"fdata is \(5, 9\)"),
        ({"fdata": np.array(["text"])}, "not a matrix"),
        ({"fdata": np.zeros((5, 90))}, "row 2, channel 1: time does not increase"),
        ({"fdata": np.full((5, 90), np.nan)}, "row 1, channel 1: no time"),
    ],
)
def test_a_mat_file_without_a_sound_fdata_is_refused(tmp_path: Path, content: dict[str, object], says: str) -> None:
    savemat(tmp_path / "a.mat", content)
    with pytest.raises(LogError, match=says) as refused:
        import_file(tmp_path / "a.mat", tmp_path / "a.mcap", load_aircraft("twin_otter"))
    assert len(str(refused.value).splitlines()) <= 3
    assert not (tmp_path / "a.mcap").exists()


@pytest.mark.parametrize("content", [b"", b"not a MATLAB file at all", b"MATLAB 7.3 MAT-file" + bytes(600)])
def test_what_is_no_mat_file_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.mat").write_bytes(content)
    with pytest.raises(LogError, match="not a MATLAB file"):
        import_file(tmp_path / "a.mat", tmp_path / "a.mcap", load_aircraft("twin_otter"))


def test_a_cut_mat_file_is_refused(tmp_path: Path) -> None:
    savemat(tmp_path / "whole.mat", {"fdata": made_up()})
    data = (tmp_path / "whole.mat").read_bytes()
    for length in range(1, len(data) - 1, len(data) // 40):
        (tmp_path / "a.mat").write_bytes(data[:length])
        with pytest.raises(LogError):
            import_file(tmp_path / "a.mat", tmp_path / "a.mcap", load_aircraft("twin_otter"))


def test_octave_reads_fdata_and_finds_the_same_lift(tmp_path: Path) -> None:
    """Another program, by SIDPAC's channel list and in its units, against this one's signals in SI."""
    octave = shutil.which("octave-cli") or shutil.which("octave")
    if octave is None:
        pytest.skip("no Octave here: apt-get install octave")
    flight = simulate("bench", tmp_path / "a.mcap", {"flight.gust_sigma": "3 ft/s"}, seed=1, duration=20)
    export(flight.path, "mat", tmp_path / "out.mat")
    script = Path(__file__).with_name("fdata_in_octave.m")
    shutil.copy(script, tmp_path)
    words = [octave, "--no-gui", "--quiet", "--eval", "fdata_in_octave('out.mat')"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True, timeout=120)
    size, *theta = done.stdout.strip().splitlines()
    flown = table(flight.path)
    c, aircraft = flown.columns, flown.aircraft
    weight = aircraft.inertia.mass / (c["dynamic_pressure"] * aircraft.geometry.wing_area)
    lift = weight * (-c["az"] * np.cos(c["alpha_vane"]) + c["ax"] * np.sin(c["alpha_vane"]))
    rate = c["q"] * aircraft.geometry.chord / (2 * c["airspeed"])
    x = np.column_stack([c["alpha_vane"], rate, c["elevator"], np.ones(len(lift))])
    assert size == f"{len(lift)} 90"
    assert np.allclose([float(line) for line in theta], np.linalg.lstsq(x, lift)[0], rtol=1e-9)
