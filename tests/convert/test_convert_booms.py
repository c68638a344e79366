"""Records of real booms: OnSpeed's CSV and the University of Minnesota's flight_data."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from records import record
from scipy.io import loadmat, savemat

from station.convert import import_file
from station.convert.onspeed import read_onspeed
from station.log import table
from station.profile import load_aircraft
from station.rows import LogError

ONSPEED = "onspeed/vac_decel_run.csv"
THOR = "thor/thor_flight75.mat"
AIRCRAFT = load_aircraft("twin_otter")
KNOT = 1852 / 3600


def test_onspeed_samples_stand_at_the_time_they_were_true() -> None:
    own, vectornav, boom = read_onspeed(record(ONSPEED), AIRCRAFT).tracks
    assert (own.name, vectornav.name, boom.name) == ("onspeed", "vectornav", "boom")
    # First row: time 2860003 ms, boomAge 29, vnDataAge 16; the boom's next new sample is that of row 5, age 6.
    assert boom.t_ns[0] == (2860003 - 29) * 1_000_000
    assert vectornav.t_ns[0] == (2860003 - 16) * 1_000_000
    assert boom.t_ns[1] == (2860083 - 6) * 1_000_000
    assert np.all(np.diff(boom.t_ns) > 4_000_000)
    # A new sample of the boom every 53 ms on average, of the VectorNav every 21 ms.
    assert len(boom.t_ns) == pytest.approx(30 / 0.053, rel=0.02)
    assert len(vectornav.t_ns) > 1400
    assert boom.extra["alpha_vane_counts"][0] == 3659
    assert own.columns["airspeed"][0] == pytest.approx(81.65 * KNOT)
    assert own.columns["static_pressure"][0] == pytest.approx(81196.0)
    assert own.columns["air_temperature"][0] == pytest.approx(287.53)
    assert own.columns["altitude"][0] == pytest.approx(6044 * 0.3048)
    assert vectornav.columns["az"][0] == -10.14
    assert vectornav.columns["theta"][0] == pytest.approx(math.radians(6.89))
    # Straight flight: airspeed and ground speed alike, so units are right.
    assert np.hypot(vectornav.columns["v_north"][0], vectornav.columns["v_east"][0]) == pytest.approx(42.5, abs=0.1)


def test_onspeed_imports_to_a_recording(tmp_path: Path) -> None:
    import_file(record(ONSPEED), tmp_path / "a.mcap", AIRCRAFT)
    found = table(tmp_path / "a.mcap")
    assert found.rate_hz == pytest.approx(50.0)
    assert {"alpha_vane", "beta_vane", "airspeed", "q", "theta", "v_down"} <= set(found.columns)
    assert 0.1 < np.nanmin(found.columns["alpha_vane"]) < np.nanmax(found.columns["alpha_vane"]) < 0.6


def test_onspeed_errors_name_the_place(tmp_path: Path) -> None:
    lines = record(ONSPEED).read_text(encoding="utf-8").splitlines()[:6]
    cells = lines[3].split(",")
    cells[12] = "x"
    broken = tmp_path / "b.csv"
    for text, said in (
        ([*lines[:3], ",".join(cells), *lines[4:]], "line 4, column TAS: 'x' is not a number"),
        ([*lines[:3], lines[3] + ",1", *lines[4:]], "line 4: 59 columns"),
        ([lines[0], lines[2], lines[1]], "line 3, column timeStamp: time does not increase"),
        ([lines[0].replace("TAS", "ABC"), *lines[1:]], "no column TAS"),
        (lines[:1], "no rows"),
    ):
        broken.write_text("\n".join(text), encoding="utf-8")
        with pytest.raises(LogError, match=said):
            read_onspeed(broken, AIRCRAFT)


def test_umn_flight(tmp_path: Path) -> None:
    import_file(record(THOR), tmp_path / "t.mcap", AIRCRAFT)
    found = table(tmp_path / "t.mcap")
    raw = loadmat(record(THOR), squeeze_me=True, struct_as_record=False)["flight_data"]
    at = 15_000
    assert found.columns["alpha_vane"][at] == raw.aoa[at]
    assert found.columns["dynamic_pressure"][at] == pytest.approx(0.5 * 1.225 * raw.ias[at] ** 2)
    assert 1.0 < found.columns["airspeed"][at] / raw.ias[at] < 1.03
    assert found.columns["latitude"][at] == pytest.approx(math.radians(45.33), abs=1e-3)
    assert "navigation_q_bias" in found.extra
    # Signs: elevator down pitches down, aileron down on the right rolls left, with the servo's 40 ms.
    flying = slice(11_000, 28_000)
    for rate, surface in (("q", "elevator"), ("p", "aileron")):
        turn = np.diff(found.columns[rate][flying])[2:]
        moved = found.columns[surface][flying][: len(turn)]
        assert np.corrcoef(turn, moved)[0, 1] < -0.1


def test_umn_errors_name_the_field(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"flight_data": {"time": np.arange(5.0), "aoa": np.arange(4.0)}})
    with pytest.raises(LogError, match=r"flight_data\.aoa has shape \(4,\), time has 5 rows"):
        import_file(tmp_path / "a.mat", tmp_path / "a.mcap", AIRCRAFT)
    savemat(tmp_path / "b.mat", {"flight_data": {"time": np.array([0.0, 1.0, 1.0])}})
    with pytest.raises(LogError, match="time does not increase"):
        import_file(tmp_path / "b.mat", tmp_path / "b.mcap", AIRCRAFT)
    savemat(tmp_path / "c.mat", {"flight_data": {"time": np.arange(3.0)}})
    with pytest.raises(LogError, match="no field aoa"):
        import_file(tmp_path / "c.mat", tmp_path / "c.mcap", AIRCRAFT)
    (tmp_path / "d.mat").write_bytes(b"not a mat file at all")
    with pytest.raises(LogError, match="not a MATLAB file"):
        import_file(tmp_path / "d.mat", tmp_path / "d.mcap", AIRCRAFT)
