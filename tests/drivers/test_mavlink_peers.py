"""MAVLink against implementations that nobody here wrote: MAVSDK (C++) and MAVProxy.

Both read what MavlinkEncoder sends over UDP, and what MAVSDK sends is read by MavlinkCodec. MAVSDK also reads what a
simulator sends to an autopilot in HIL.
"""

from __future__ import annotations

import json
import os
import queue
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage
from pymavlink import mavutil

from drivers.codec import Reading
from drivers.mavlink import MavlinkCodec, MavlinkEncoder
from drivers.mavlink_hil import MavlinkHil
from station.profile import LOOP_HZ, MavlinkDevice
from tests.drivers.px4_like import Px4Like
from tests.drivers.test_mavlink_hil import ROW, loop

MESSAGES: dict[str, dict[str, float]] = {
    "ATTITUDE": {"roll": 0.1, "pitch": -0.2, "yaw": 3.0, "rollspeed": 0.01, "pitchspeed": -0.02, "yawspeed": 0.03},
    "ATTITUDE_QUATERNION": {"roll": 0.1, "pitch": -0.2, "yaw": 3.0, "pitchspeed": -0.02},
    "HIGHRES_IMU": {"xacc": 0.3, "zacc": -9.8, "ygyro": 0.05, "abs_pressure": 753.2, "temperature": 15.0},
    "RAW_IMU": {"xacc": 31.0, "zacc": -1001.0, "ygyro": 50.0, "temperature": 15.0},
    "SCALED_IMU": {"xacc": 0.031, "zacc": -1.001, "ygyro": 0.05, "temperature": -4.25},
    "SCALED_IMU2": {"zacc": -1.001, "ygyro": 0.05},
    "SCALED_IMU3": {"zacc": -1.001, "ygyro": 0.05},
    "LOCAL_POSITION_NED": {"x": 10.0, "z": -2500.0, "vx": 60.0, "vy": -1.5, "vz": 0.25},
    "GLOBAL_POSITION_INT": {"lat": 37.0862543, "lon": -76.3808217, "alt": 2500.123, "vx": 60.01, "hdg": 359.5},
    "GPS_RAW_INT": {"lat": 37.0862543, "lon": -76.3808217, "alt": 2500.123, "vel": 61.25, "cog": 12.5},
    "SCALED_PRESSURE": {"press_abs": 753.2, "press_diff": 22.5, "temperature": -4.25},
    "VFR_HUD": {"airspeed": 61.5, "groundspeed": 60.0, "heading": 359.0, "alt": 2500.0, "climb": -0.5},
    "AIRSPEED": {"airspeed": 61.5, "temperature": -4.25, "raw_press": 22.5},
    "AOA_SSA": {"AOA": 3.25, "SSA": -1.5},
    "SERVO_OUTPUT_RAW": {"servo1_raw": 1500.0, "servo16_raw": 1999.0},
    "ACTUATOR_OUTPUT_STATUS": {"active": 3.0, "actuator0": 0.25, "actuator31": -1.0},
    "NAMED_VALUE_FLOAT:pot_e": {"value": 512.5},
}
DEVICE_NS = 123_456_000_000


class Emulated:
    """An autopilot on UDP: sends every message 20 times a second, answers, and keeps what it is sent."""

    def __init__(self, port: int) -> None:
        self.heard = b""
        self._encoder = MavlinkEncoder()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.05)
        self._peer = ("127.0.0.1", port)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        k = 0
        while not self._stop.is_set():
            packets = [self._encoder.heartbeat()] if k % 10 == 0 else []
            packets += [self._encoder.encode(m, fields, DEVICE_NS) for m, fields in MESSAGES.items()]
            k += 1
            for packet in packets:
                self._send(packet)
            try:
                data = self._socket.recv(65_535)
            except (TimeoutError, ConnectionRefusedError):
                continue
            self.heard += data
            self._send(self._encoder.answer(data, DEVICE_NS))

    def _send(self, data: bytes) -> None:
        try:
            self._socket.sendto(data, self._peer)
        except ConnectionRefusedError:
            return

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._socket.close()


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def emulated(port: int) -> Iterator[Emulated]:
    one = Emulated(port)
    try:
        yield one
    finally:
        one.close()


def wait_for(condition: Callable[[], bool], seconds: float) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.02)
    return condition()


def codec() -> MavlinkCodec:
    return MavlinkCodec(
        MavlinkDevice.model_validate(
            {
                "link": "mavlink",
                "name": "autopilot",
                "url": "emulated",
                # MAVSDK's own as a ground station.
                "system_id": 245,
                "component_id": 190,
                "streams": [
                    {
                        "name": "attitude",
                        "message": "ATTITUDE",
                        "rate": "50 Hz",
                        "signals": {"theta": {"field": "pitch", "unit": "rad"}},
                    }
                ],
            }
        )
    )


AOA_SSA_XML = """<mavlink><messages><message id="11020" name="AOA_SSA"><description>a</description>
<field type="uint64_t" name="time_usec">t</field><field type="float" name="AOA">a</field>
<field type="float" name="SSA">s</field></message></messages></mavlink>"""

WIRE_COUNTS = {
    ("RAW_IMU", "temperature"): 1500,
    ("SCALED_IMU", "xacc"): 31,
    ("SCALED_IMU", "temperature"): -425,
    **{(name, "zacc"): -1001 for name in ("SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")},
    **{(name, "ygyro"): 50 for name in ("SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")},
    ("GLOBAL_POSITION_INT", "lat"): 370862543,
    ("GLOBAL_POSITION_INT", "lon"): -763808217,
    ("GLOBAL_POSITION_INT", "alt"): 2500123,
    ("GLOBAL_POSITION_INT", "vx"): 6001,
    ("GLOBAL_POSITION_INT", "hdg"): 35950,
    ("GPS_RAW_INT", "lat"): 370862543,
    ("GPS_RAW_INT", "lon"): -763808217,
    ("GPS_RAW_INT", "alt"): 2500123,
    ("GPS_RAW_INT", "vel"): 6125,
    ("GPS_RAW_INT", "cog"): 1250,
    ("SCALED_PRESSURE", "temperature"): -425,
    ("AIRSPEED", "temperature"): -425,
}
"""MAVLink's definitions, by hand: degE7, mm, cm/s, cdeg, cdegC. All other fields are sent in plain units."""


def test_mavsdk_reads_and_is_read() -> None:
    port = free_port()
    got: dict[str, dict[str, Any]] = {}
    with (
        Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk,
        emulated(port) as autopilot,
    ):
        mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        system = mavsdk.first_autopilot(10.0)
        assert system is not None, "MAVSDK saw no autopilot"
        assert system.get_system_id() == 1
        direct = MavlinkDirect(system)
        direct.load_custom_xml(AOA_SSA_XML)

        def keep(message: MavlinkMessage, _: Any) -> None:
            got[message.message_name] = json.loads(message.fields_json)

        direct.subscribe_message("", keep)
        wanted = {name.partition(":")[0] for name in MESSAGES}
        wait_for(lambda: wanted <= got.keys(), 5.0)
        known = wanted & got.keys()
        fields = {"roll": 0.125, "pitch": -0.25, "yaw": 1.5, "rollspeed": 0.5, "pitchspeed": -1.0, "yawspeed": 2.0}
        sent = {"time_boot_ms": 4567, **fields}
        direct.send_message(MavlinkMessage("ATTITUDE", 0, 0, 1, 0, json.dumps(sent)))
        reader = codec()
        readings: list[Reading] = []
        taken = 0

        def read() -> bool:
            nonlocal taken
            block, taken = autopilot.heard[taken:], len(autopilot.heard)
            readings.extend(r for r in reader.feed(block) if isinstance(r, Reading) and r.message == "ATTITUDE")
            return bool(readings)

        assert wait_for(read, 5.0)
        assert (readings[0].t_device_ns, readings[0].fields) == (4_567_000_000, fields)
        assert reader.bad == reader.resyncs == 0
    assert known == wanted
    for message, fields in MESSAGES.items():
        name = message.partition(":")[0]
        for field, value in fields.items():
            if name == "ATTITUDE_QUATERNION" and field in ("roll", "pitch", "yaw"):
                continue
            at = got[name]
            seen = at["actuator"][int(field.removeprefix("actuator"))] if field.startswith("actuator") else at[field]
            assert seen == pytest.approx(WIRE_COUNTS.get((name, field), value), rel=1e-6), (name, field)
    assert got["NAMED_VALUE_FLOAT"]["name"] == "pot_e"
    assert got["ATTITUDE"]["time_boot_ms"] == 123_456
    assert got["AOA_SSA"]["time_usec"] == 123_456_000


HIL_WIRE: dict[str, dict[str, float]] = {
    "HIL_SENSOR": {"abs_pressure": 925.0, "diff_pressure": 18.0, "temperature": 10.0, "fields_updated": 8191},
    "HIL_GPS": {"fix_type": 3, "alt": 762_000, "vn": -4500, "ve": 3375, "vd": 150, "vel": 5625, "id": 0},
    "HIL_STATE_QUATERNION": {"rollspeed": 0.01, "pitchspeed": -0.02, "true_airspeed": 5630, "zacc": -989},
}
"""Of test_mavlink_hil.ROW, by hand: hPa, mm, cm/s, rad/s, mG."""


def test_mavsdk_reads_what_an_autopilot_in_hil_is_sent() -> None:
    port = free_port()
    got: dict[str, dict[str, Any]] = {}
    session = MavlinkHil(loop(lock_step=False))
    assert session.feed(Px4Like().hello(), 0) == []
    with (
        Mavsdk(Configuration.create_with_component_type(ComponentType.AUTOPILOT)) as mavsdk,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        step, begun = 0, time.monotonic()

        def send() -> None:
            nonlocal step
            while step < (time.monotonic() - begun) * LOOP_HZ:
                if sent := session.outgoing(step, ROW, round(step / LOOP_HZ * 1e9)):
                    sender.sendto(sent, ("127.0.0.1", port))
                step += 1

        def there() -> bool:
            send()
            return bool(mavsdk.get_systems())

        assert wait_for(there, 10.0), "MAVSDK saw no system"
        direct = MavlinkDirect(mavsdk.get_systems()[0])
        direct.subscribe_message("", lambda m, _: got.__setitem__(m.message_name, json.loads(m.fields_json)))

        def all_there() -> bool:
            send()
            return HIL_WIRE.keys() <= got.keys()

        wait_for(all_there, 5.0)
    assert HIL_WIRE.keys() <= got.keys()
    for message, fields in HIL_WIRE.items():
        for field, value in fields.items():
            # The sensors' own noise: a tenth of a hectopascal.
            assert got[message][field] == pytest.approx(value, rel=1e-6, abs=0.1), (message, field)


def test_mavproxy_reads(tmp_path: Path) -> None:
    """It finds the vehicle, fetches its parameters, and logs what it received; its log holds our values."""
    port = free_port()
    script = Path(sys.executable).with_name("mavproxy.py")
    if not script.is_file():
        pytest.skip("mavproxy.py is not installed beside this Python")
    command = [
        *(sys.executable, str(script), f"--master=udp:127.0.0.1:{port}", f"--state-basedir={tmp_path}"),
        *("--non-interactive", "--default-modules=link,param", f"--logfile={tmp_path / 'mav.tlog'}"),
    ]
    lines: queue.Queue[str] = queue.Queue()
    seen = ""

    def said(words: str) -> Callable[[], bool]:
        def condition() -> bool:
            nonlocal seen
            while not lines.empty():
                seen += lines.get()
            return words in seen

        return condition

    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "HOME": str(tmp_path), "MAVLINK20": "1", "PYTHONUNBUFFERED": "1"},
    )
    assert process.stdout is not None
    output = process.stdout
    reader = threading.Thread(target=lambda: [lines.put(line) for line in output])
    reader.start()
    try:
        with emulated(port):
            assert wait_for(said("Detected vehicle 1:1"), 20.0), seen
            assert wait_for(said("Received 2 parameters"), 20.0), seen
            time.sleep(0.5)
    finally:
        process.terminate()
        process.wait(10.0)
        reader.join()
        output.close()
    log = mavutil.mavlink_connection(str(tmp_path / "mav.tlog"), dialect="ardupilotmega")
    received: dict[str, Any] = {}
    try:
        while message := log.recv_match():
            received[message.get_type()] = message
    finally:
        log.close()
    assert "BAD_DATA" not in received
    assert {name.partition(":")[0] for name in MESSAGES} <= received.keys()
    assert (received["AOA_SSA"].AOA, received["AOA_SSA"].SSA) == (3.25, -1.5)
    assert received["GLOBAL_POSITION_INT"].lat == 370862543
    assert received["ATTITUDE"].time_boot_ms == 123_456
