"""PX4 logs: bytes packed by hand after the ULog specification, read by pyulog, imported."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import pytest

from station.convert import import_file
from station.log import metadata, read_rows, table
from station.profile import load_aircraft
from station.rows import LogError, Sample

AIRCRAFT = load_aircraft("twin_otter")


def message(kind: bytes, content: bytes) -> bytes:
    return struct.pack("<H", len(content)) + kind + content


def ulog(*definitions: tuple[str, str, list[bytes]]) -> bytes:
    """A log of topics: (name, fields after the timestamp, packed rows with their timestamp)."""
    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000)
    out += message(b"B", bytes(40))
    for name, fields, _ in definitions:
        out += message(b"F", f"{name}:uint64_t timestamp;{fields}".encode())
    for i, (name, _, _) in enumerate(definitions):
        out += message(b"A", struct.pack("<BH", 0, i) + name.encode())
    for i, (_, _, rows) in enumerate(definitions):
        for row in rows:
            out += message(b"D", struct.pack("<H", i) + row)
    return out


def imported(tmp_path: Path, content: bytes) -> Path:
    (tmp_path / "a.ulg").write_bytes(content)
    import_file(tmp_path / "a.ulg", tmp_path / "a.mcap", AIRCRAFT)
    return tmp_path / "a.mcap"


def test_topics_become_streams_with_their_own_times(tmp_path: Path) -> None:
    half = math.sqrt(0.5)
    path = imported(
        tmp_path,
        ulog(
            (
                "sensor_combined",
                "float[3] gyro_rad;float[3] accelerometer_m_s2;",
                [struct.pack("<Q6f", 2_000_000 + 5_000 * i, 0.5, i, -0.25, 0, 0, -9.75) for i in range(40)],
            ),
            (
                "vehicle_attitude",
                "float[4] q;",
                # Nose up a quarter turn less a bit is singular; a yaw of +90 deg is plain.
                [struct.pack("<Q4f", 2_000_000 + 20_000 * i, half, 0, 0, half) for i in range(10)],
            ),
            (
                "vehicle_global_position",
                "double lat;double lon;float alt;",
                [struct.pack("<Qddf", 2_000_000 + 100_000 * i, 45.0, -90.0, 1000.0) for i in range(3)],
            ),
            ("airspeed", "float true_airspeed_m_s;", [struct.pack("<Qf", 2_100_000, 20.5)]),
        ),
    )
    info = metadata(path)
    assert {s.name: s.signals for s in info.streams} == {
        "sensor_combined": ("p", "q", "r", "ax", "ay", "az"),
        "vehicle_attitude": ("phi", "theta", "psi"),
        "vehicle_global_position": ("latitude", "longitude", "altitude"),
        "airspeed": ("airspeed",),
    }
    assert (info.about.source, info.about.imported) == ("ulog", True)
    gyro = [r for r in read_rows(path) if isinstance(r, Sample) and r.stream == "sensor_combined"]
    assert [r.t_device_ns for r in gyro] == [2_000_000_000 + 5_000_000 * i for i in range(40)]
    assert gyro[3].values == (0.5, 3.0, -0.25, 0.0, 0.0, -9.75)
    found = table(path)
    assert np.diff(found.t_s) == pytest.approx(0.02)
    psi = found.columns["psi"]
    assert psi[~np.isnan(psi)] == pytest.approx(math.pi / 2, abs=1e-6)
    assert found.columns["latitude"][0] == pytest.approx(math.pi / 4)
    assert found.columns["q"][1] == pytest.approx(4.0)


def test_signs_of_the_quaternion(tmp_path: Path) -> None:
    # Roll +0.1, then pitch +0.2, then yaw -0.3 (order 3-2-1), multiplied out by hand as half-angle products.
    c, s = [math.cos(a / 2) for a in (0.1, 0.2, -0.3)], [math.sin(a / 2) for a in (0.1, 0.2, -0.3)]
    w = c[0] * c[1] * c[2] + s[0] * s[1] * s[2]
    x = s[0] * c[1] * c[2] - c[0] * s[1] * s[2]
    y = c[0] * s[1] * c[2] + s[0] * c[1] * s[2]
    z = c[0] * c[1] * s[2] - s[0] * s[1] * c[2]
    rows = [struct.pack("<Q4f", 20_000 * i, w, x, y, z) for i in range(1, 4)]
    found = table(imported(tmp_path, ulog(("vehicle_attitude", "float[4] q;", rows))))
    assert [found.columns[n][0] for n in ("phi", "theta", "psi")] == pytest.approx([0.1, 0.2, -0.3], abs=1e-6)


def test_airflow_sensors_give_flow_angles_where_they_are_valid(tmp_path: Path) -> None:
    rows = [struct.pack("<Qf?", 20_000 * i, 0.01 * i, i != 3) for i in range(1, 6)]
    slip = [struct.pack("<Qf?", 20_000 * i, -0.02, True) for i in range(1, 6)]
    path = imported(
        tmp_path,
        ulog(("airflow_aoa", "float aoa_rad;bool valid;", rows), ("airflow_slip", "float slip_rad;bool valid;", slip)),
    )
    samples = [r for r in read_rows(path) if isinstance(r, Sample)]
    alpha = [r.values[0] for r in samples if r.stream == "airflow_aoa"]
    assert alpha == pytest.approx([0.01, 0.02, math.nan, 0.04, 0.05], nan_ok=True)
    assert [r.values[0] for r in samples if r.stream == "airflow_slip"] == pytest.approx([-0.02] * 5)


def test_what_is_no_px4_log_or_holds_nothing_known_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="not a PX4 log"):
        imported(tmp_path, b"nothing of the kind")
    with pytest.raises(LogError, match="none of the topics"):
        imported(tmp_path, ulog(("battery_status", "float voltage_v;", [struct.pack("<Qf", 1, 12.0)])))
    assert not (tmp_path / "a.mcap").exists()
