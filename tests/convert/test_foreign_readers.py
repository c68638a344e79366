"""Exports opened by the programs that they are for: pyulog, pymavlink's log reader, mcap's own reader."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from mcap.reader import make_reader
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as dialect
from pyulog import ULog
from scipy.spatial.transform import Rotation

from station.conventions import SIGNAL_INDEX, SIGNALS, TICK_NS, Stream, ned_from_body
from station.convert import export, import_file
from station.log import About, table, write_log
from station.profile import load_aircraft, load_card
from station.rows import AlphaEstimate, Code, Event, Frame, Health, LogError, RawBlock, Rows, Sample, StreamHealth

TWIN_OTTER = load_card("mavlink_only")
STREAMS = (
    Stream("fc.imu", ("p", "q", "r", "ax", "ay", "az"), 50.0, 0.2),
    Stream("fc.attitude", ("phi", "theta", "psi", "v_north", "v_east", "v_down"), 50.0, 0.2),
    Stream("fc.position", ("latitude", "longitude", "altitude"), 50.0, 0.2),
    Stream("box.air", ("airspeed", "dynamic_pressure", "alpha_vane", "elevator"), 50.0, 0.2),
)
VALUES = {
    "p": 0.1, "q": -0.2, "r": 0.3, "ax": 0.5, "ay": -0.25, "az": -9.75, "phi": 0.5, "theta": 0.1, "psi": 2.0,
    "v_north": -20.0, "v_east": 50.0, "v_down": 1.5, "latitude": math.radians(47.25), "longitude": math.radians(8.5),
    "altitude": 2000.0, "airspeed": 55.0, "dynamic_pressure": 1500.0, "alpha_vane": 0.0625, "elevator": -0.03125,
}  # fmt: skip
ZERO, UTC = 5 * 10**9, 1_790_000_000 * 10**9
ROWS = 100


def packets() -> list[bytes]:
    """MAVLink as an autopilot would send it; by pymavlink, of both versions."""
    made = []
    for k in range(ROWS):
        sender = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        sender.seq = k % 256
        message = dialect.MAVLink_attitude_message(1000 + 20 * k, 0.001 * k, 0.1, 2.0, 0.0, 0.0, 0.0)
        made.append(bytes(message.pack(sender, force_mavlink1=k % 2 == 1)))
    return made


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    device = next(d.name for d in TWIN_OTTER.rig.devices if d.link == "mavlink")
    stream, rows = b"".join(packets()), list[Rows]()
    cuts = [len(stream) * k // ROWS for k in range(ROWS + 1)]  # not where packets begin
    for k in range(ROWS):
        t = ZERO + k * TICK_NS
        values = [math.nan] * len(SIGNALS)
        for name, value in VALUES.items():
            values[SIGNAL_INDEX[name]] = value + (0.001 * k if name == "q" else 0.0)
        rows.append(RawBlock(t, device, stream[cuts[k] : cuts[k + 1]]))
        rows.append(RawBlock(t, "box", b"\xfd noise of another device"))
        rows.append(Sample(t, "box.air", t, k, (55.0, 1500.0, 0.0625, -0.03125)))
        rows.append(Frame(t, k, tuple(values), (0.0,) * len(SIGNALS), (0,) * len(SIGNALS)))
        rows.append(AlphaEstimate(t, *[0.0625] * 12, "light", *[0.5] * 3, True, ""))
    silent = StreamHealth("fc.imu", "fc", 0.0, math.nan, "none", math.nan, math.nan, 0, 0, 0, False)
    rows.append(Health(ZERO, (silent,)))
    rows.append(Event(ZERO + TICK_NS, "box", Code.STALE, 1, "nothing for 0.20 s"))
    path = tmp_path / "flight.mcap"
    about = About(TWIN_OTTER.aircraft, STREAMS, TWIN_OTTER.rig, TWIN_OTTER.card)
    write_log(path, about, rows, station_ns=ZERO, utc_ns=UTC)
    return path


def test_pyulog_reads_the_ulog_with_px4s_topics(flight: Path, tmp_path: Path) -> None:
    assert export(flight, "ulog", tmp_path / "out.ulg") == (tmp_path / "out.ulg",)
    log = ULog(str(tmp_path / "out.ulg"))
    assert not log.file_corruption
    topics: dict[str, Any] = {d.name: d.data for d in log.data_list}
    gyro = topics["sensor_combined"]
    assert np.array_equal(gyro["timestamp"], ZERO // 1000 + 20_000 * np.arange(ROWS))
    assert np.allclose(gyro["gyro_rad[1]"], -0.2 + 0.001 * np.arange(ROWS), atol=1e-7)  # single precision
    assert gyro["accelerometer_m_s2[2]"].tolist() == [-9.75] * ROWS
    position = topics["vehicle_global_position"]
    assert position["lat"] == pytest.approx([47.25] * ROWS)
    q = [topics["vehicle_attitude"][f"q[{i}]"][7] for i in range(4)]
    expected = ned_from_body(VALUES["phi"], VALUES["theta"], VALUES["psi"])
    assert np.allclose(Rotation.from_quat([*q[1:], q[0]]).as_matrix(), expected, atol=1e-6)
    assert topics["station_signals"]["alpha_vane"].tolist() == [0.0625] * ROWS
    assert topics["airspeed_validated"]["true_airspeed_m_s"].tolist() == [55.0] * ROWS
    (said,) = log.logged_messages
    assert (said.log_level_str(), said.message) == ("ALERT", "[box] STALE nothing for 0.20 s")
    assert log.msg_info_dict["ver_hw"] == "twin_otter"
    assert log.initial_parameters["MAV_TYPE"] == 1


def test_the_ulog_comes_back_as_a_record(flight: Path, tmp_path: Path) -> None:
    export(flight, "ulog", tmp_path / "out.ulg")
    import_file(tmp_path / "out.ulg", tmp_path / "again.mcap", load_aircraft("twin_otter"))
    again = table(tmp_path / "again.mcap").columns
    for name in ("p", "q", "az", "phi", "psi", "v_down", "latitude", "airspeed", "dynamic_pressure"):
        expected = VALUES[name] + (0.001 * np.arange(ROWS) if name == "q" else 0.0)
        assert np.allclose(again[name], expected, rtol=1e-6, atol=1e-6), name  # single precision


def test_pymavlink_reads_the_telemetry_log_packet_by_packet(flight: Path, tmp_path: Path, station) -> None:
    out = tmp_path / "out.tlog"
    assert station("export", flight, "--to", "tlog", "-o", out)[0] == 0
    log = mavutil.mavlink_connection(str(out))
    try:
        found = []
        while (message := log.recv_msg()) is not None:
            found.append((message.get_type(), message.time_boot_ms, message._timestamp, bytes(message.get_msgbuf())))
    finally:
        log.close()
    assert [f[0] for f in found] == ["ATTITUDE"] * ROWS
    assert [f[1] for f in found] == [1000 + 20 * k for k in range(ROWS)]
    assert [f[3] for f in found] == packets()
    # Stamped when the packet's last byte came: in the block of its own number, or the one after.
    arrivals = np.array([f[2] for f in found]) - UTC / 1e9
    assert np.all(arrivals >= 0.02 * np.arange(ROWS) - 1e-6)
    assert np.all(arrivals <= 0.02 * (np.arange(ROWS) + 1) + 1e-6)


def test_a_recording_without_mavlink_gives_no_telemetry_log(tmp_path: Path, station) -> None:
    write_log(tmp_path / "a.mcap", About(TWIN_OTTER.aircraft, ()), [RawBlock(0, "box", b"\xfd")])
    code, _, err = station("export", tmp_path / "a.mcap", "--to", "tlog", "-o", tmp_path / "out.tlog")
    assert (code, "has no raw MAVLink: no device of its rig speaks it" in err) == (1, True)
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]
    # Simulated: a rig that speaks it, and no bytes.
    write_log(tmp_path / "b.mcap", About(TWIN_OTTER.aircraft, (), rig=TWIN_OTTER.rig), [])
    code, _, err = station("export", tmp_path / "b.mcap", "--to", "tlog", "-o", tmp_path / "out.tlog")
    assert (code, "only a recording by station run keeps what devices sent" in err) == (1, True)
    assert not (tmp_path / "out.tlog").exists()


def test_mcaps_reader_reads_it_for_foxglove_and_every_message_fits_its_schema(flight: Path, tmp_path: Path) -> None:
    export(flight, "mcap", tmp_path / "out.mcap")
    found: dict[str, list[tuple[Any, int, Any]]] = {}
    with (tmp_path / "out.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        for schema, channel, message in reader.iter_messages():
            body = json.loads(message.data)
            jsonschema.validate(body, json.loads(schema.data))
            found.setdefault(channel.topic, []).append((schema.name, message.log_time, body))
    assert {t: found[t][0][0] for t in ("/location", "/pose", "/event")} == {
        "/location": "foxglove.LocationFix", "/pose": "foxglove.PoseInFrame", "/event": "foxglove.Log",
    }  # fmt: skip
    assert "age_s" not in found["/health"][0][2]["streams"][0]
    assert not any(topic.startswith("/raw") for topic in found)
    assert len(found["/frame"]) == ROWS
    assert "mass" not in found["/frame"][0][2], "missing throughout, and null is no number"
    assert found["/frame"][0][1] == UTC
    assert len(found["/location"]) == ROWS / 5
    assert found["/location"][0][2]["latitude"] == pytest.approx(47.25)
    (event,) = found["/event"]
    assert event[2]["timestamp"] == {"sec": UTC // 10**9, "nsec": TICK_NS}
    assert (event[2]["file"], event[2]["line"], event[2]["name"]) == ("", 0, "box")
    pose = found["/pose"][-1][2]["pose"]
    assert pose["position"] == {"x": 0.0, "y": 0.0, "z": 0.0}
    flu = Rotation.from_quat([pose["orientation"][a] for a in "xyzw"]).as_matrix()
    enu_from_ned = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    ned = ned_from_body(VALUES["phi"], VALUES["theta"], VALUES["psi"])
    assert np.allclose(flu, enu_from_ned @ ned @ np.diag([1, -1, -1]), atol=1e-12)


@pytest.mark.parametrize("form", ["csv", "parquet", "mat", "mdf4", "ulog", "mcap", "rrd"])
def test_an_export_that_is_interrupted_leaves_nothing(
    flight: Path, tmp_path: Path, station, monkeypatch: pytest.MonkeyPatch, form: str
) -> None:
    """Ctrl-C while the file is closed, as late as can be; and a file that is there already stays as it is."""
    folder = tmp_path / "out"
    folder.mkdir()

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("station.convert.new_file.os.link", interrupted)
        code, _, _ = station("export", flight, "--to", form, "-o", folder / f"a.{form}")
    assert (code, list(folder.iterdir())) == (130, [])
    there = folder / f"a.{form}"
    there.write_text("mine")
    code, _, err = station("export", flight, "--to", form, "-o", there)
    assert code == 1
    assert "exists already and is not overwritten" in err
    assert there.read_text() == "mine"
    assert list(folder.iterdir()) == [there]


def test_nothing_but_raw_bytes_is_no_ulog(tmp_path: Path) -> None:
    write_log(tmp_path / "a.mcap", About(TWIN_OTTER.aircraft, ()), [RawBlock(0, "box", b"\xfd")])
    with pytest.raises(LogError, match="holds neither frames nor samples"):
        export(tmp_path / "a.mcap", "ulog", tmp_path / "out.ulg")
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]
