"""The MAVLink codec and encoder, against frames built here by hand from the standard's text."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drivers.mavlink import MavlinkCodec, MavlinkEncoder
from drivers.mavlink_messages import DERIVED, TABLE, fields_known
from station.conventions import unit_named
from tests.drivers.mavlink_by_hand import (
    AOA_SSA,
    ATTITUDE,
    ATTITUDE_BYTES,
    ATTITUDE_FIELDS,
    ATTITUDE_PAYLOAD,
    GPS_RAW_INT,
    HEARTBEAT,
    NAMED,
    SECOND,
    SEEDED,
    crc_extra,
    device,
    packet,
    packet_1,
    readings,
    x25,
)


def test_the_standard_by_hand_is_the_standard() -> None:
    assert x25(b"123456789") == 0x6F91, "the check value of CRC-16/MCRF4XX"
    assert crc_extra(ATTITUDE) == 39, "as published in the message's reference"
    assert packet(30, ATTITUDE, ATTITUDE_PAYLOAD, seq=7)[:-2] == ATTITUDE_BYTES


@pytest.mark.parametrize("make", [packet, packet_1], ids=["MAVLink 2", "MAVLink 1"])
def test_attitude_by_hand_is_read(make: Callable[..., bytes]) -> None:
    (reading,) = readings(MavlinkCodec(device()), make(30, ATTITUDE, ATTITUDE_PAYLOAD))
    assert (reading.message, reading.t_device_ns, reading.seq) == ("ATTITUDE", 123_456_000_000, None)
    assert reading.fields == ATTITUDE_FIELDS


def test_attitude_is_sent_as_by_hand() -> None:
    encoder = MavlinkEncoder(system_id=1, component_id=1)
    sent = [encoder.encode("ATTITUDE", ATTITUDE_FIELDS, 123_456 * 1_000_000) for _ in range(8)]
    assert sent[7] == packet(30, ATTITUDE, ATTITUDE_PAYLOAD, seq=7)


def test_gps_by_hand_is_read() -> None:
    payload = struct.pack("<QiiiHHHHBB", 5_000_000, 370862543, -763808217, 2500123, 120, 65535, 6125, 9000, 3, 11)
    (reading,) = readings(MavlinkCodec(device()), packet(24, GPS_RAW_INT, payload))
    assert reading.t_device_ns == 5 * SECOND
    f = reading.fields
    assert (f["lat"], f["lon"], f["alt"]) == (37.0862543, -76.3808217, 2500.123)
    assert (f["vel"], f["cog"], f["eph"], f["fix_type"], f["satellites_visible"]) == (61.25, 90.0, 1.2, 3.0, 11.0)
    assert math.isnan(f["epv"])
    assert (f["v_north"], f["v_east"]) == pytest.approx((0.0, 61.25), abs=1e-9)


def test_a_course_beyond_its_integer_is_none() -> None:
    """65534 is the most that it carries: an infinity, whose cosine raised out of the reading thread."""
    payload = struct.pack("<QiiiHHHHBB", 5_000_000, 370862543, -763808217, 2500123, 120, 65535, 6125, 65534, 3, 11)
    (reading,) = readings(MavlinkCodec(device()), packet(24, GPS_RAW_INT, payload))
    assert reading.fields["vel"] == 61.25
    assert math.isnan(reading.fields["v_north"])
    assert math.isnan(reading.fields["v_east"])


def test_gps_without_a_fix_knows_nothing() -> None:
    payload = struct.pack("<QiiiHHHHBB", 5_000_000, 0, 0, 0, 120, 120, 0, 0, 1, 2)
    (reading,) = readings(MavlinkCodec(device()), packet(24, GPS_RAW_INT, payload))
    known = {name for name, value in reading.fields.items() if not math.isnan(value)}
    assert known == {"fix_type", "satellites_visible"}


def test_a_named_value_is_a_message_of_its_own() -> None:
    data = packet(251, NAMED, struct.pack("<If10s", 1000, 512.5, b"pot_e"))
    (reading,) = readings(MavlinkCodec(device()), data)
    assert (reading.message, reading.fields, reading.t_device_ns) == (
        "NAMED_VALUE_FLOAT:pot_e",
        {"value": 512.5},
        SECOND,
    )


# Every message, both ways.


def example(message: str) -> dict[str, float]:
    """A different value in every field, small enough for any integer."""
    layout = TABLE[message.partition(":")[0]]
    return {
        name: round(0.5 * i + 1) + (0.25 if f.counts > 1 else 0.0) for i, (name, f) in enumerate(layout.fields.items())
    }


MESSAGES = [*TABLE, "NAMED_VALUE_FLOAT:pot_a", "SERVO_OUTPUT_RAW:1", "AIRSPEED:2", "HIGHRES_IMU:1"]


@pytest.mark.parametrize("message", MESSAGES)
def test_every_message_comes_back(message: str) -> None:
    fields = example(message)
    if message == "GPS_RAW_INT":
        fields["fix_type"] = 3.0
    if message == "ATTITUDE_QUATERNION":
        fields |= {"q1": 0.5, "q2": 0.5, "q3": -0.5, "q4": 0.5}
    (reading,) = readings(MavlinkCodec(device()), MavlinkEncoder().encode(message, fields, 77 * SECOND))
    assert reading.message == message
    assert {name: reading.fields[name] for name in fields} == fields
    assert set(reading.fields) == set(fields_known(message))
    timed = TABLE[message.partition(":")[0]].time is not None
    assert reading.t_device_ns == (77 * SECOND if timed else None)


def test_units_are_known_to_the_rig_where_a_signal_can_have_them() -> None:
    units = {f.unit for layout in TABLE.values() for f in layout.fields.values()}
    units |= {unit for derived in DERIVED.values() for unit in derived.values()}
    assert {unit for unit in units if unit_named(unit) is None} == {"gauss"}


def test_unknown_names_are_the_callers_mistake() -> None:
    encoder = MavlinkEncoder()
    with pytest.raises(KeyError):
        encoder.encode("ALTITUDE", {}, 0)
    with pytest.raises(KeyError, match="ATTITUDE has no field bank"):
        encoder.encode("ATTITUDE", {"bank": 1.0}, 0)
    assert fields_known("ALTITUDE") == fields_known("ATTITUDE:1") == ()


def test_integers_are_held_in_range_and_the_unknown_is_said() -> None:
    encoder, codec = MavlinkEncoder(), MavlinkCodec(device())
    data = encoder.encode("GLOBAL_POSITION_INT", {"vx": 1e6, "vy": -1e6, "vz": math.nan, "hdg": math.nan}, 0)
    (reading,) = readings(codec, data)
    assert [reading.fields[n] for n in ("vx", "vy")] == [math.inf, -math.inf], "beyond what 16 bits carry"
    assert all(math.isnan(reading.fields[n]) for n in ("vz", "hdg"))
    (most,) = readings(codec, encoder.encode("GLOBAL_POSITION_INT", {"vx": 327.66, "vy": -327.66, "lat": math.nan}, 0))
    assert [most.fields[n] for n in ("vx", "vy", "vz")] == [327.66, -327.66, 0.0]
    assert math.isnan(most.fields["lat"])
    (attitude,) = readings(codec, encoder.encode("ATTITUDE", {"roll": 0.25, "yaw": math.nan}, 0))
    assert attitude.fields["roll"] == 0.25
    assert math.isnan(attitude.fields["yaw"])


@SEEDED
@given(roll=st.floats(-3.1, 3.1), pitch=st.floats(-1.5, 1.5), yaw=st.floats(-3.1, 3.1), scale=st.floats(0.95, 1.05))
def test_quaternions_are_those_of_scipy(roll: float, pitch: float, yaw: float, scale: float) -> None:
    x, y, z, w = scale * Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat()
    data = MavlinkEncoder().encode("ATTITUDE_QUATERNION", {"q1": w, "q2": x, "q3": y, "q4": z}, 0)
    angles = MavlinkEncoder().encode("ATTITUDE_QUATERNION", {"roll": roll, "pitch": pitch, "yaw": yaw}, 0)
    for sent in (data, angles):
        (reading,) = readings(MavlinkCodec(device()), sent)
        got = [reading.fields[n] for n in ("roll", "pitch", "yaw")]
        np.testing.assert_allclose(got, [roll, pitch, yaw], atol=2e-5)


def test_no_attitude_comes_of_no_quaternion() -> None:
    (reading,) = readings(MavlinkCodec(device()), MavlinkEncoder().encode("ATTITUDE_QUATERNION", {"q1": 0.0}, 0))
    assert all(math.isnan(reading.fields[n]) for n in ("roll", "pitch", "yaw"))


# The stream of bytes.


def traffic() -> bytes:
    """Packets with a torn one, a flipped one, noise and a message of another dialect among them."""
    encoder = MavlinkEncoder()
    sent = [encoder.encode("ATTITUDE", {"pitch": 0.01 * k}, k * 20_000_000) for k in range(20)]
    flipped = bytearray(sent[3])
    flipped[15] ^= 0x10
    stranger = b"\xfd\x03\x00\x00\x00\x01\x99\x39\x30\x0aabc\x12\x34"
    return b"".join(
        [sent[1], sent[2][:17], bytes(flipped), sent[4], b"noise\xfe\xfd\xff\x01", sent[5], stranger, *sent[6:]]
    )


READABLE = [1, 4, 5, *range(6, 20)]


@pytest.mark.parametrize("size", [1, 2, 7, 40, 10_000])
def test_the_cut_of_the_stream_does_not_matter(size: int) -> None:
    codec, data = MavlinkCodec(device()), traffic()
    got = [r for i in range(0, len(data), size) for r in readings(codec, data[i : i + size])]
    assert [round((r.t_device_ns or 0) / 20_000_000) for r in got] == READABLE
    # The torn packet claims part of the flipped one behind it, which is not counted again; the noise is one resync.
    assert (codec.bad, codec.resyncs, codec.lost) == (1, 1, 2)


def test_noise_between_datagrams_neither_takes_nor_delays_a_packet() -> None:
    encoder, codec, rng = MavlinkEncoder(), MavlinkCodec(device()), np.random.default_rng(1)
    at_once = 0
    for k in range(1500):
        codec.feed(rng.bytes(40))
        got = readings(codec, encoder.encode("ATTITUDE", {"yawspeed": 1.0}, k * SECOND))
        at_once += [r.t_device_ns for r in got] == [k * SECOND]
    assert at_once == 1500
    assert codec.lost == 0


def test_joining_in_the_middle_is_one_resync_and_nothing_bad() -> None:
    encoder, codec = MavlinkEncoder(), MavlinkCodec(device())
    data = b"".join(encoder.encode("ATTITUDE", {"pitch": 0.1}, 0) for _ in range(3))
    assert len(readings(codec, data[9:])) == 2
    assert (codec.bad, codec.resyncs) == (0, 1)


def test_after_a_reset_half_a_packet_is_forgotten_and_numbers_start_anew() -> None:
    encoder, codec = MavlinkEncoder(), MavlinkCodec(device())
    data = [encoder.encode("ATTITUDE", {"yaw": 1.0}, 0) for _ in range(6)]
    assert len(readings(codec, data[0] + data[1][:20])) == 1
    codec.reset()
    assert len(readings(codec, data[5])) == 1
    assert (codec.bad, codec.resyncs, codec.lost) == (0, 0, 0)


def test_what_is_missing_from_the_link_is_counted() -> None:
    encoder, codec = MavlinkEncoder(), MavlinkCodec(device())
    packets = [encoder.encode("ATTITUDE", {}, 0) for _ in range(520)]
    missing = {5, 254, 255, 256, 500}
    readings(codec, b"".join(p for k, p in enumerate(packets) if k not in missing))
    assert codec.lost == len(missing)
    readings(codec, packets[519] + packets[518] + packets[519])
    readings(codec, MavlinkEncoder().encode("ATTITUDE", {}, 0) * 2)
    assert codec.lost == len(missing), "sent twice, overtaken, sent after a restart: none is lost"


@SEEDED
@given(blocks=st.lists(st.binary(max_size=400), max_size=6))
def test_any_bytes(blocks: list[bytes]) -> None:
    codec = MavlinkCodec(device(timesync=True, request_streams=True))
    for block in blocks:
        codec.feed(block)
        codec.outgoing(0)
    encoder = MavlinkEncoder()
    after = b"".join(encoder.encode("ATTITUDE", {}, k * SECOND) for k in range(20))
    times = [r.t_device_ns for r in readings(codec, after) if r.message == "ATTITUDE"]
    assert times[-10:] == [k * SECOND for k in range(10, 20)], "280 bytes is the longest packet"


DEFINITIONS = {30: ATTITUDE, 24: GPS_RAW_INT, 11020: AOA_SSA, 0: HEARTBEAT}


@SEEDED
@given(data=st.data())
def test_any_payload_in_a_sound_packet(data: st.DataObject) -> None:
    codec = MavlinkCodec(device(timesync=True))
    number = data.draw(st.sampled_from(sorted(DEFINITIONS)))
    payload = data.draw(st.binary(min_size=1, max_size=255))
    for reading in readings(codec, packet(number, DEFINITIONS[number], payload)):
        assert all(isinstance(value, float) for value in reading.fields.values())
    assert (codec.bad, codec.resyncs) == (0, 0)


@SEEDED
@given(st.binary(max_size=300))
def test_any_bytes_to_the_emulated_autopilot(data: bytes) -> None:
    MavlinkEncoder().answer(data, 0)


# Whose messages.
