"""DataFlash logs: bytes packed by hand after ArduPilot's FMT messages, read with pymavlink."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import pytest

from drivers.dataflash import left_out, read_dataflash
from station.convert import Importer, import_file, reader_of
from station.log import table
from station.profile import load_aircraft
from station.rows import LogError

_SIZES = {"Q": 8, "B": 1, "f": 4, "c": 2, "C": 2, "L": 4, "H": 2, "I": 4, "e": 4}
_PACK = {"Q": "Q", "B": "B", "f": "f", "c": "h", "C": "H", "L": "i", "H": "H", "I": "I", "e": "i"}
_SCALE = {"c": 100, "C": 100, "e": 100, "L": 1e7}


def fmt(kind: int, name: str, form: str, columns: str) -> bytes:
    length = 3 + sum(_SIZES[c] for c in form)
    return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, length, name.encode(), form.encode(), columns.encode())


def message(kind: int, form: str, *values: float) -> bytes:
    wire = [round(v * _SCALE[c]) if c in _SCALE else v for c, v in zip(form, values, strict=True)]
    return b"\xa3\x95" + bytes([kind]) + struct.pack("<" + "".join(_PACK[c] for c in form), *wire)


IMU = (130, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
ATT = (131, "ATT", "Qccc", "TimeUS,Roll,Pitch,Yaw")
GPS = (132, "GPS", "QBBLLefff", "TimeUS,I,Status,Lat,Lng,Alt,Spd,GCrs,VZ")
EKF = (133, "XKF1", "QBfff", "TimeUS,C,VN,VE,VD")
ARSP = (134, "ARSP", "QBfff", "TimeUS,I,Airspeed,DiffPress,Temp")
BARO = (135, "BARO", "QBff", "TimeUS,I,Press,Temp")


def log(*rows: tuple[tuple[int, str, str, str], tuple[float, ...]]) -> bytes:
    out = b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", 128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    for kind in dict.fromkeys(k for k, _ in rows):
        out += fmt(*kind)
    return out + b"".join(message(kind[0], kind[2], *values) for kind, values in rows)


def written(tmp_path: Path, content: bytes) -> Path:
    (tmp_path / "a.bin").write_bytes(content)
    return tmp_path / "a.bin"


def test_messages_become_signals_in_si(tmp_path: Path) -> None:
    rows: list[tuple[tuple[int, str, str, str], tuple[float, ...]]] = []
    for i in range(5):
        t = 1_000_000 + 20_000 * i
        rows.append((IMU, (t, 0, 0.5, i, -0.25, 0.0, 0.5, -9.75)))
        rows.append((IMU, (t, 1, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0)))
        rows.append((ATT, (t, 90.0, -45.0, 180.0)))
    rows.append((GPS, (1_000_000, 0, 3, 45.0, -90.0, 1000.5, 10.0, 90.0, -2.0)))
    rows.append((GPS, (1_200_000, 0, 1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)))
    found = {name: (t_ns, columns) for name, t_ns, columns in read_dataflash(written(tmp_path, log(*rows)))}
    t_ns, imu = found["IMU"]
    assert t_ns == [1_000_000_000 + 20_000_000 * i for i in range(5)]
    assert imu["q"] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert (imu["p"][0], imu["r"][0], imu["ay"][0], imu["az"][0]) == (0.5, -0.25, 0.5, -9.75)
    _, attitude = found["ATT"]
    assert (attitude["phi"][0], attitude["theta"][0], attitude["psi"][0]) == pytest.approx(
        (math.pi / 2, -math.pi / 4, math.pi)
    )
    t_ns, gps = found["GPS"]
    assert t_ns == [1_000_000_000]
    assert gps["latitude"][0] == pytest.approx(math.pi / 4)
    assert gps["longitude"][0] == pytest.approx(-math.pi / 2)
    assert gps["altitude"][0] == pytest.approx(1000.5)
    assert (gps["v_north"][0], gps["v_east"][0], gps["v_down"][0]) == pytest.approx((0.0, 10.0, -2.0), abs=1e-6)


def test_the_filters_velocity_is_preferred(tmp_path: Path) -> None:
    rows = [
        (GPS, (1_000_000, 0, 3, 45.0, -90.0, 1000.0, 10.0, 0.0, 0.0)),
        (EKF, (1_000_000, 0, 1.0, 2.0, 3.0)),
        (EKF, (1_000_000, 1, 9.0, 9.0, 9.0)),
    ]
    found = {name: columns for name, _, columns in read_dataflash(written(tmp_path, log(*rows)))}
    assert found["XKF1"] == {"v_north": [1.0], "v_east": [2.0], "v_down": [3.0]}
    assert set(found["GPS"]) == {"latitude", "longitude", "altitude"}


def test_airspeed_is_made_true_with_the_measured_density(tmp_path: Path) -> None:
    rows = [(BARO, (1_000_000, 0, 54_019.9, 40.0)), (ARSP, (1_000_000, 0, 20.0, 245.0, 0.0))]
    found = {name: columns for name, _, columns in read_dataflash(written(tmp_path, log(*rows)))}
    # Standard atmosphere at 5000 m: 54,019.9 Pa, density 0.73612 kg/m3.
    assert found["ARSP"]["airspeed"][0] == pytest.approx(20.0 * math.sqrt(1.225 / 0.73612), rel=1e-4)
    assert found["ARSP"]["dynamic_pressure"] == [245.0]
    assert "air_temperature" not in found["ARSP"]
    assert found["BARO"]["static_pressure"][0] == pytest.approx(54_019.9, rel=1e-6)


def test_without_static_pressure_there_is_no_true_airspeed(tmp_path: Path) -> None:
    rows = [(ARSP, (1_000_000, 0, 20.0, 245.0, 15.0))]
    ((_, _, columns),) = read_dataflash(written(tmp_path, log(*rows)))
    assert columns == {"dynamic_pressure": [245.0]}


def test_a_log_is_imported(tmp_path: Path) -> None:
    rows = [(IMU, (1_000_000 + 20_000 * i, 0, 0.0, 0.25 * i, 0.0, 0.0, 0.0, -9.75)) for i in range(50)]
    path = written(tmp_path, log(*rows))
    kinds = (Importer(".bin", "DataFlash", reader_of("dataflash", read_dataflash)),)
    import_file(path, tmp_path / "a.mcap", load_aircraft("twin_otter"), kinds)
    found = table(tmp_path / "a.mcap")
    assert found.rate_hz == pytest.approx(50.0)
    assert found.columns["q"].tolist() == [0.25 * i for i in range(50)]


@pytest.mark.parametrize("content", [b"", b"not a log", bytes(5000), log((BARO, (1, 0, 1.0, 1.0)))[:150]])
def test_what_is_no_log_is_refused(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(LogError):
        read_dataflash(written(tmp_path, content))


def test_a_cut_log_gives_what_it_has(tmp_path: Path) -> None:
    rows = [(IMU, (1_000_000 + 20_000 * i, 0, 0.0, float(i), 0.0, 0.0, 0.0, -9.75)) for i in range(50)]
    ((_, t_ns, _),) = read_dataflash(written(tmp_path, log(*rows)[:-300]))
    assert 35 <= len(t_ns) < 50


def test_what_looks_like_a_signal_and_is_none_is_said(tmp_path: Path) -> None:
    aoa = (136, "AOA", "Qff", "TimeUS,AOA,SSA")
    rows = [(ATT, (1_000_000, 0.0, 0.0, 0.0)), (ATT, (1_020_000, 0.0, 0.0, 0.0))]
    assert left_out(written(tmp_path, log(*rows))) == {}
    path = written(tmp_path, log(*rows, (aoa, (1_000_000, 3.0, 0.0))))
    assert "calculated" in left_out(path)["alpha_vane"]
    assert [name for name, _, _ in read_dataflash(path)] == ["ATT"]
