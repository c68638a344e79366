"""Every link's bytes, read by the production codec, are the truth within quantisation; and the ports behave."""

from __future__ import annotations

import io
import math
import os
import select
import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial
from pyubx2 import UBX_PROTOCOL, UBXReader

from drivers.can_dbc import CanCodec
from drivers.can_dronecan import DronecanCodec
from drivers.codec import Codec, Reading, TimeReply
from drivers.emulated_device import wire_of
from drivers.emulated_messages import TRUTH_HZ, DeviceScript
from drivers.emulated_ports import PtyPort, TcpPort, UdpPort
from drivers.mavlink import MavlinkCodec
from drivers.protocols import protocol_named
from station.conventions import to_si
from station.profile import (
    CanDevice,
    Card,
    Device,
    DronecanDevice,
    MavlinkDevice,
    Rig,
    SerialDevice,
    load_rig,
    profiles_dir,
)
from station.rows import DeviceError

START_NS = 7_000_000_000_000
RIG_DIR = profiles_dir() / "rigs"
SECONDS = 2.0

LEVEL = {"airspeed": 56.6, "dynamic_pressure": 1800.0, "static_pressure": 92_500.0, "air_temperature": 283.2,
         "az": -9.8, "v_north": 56.0, "altitude": 762.0, "latitude": 0.7, "longitude": -1.4}  # fmt: skip
SWING = {"latitude": 1e-5, "longitude": 1e-5}

QUANTUM = {
    # half of what the wire's resolution is, where it is not the slope of the rig's channel: SI
    "can": {"p": to_si(0.025, "deg/s"), "ax": to_si(0.001, "g"), "airspeed": 0.01, "dynamic_pressure": 0.5,
            "static_pressure": 0.125, "air_temperature": 0.01, "phi": to_si(0.05, "deg"), "theta": to_si(0.025, "deg"),
            "psi": to_si(0.1, "deg"), "v_north": 0.05, "v_east": 0.05, "v_down": 0.02,
            "alpha_vane": to_si(0.005, "deg"), "beta_vane": to_si(0.005, "deg"), "elevator": to_si(0.005, "deg")},
    "ubx": {"latitude": to_si(1e-7, "deg"), "altitude": 1e-3, "v_north": 1e-3},
    # speed to 0.001 kt and track to 0.01 deg at 56 m/s; position to 1e-6 min or so
    "nmea": {"v_north": 0.01, "v_east": 0.02, "latitude": to_si(1e-6, "deg"), "altitude": 0.002},
    # single precision of degrees as of radians and of pressures, but for positions, which are double
    "vectornav": {},
    # half precision: 2**-11 of the number, 2**-5 of an attitude's quaternion in the worst case
    "dronecan": {"alpha_vane": 1e-4, "beta_vane": 1e-4, "elevator": 1e-4, "p": 1e-4, "ax": 1e-4, "az": 0.008,
                 "airspeed": 0.032, "air_temperature": 0.25, "phi": 5e-4, "theta": 5e-4, "psi": 5e-4,
                 "latitude": to_si(1e-8, "deg"), "altitude": 1e-3},
    "mavlink": {"latitude": to_si(1e-7, "deg"), "altitude": 1e-3, "air_temperature": 0.01},
}  # fmt: skip
ALIKE = {"q": "p", "r": "p", "ay": "ax", "az": "ax", "longitude": "latitude", "v_east": "v_north", "v_down": "v_north"}


def quantum(device: Device, signal: str, slope: float, unit: str) -> float:
    if isinstance(device, SerialDevice) and device.protocol.startswith("boombox"):
        return abs(to_si(slope, unit) - to_si(0.0, unit))
    table = QUANTUM[device.protocol if isinstance(device, SerialDevice) else device.link]
    found = table.get(signal) or table.get(ALIKE.get(signal, ""), 0.0)
    return found or 2e-5  # single precision of a number of that size


def codec_of(device: Device) -> Codec:
    if isinstance(device, CanDevice):
        return CanCodec(device, RIG_DIR)
    if isinstance(device, DronecanDevice):
        return DronecanCodec(device)
    if isinstance(device, MavlinkDevice):
        return MavlinkCodec(device)
    return protocol_named(device.protocol).codec()


def card(rig: str, **more: Any) -> Card:
    # A recording is sent without noise.
    flight = {"source": "recording", "device_clock_offset": "1000 s", "device_clock_drift_ppm": 50.0}
    return Card.model_validate({"name": "t", "aircraft": "twin_otter", "rig": rig, "flight": flight, **more})


def truth(signal: str, t: float | np.ndarray) -> Any:
    frequency = 0.2 + 0.03 * (sum(map(ord, signal)) % 17)
    return LEVEL.get(signal, 0.0) + SWING.get(signal, 0.2) * np.sin(2 * math.pi * frequency * t)


RIGS = ("bench", "boom_serial", "can_only", "mavlink_only", "mixed", "vectornav", "dronecan")
DEVICES = [
    pytest.param(rig, index, id=f"{rig}-{device.name}")
    for rig in RIGS
    for index, device in enumerate(load_rig(rig).devices)
]


def flown(rig: Rig, index: int, folder: Path, seconds: float = SECONDS) -> tuple[DeviceScript, list[tuple[int, bytes]]]:
    device = rig.devices[index]
    wire = wire_of(device, RIG_DIR, folder)
    try:
        script = DeviceScript(index, device, card(rig.name), START_NS, wire.encode, wire.also)
        t = np.arange(round(seconds * TRUTH_HZ) + 1) / TRUTH_HZ
        messages = script.extend(np.column_stack([truth(name, t) for name in script.signals]))
        return script, [(m.due_ns, script.encode(m)) for m in messages]
    finally:
        wire.port.close()


@pytest.mark.parametrize(("rig_name", "index"), DEVICES)
def test_the_production_codec_reads_the_truth(rig_name: str, index: int, tmp_path: Path) -> None:
    rig = load_rig(rig_name)
    device = rig.devices[index]
    script, messages = flown(rig, index, tmp_path)
    codec = codec_of(device)
    counts = {stream.name: 0 for stream in device.streams}
    for due_ns, data in messages:
        sent_s = (due_ns - START_NS) * 1e-9
        for reading in codec.feed(data):
            assert isinstance(reading, Reading)
            if reading.t_device_ns is not None:
                late = (script.clock.at(due_ns) - reading.t_device_ns) % reading.wrap_ns if reading.wrap_ns else 0
                # Stamps are cut or rounded to as much as 1 ms.
                assert min(late, abs(late - reading.wrap_ns)) <= 1_000_001
            for stream in device.streams:
                if stream.message != reading.message:
                    continue
                counts[stream.name] += 1
                for signal, channel in stream.signals.items():
                    # Truth is straight between its 200 Hz rows.
                    tolerance = 0.51 * quantum(device, signal, channel.slope, channel.unit) + 1e-4 * SWING.get(
                        signal, 0.2
                    )
                    if channel.table is not None:
                        tolerance = to_si(0.02, "deg")
                    value = channel.to_si(reading.fields[channel.field])
                    assert value == pytest.approx(truth(signal, sent_s), abs=tolerance, rel=1e-6), signal
    assert codec.bad == codec.resyncs == 0
    for stream in device.streams:
        assert counts[stream.name] == pytest.approx(stream.rate * SECONDS, abs=1.01), stream.name


def mavlink(url: str) -> MavlinkDevice:
    device = load_rig("mavlink_only").devices[0]
    assert isinstance(device, MavlinkDevice)
    return device.model_copy(update={"url": url})


@pytest.mark.parametrize(
    ("url", "kind"), [("emulated", UdpPort), ("udpin:0.0.0.0:14550", UdpPort), ("tcp:10.0.0.2:5760", TcpPort),
                      ("/dev/ttyACM0", PtyPort)]
)  # fmt: skip
def test_mavlink_is_emulated_on_the_kind_of_link_the_rig_names(url: str, kind: type, tmp_path: Path) -> None:
    wire = wire_of(mavlink(url), RIG_DIR, tmp_path)
    wire.port.close()
    assert type(wire.port) is kind


def test_the_emulated_autopilot_answers_time_requests_with_its_own_clock(tmp_path: Path) -> None:
    device = mavlink("tcp:127.0.0.1:5760")
    wire = wire_of(device, RIG_DIR, tmp_path)
    codec = MavlinkCodec(device)
    _, messages = flown(load_rig("mavlink_only"), 0, tmp_path, seconds=0.1)
    for _, data in messages:
        codec.feed(data)
    request = codec.outgoing(START_NS)
    assert wire.answer is not None
    replies = codec.feed(wire.answer(request, START_NS + 10**12))
    assert replies == [TimeReply(START_NS, START_NS + 10**12)]


def test_only_slcan_is_emulated_of_can(tmp_path: Path) -> None:
    device = load_rig("can_only").devices[0].model_copy(update={"interface": "socketcan"})
    with pytest.raises(DeviceError, match="socketcan"):
        wire_of(device, RIG_DIR, tmp_path)


def test_pyubx2_reads_the_receivers_frames(tmp_path: Path) -> None:
    rig = load_rig("boom_serial")
    _, messages = flown(rig, 1, tmp_path, seconds=1.0)
    stream = io.BytesIO(b"".join(data for _, data in messages))
    frames = [parsed for _, parsed in UBXReader(stream, protfilter=UBX_PROTOCOL, validate=1, quitonerror=2)]
    assert [f.identity for f in frames] == ["NAV-PVT"] * 10
    assert frames[5].fixType == 3
    assert frames[5].lat == pytest.approx(math.degrees(truth("latitude", 0.5008)), abs=1e-7)
    assert frames[5].velN == pytest.approx(1000 * truth("v_north", 0.5008), abs=0.6)


def test_a_pty_comes_back_under_the_same_name_after_an_unplug(tmp_path: Path) -> None:
    port = PtyPort(tmp_path / "boom")
    port.plug()
    try:
        with serial.Serial(port.endpoint, timeout=1.0) as reader:
            port.send([b"one", b"two"])
            assert reader.read(6) == b"onetwo"
            reader.write(b"C\r")
            select.select(port.descriptors(), [], [], 1.0)
            assert port.receive(port.descriptors()[0]) == b"C\r"
            port.unplug()
            assert not os.path.lexists(port.endpoint)
            with pytest.raises(OSError, match="no data"):
                reader.read(1)
            port.send([b"lost"])
        with pytest.raises(OSError, match="No such file"):
            serial.Serial(port.endpoint)
        port.plug()
        with serial.Serial(port.endpoint, timeout=1.0) as reader:
            port.send([b"back"])
            assert reader.read(4) == b"back"
    finally:
        port.close()
    assert list(tmp_path.iterdir()) == []


def test_a_pty_nobody_reads_drops_whole_messages(tmp_path: Path) -> None:
    port = PtyPort(tmp_path / "boom")
    port.plug()
    try:
        with serial.Serial(port.endpoint, timeout=0.2) as reader:
            for n in range(0, 20_001, 3):
                port.send([b"message %06d\n" % k for k in (n, n + 1, n + 2)])
            lines = reader.read(1 << 20).splitlines(keepends=True)
            port.send([])
            late = reader.read(1 << 16)
            assert len(late) < 14, "what nobody took in its time is not sent later"
            lines.append(late)
            for n in range(3):
                port.send([b"message %06d\n" % n])
            after = reader.read(1 << 16).splitlines(keepends=True)
    finally:
        port.close()
    assert 100 < len(lines) < 20_000
    whole = b"".join((*lines, *after)).splitlines()
    assert all(len(line) == 14 for line in whole)
    assert after[-1] == b"message 000002\n"


def test_udp_is_silent_while_unplugged() -> None:
    port = UdpPort()
    kind, host, number = port.endpoint.split(":")
    assert (kind, host) == ("udpin", "127.0.0.1")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind((host, int(number)))
        station.settimeout(1.0)
        try:
            port.send([b"not yet"])
            port.plug()
            port.send([b"a", b"b"])
            assert station.recv(99) == b"a"
            data, sender = station.recvfrom(99)
            assert data == b"b"
            station.sendto(b"time?", sender)
            select.select(port.descriptors(), [], [], 1.0)
            assert port.receive(port.descriptors()[0]) == b"time?"
            port.unplug()
            port.send([b"lost"])
            station.setblocking(False)
            with pytest.raises(BlockingIOError):
                station.recv(99)
        finally:
            port.close()


def test_tcp_hangs_up_when_unplugged_and_takes_clients_again() -> None:
    port = TcpPort()
    address = ("127.0.0.1", int(port.endpoint.rsplit(":", 1)[1]))
    try:
        for _ in range(2):
            port.plug()
            with socket.create_connection(address, timeout=1.0) as client:
                select.select(port.descriptors(), [], [], 1.0)
                port.receive(port.descriptors()[0])
                port.send([b"a", b"b"])
                assert client.recv(99) == b"ab"
                port.unplug()
                assert client.recv(99) == b""
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection(address, timeout=1.0)
    finally:
        port.close()
