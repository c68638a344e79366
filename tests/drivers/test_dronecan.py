"""DroneCAN's broadcasts: frames of the specification's layout by hand, transfers by dronecan's own encoder.

Oracles: UAVCAN v0 specification, CAN bus transport layer (identifier, tail byte, transfer CRC) written out with struct;
dronecan as the peer that sends. Half precision by numpy.
"""

from __future__ import annotations

import binascii
import math
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import dronecan
import numpy as np
import pytest
from dronecan.transport import Transfer
from hypothesis import given
from hypothesis import strategies as st

from drivers.adapter import check_devices
from drivers.can_dronecan import NODE_STATUS, USUAL, DronecanCodec, DronecanEncoder, fields_of
from drivers.can_frames import encode_slcan
from drivers.codec import Reading
from station.profile import DronecanDevice, Rig, read_profile
from station.rows import Code, ProfileError

AIR = "uavcan.equipment.air_data"
AOA, RAW_IMU, SOLUTION, FIX2, STATUS = USUAL[0], USUAL[7], USUAL[8], USUAL[10], USUAL[11]


def device(*messages: str, **more: Any) -> DronecanDevice:
    field = {"unit": "rad"}
    streams = [
        {
            "name": f"s{i}",
            "message": m,
            "rate": "10 Hz",
            "signals": {"alpha_vane": {**field, "field": fields_of(m)[0]}},
        }
        for i, m in enumerate(messages)
    ]
    return DronecanDevice.model_validate(
        {"name": "bus", "link": "dronecan", "channel": "can0", "streams": streams, **more}
    )


def line(number: int, node: int, data: bytes) -> bytes:
    """A broadcast's frame: priority 16, type of message, source node."""
    return encode_slcan(16 << 24 | number << 8 | node, True, data)


def half(value: float) -> bytes:
    return np.float16(value).tobytes()


def transfer(message: str, node: int = 42, transfer_id: int = 0, **fields: Any) -> list[bytes]:
    """The lines of a transfer by dronecan's own encoder."""
    payload = dronecan.TYPENAMES[message](**fields)
    frames = Transfer(payload=payload, source_node_id=node, transfer_id=transfer_id).to_frames()
    return [encode_slcan(f.message_id, True, bytes(f.bytes)) for f in frames]


def readings(codec: DronecanCodec, lines: Sequence[bytes]) -> list[Reading]:
    return [r for r in codec.feed(b"".join(lines)) if isinstance(r, Reading)]


def test_an_angle_of_attack_of_one_frame_worked_out_by_hand() -> None:
    """Type 1025: sensor_id, two halves, and the tail: start, end, transfer 7."""
    codec = DronecanCodec(device(AOA, f"{AOA}:254", f"{AOA}:3"))
    data = bytes((254,)) + half(0.0873) + half(1e-6) + bytes((0xC7,))
    found = readings(codec, [line(1025, 42, data)])
    assert [r.message for r in found] == [AOA, f"{AOA}:254"]
    assert found[0].fields["aoa"] == pytest.approx(0.0873, rel=2**-11)
    assert (found[0].t_device_ns, found[0].seq) == (None, None)


def test_air_data_of_three_frames_worked_out_by_hand() -> None:
    """The transfer CRC is CRC-16 over the type's signature and then the payload."""
    payload = bytes((0,)) + struct.pack("<2f", 92_500.0, 1_800.5) + half(300.0) + half(301.0) + half(283.25) + half(300)
    signature = dronecan.TYPENAMES[f"{AIR}.RawAirData"].get_data_type_signature()
    crc = binascii.crc_hqx(signature.to_bytes(8, "little") + payload, 0xFFFF)
    whole = crc.to_bytes(2, "little") + payload
    tails = (0x80 | 5, 0x20 | 5, 0x40 | 5)
    frames = [line(1027, 9, whole[7 * i : 7 * i + 7] + bytes((tail,))) for i, tail in enumerate(tails)]
    codec = DronecanCodec(device(f"{AIR}.RawAirData"))
    (found,) = readings(codec, frames)
    assert found.fields["differential_pressure"] == 1_800.5
    assert found.fields["static_air_temperature"] == 283.25
    assert (found.seq, found.seq_wrap) == (5, 32)
    hit = frames[1].replace(b"T", b"T", 1)
    broken = hit[:14] + (b"0" if hit[14:15] != b"0" else b"1") + hit[15:]
    assert readings(codec, [frames[0], broken, frames[2]]) == []
    assert codec.bad == 1


def test_a_lost_frame_costs_its_transfer_and_is_counted_once() -> None:
    codec = DronecanCodec(device(RAW_IMU))
    lines = transfer(RAW_IMU, accelerometer_latest=[0.5, 0.0, -9.8125])
    assert len(lines) == 7
    for lost in range(len(lines)):
        before = codec.bad
        cut = [*lines[:lost], *lines[lost + 1 :]]
        assert readings(codec, cut) == []
        (found,) = readings(codec, lines)
        assert found.fields["accelerometer_latest[2]"] == -9.8125
        assert codec.bad - before == (0 if lost == 0 else 1)  # without its first frame it is no transfer


def test_transfers_of_two_nodes_may_come_frame_by_frame_in_turn() -> None:
    codec = DronecanCodec(device(RAW_IMU, SOLUTION))
    mine, other = transfer(RAW_IMU), transfer(SOLUTION, node=43, orientation_xyzw=[0.0, 0.0, 0.0, 1.0])
    mixed = [one for pair in zip(mine, other, strict=False) for one in pair] + mine[len(other) :]
    assert [r.message for r in readings(codec, mixed)] == [SOLUTION, RAW_IMU]
    assert codec.bad == 0


def test_who_else_sends_a_message_is_passed_over_and_told() -> None:
    codec = DronecanCodec(device(RAW_IMU))
    assert len(readings(codec, transfer(RAW_IMU) + transfer(RAW_IMU, node=43))) == 1
    assert codec.foreign == {"node 43": 1}
    chosen = DronecanCodec(device(RAW_IMU, node_id=43))
    assert len(readings(chosen, transfer(RAW_IMU) + transfer(RAW_IMU, node=43))) == 1
    assert chosen.foreign == {"node 42": 1}


def test_stamps_are_of_one_node_and_0_is_none() -> None:
    codec = DronecanCodec(device(RAW_IMU, FIX2))
    stamp = dronecan.TYPENAMES["uavcan.Timestamp"](usec=1_500_000)
    found = readings(
        codec,
        transfer(RAW_IMU)
        + transfer(RAW_IMU, timestamp=stamp)
        + transfer(FIX2, node=43, timestamp=dronecan.TYPENAMES["uavcan.Timestamp"](usec=9), status=3),
    )
    assert [r.t_device_ns for r in found] == [None, 1_500_000_000, None]


@pytest.mark.parametrize(("status", "is_fix"), [(0, False), (1, False), (2, True), (3, True)])
def test_a_fix_without_position_has_no_fields(status: int, is_fix: bool) -> None:
    (found,) = readings(DronecanCodec(device(FIX2)), transfer(FIX2, status=status, ned_velocity=[50.0, 1.0, -1.0]))
    assert bool(found.fields) is is_fix


def test_the_quaternion_is_an_attitude() -> None:
    """Half a right angle nose up: y of sin, w of cos of its half."""
    q = [0.0, math.sin(math.pi / 8), 0.0, math.cos(math.pi / 8)]
    (found,) = readings(DronecanCodec(device(SOLUTION)), transfer(SOLUTION, orientation_xyzw=q))
    assert found.fields["pitch"] == pytest.approx(math.pi / 4, abs=1e-3)
    assert found.fields["roll"] == found.fields["yaw"] == 0.0


def test_a_node_that_is_unwell_or_restarts_is_told_once() -> None:
    codec = DronecanCodec(device(AOA))
    for health, uptime in ((0, 100), (2, 101), (2, 102), (0, 103), (0, 1)):
        codec.feed(b"".join(transfer(NODE_STATUS, health=health, uptime_sec=uptime)))
    assert codec.news() == [
        (Code.HEALTH, "node 42 is ERROR, operational"),
        (Code.FRESH, "HEALTH over: node 42 is OK, operational"),
        (Code.HEARD, "node 42 has restarted"),
    ]
    assert codec.news() == []


@given(st.lists(st.tuples(st.sampled_from((1003, 1000, 341)), st.binary(max_size=8)), max_size=60))
def test_any_frames_are_counted_never_raised(frames: list[tuple[int, bytes]]) -> None:
    codec = DronecanCodec(device(RAW_IMU, SOLUTION))
    for number, data in frames:
        codec.feed(line(number, 42, data))


@pytest.mark.parametrize("message", USUAL)
def test_what_the_emulated_node_sends_is_what_dronecan_sends(message: str) -> None:
    lines = DronecanEncoder(42).encode(Reading(message, 0, 0, {}))
    payload = dronecan.TYPENAMES[message]()
    assert dronecan.get_dronecan_data_type(payload).full_name == message
    (found,) = readings(DronecanCodec(device(message)), [lines])
    assert found.fields == {} or set(found.fields) == set(fields_of(message))


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("message", "uavcan.equipment.air_data.AngelOfAttack", "AngleOfAttack"),
        ("message", "uavcan.equipment.ahrs.RawIMU:1", "no message"),
        ("field", "aao", "aoa"),
        ("node_id", 200, "node_id"),
    ],
)
def test_a_rig_that_does_not_fit_is_refused_with_what_is_there(key: str, value: Any, said: str, tmp_path: Path) -> None:
    message = value if key == "message" else AOA
    field = value if key == "field" else "aoa"
    node = value if key == "node_id" else 42
    path = tmp_path / "rig.toml"
    path.write_text(
        f"""name = "rig"
[[devices]]
name = "bus"
link = "dronecan"
interface = "socketcan"
channel = "can0"
node_id = {node}
[[devices.streams]]
name = "alpha"
message = "{message}"
rate = "100 Hz"
signals.alpha_vane = {{ field = "{field}", unit = "rad" }}
"""
    )
    with pytest.raises(ProfileError, match=said):
        check_devices(read_profile(Rig, path), path)
