"""The MAVLink codec and encoder, against frames built here by hand from the standard's text."""

from __future__ import annotations

import hashlib
import math
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drivers.adapter import what_is_sent
from drivers.codec import Reading, TimeReply
from drivers.mavlink import MOST_FOREIGN, STATION_SYSTEM, MavlinkCodec, MavlinkEncoder, read_signing_key
from drivers.mavlink_messages import DERIVED, TABLE, fields_known
from station.conventions import unit_named
from station.profile import MavlinkDevice
from station.rows import ProfileError

SECOND = 1_000_000_000
SEEDED = settings(deadline=None, derandomize=True)


def device(**options: Any) -> MavlinkDevice:
    def stream(name: str, message: str, rate: str, **signals: str) -> dict[str, Any]:
        channels = {signal: dict(zip(("field", "unit"), text.split(), strict=True)) for signal, text in signals.items()}
        return {"name": name, "message": message, "rate": rate, "signals": channels}

    return MavlinkDevice.model_validate(
        {
            "link": "mavlink",
            "name": "autopilot",
            "url": "emulated",
            "system_id": 1,
            "streams": [
                stream("attitude", "ATTITUDE", "50 Hz", theta="pitch rad"),
                stream("velocity", "LOCAL_POSITION_NED", "25 Hz", v_down="vz m/s"),
            ],
            **options,
        }
    )


def readings(codec: MavlinkCodec, data: bytes) -> list[Reading]:
    return [r for r in codec.feed(data) if isinstance(r, Reading)]


# The standard, by hand (mavlink.io, "Packet Serialization").


def x25(data: bytes) -> int:
    """CRC-16/MCRF4XX, bit by bit: polynomial 0x1021 reflected, initial value 0xFFFF."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0x8408 if crc & 1 else 0)
    return crc


def crc_extra(definition: str) -> int:
    """Of "NAME type field type field [length] ...", fields in the order of the wire; a length counts as one byte."""
    words = re.split(r"\[(\d+)\] ", definition + " ")
    crc = x25(b"".join(bytes([int(w)]) if i % 2 else w.encode() for i, w in enumerate(words)))
    return (crc & 0xFF) ^ (crc >> 8)


def packet(number: int, definition: str, payload: bytes, seq: int = 0, sender: tuple[int, int] = (1, 1)) -> bytes:
    payload = payload.rstrip(b"\0") or b"\0"
    head = bytes([len(payload), 0, 0, seq, *sender]) + number.to_bytes(3, "little")
    crc = x25(head + payload + bytes([crc_extra(definition)]))
    return b"\xfd" + head + payload + struct.pack("<H", crc)


def packet_1(number: int, definition: str, payload: bytes, seq: int = 0) -> bytes:
    head = bytes([len(payload), seq, 1, 1, number])
    crc = x25(head + payload + bytes([crc_extra(definition)]))
    return b"\xfe" + head + payload + struct.pack("<H", crc)


ATTITUDE = (
    "ATTITUDE uint32_t time_boot_ms float roll float pitch float yaw float rollspeed float pitchspeed float yawspeed"
)
ATTITUDE_PAYLOAD = struct.pack("<I6f", 123_456, 0.5, -0.25, 3.0, 0.125, -0.0625, 0.0)
ATTITUDE_FIELDS = {
    "roll": 0.5,
    "pitch": -0.25,
    "yaw": 3.0,
    "rollspeed": 0.125,
    "pitchspeed": -0.0625,
    "yawspeed": 0.0,
}
ATTITUDE_BYTES = bytes.fromhex(
    "fd 18 00 00 07 01 01 1e 00 00 40 e2 01 00 00 00 00 3f 00 00 80 be 00 00 40 40 00 00 00 3e 00 00 80 bd"
)
"""The ATTITUDE packet number 7 up to its checksum, written out: 24 bytes, as the four zeros at the end are left out."""

HEARTBEAT = (
    "HEARTBEAT uint32_t custom_mode uint8_t type uint8_t autopilot uint8_t base_mode uint8_t system_status "
    "uint8_t mavlink_version"
)
GPS_RAW_INT = (
    "GPS_RAW_INT uint64_t time_usec int32_t lat int32_t lon int32_t alt uint16_t eph uint16_t epv uint16_t vel "
    "uint16_t cog uint8_t fix_type uint8_t satellites_visible"
)
AOA_SSA = "AOA_SSA uint64_t time_usec float AOA float SSA"
NAMED = "NAMED_VALUE_FLOAT uint32_t time_boot_ms float value char name [10]"


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


def test_other_vehicles_are_passed_over() -> None:
    codec = MavlinkCodec(device(system_id=None))
    ours, other = MavlinkEncoder(system_id=7), MavlinkEncoder(system_id=8)
    station = MavlinkEncoder(system_id=255).encode("HEARTBEAT", {"type": 6.0, "autopilot": 8.0}, 0)
    data = station + ours.heartbeat() + other.encode("ATTITUDE", {}, 0) + ours.encode("ATTITUDE", {}, SECOND)
    assert [(r.message, r.t_device_ns) for r in readings(codec, data)] == [("HEARTBEAT", None), ("ATTITUDE", SECOND)]


def test_the_rig_names_the_vehicle() -> None:
    codec = MavlinkCodec(device(system_id=8))
    data = MavlinkEncoder(system_id=7).encode("ATTITUDE", {}, 0) + MavlinkEncoder(system_id=8).encode("ATTITUDE", {}, 9)
    assert len(readings(codec, data)) == 1


def told(codec: MavlinkCodec, data: bytes) -> list[float]:
    return [r.fields["pitch"] for r in readings(codec, data) if r.message == "ATTITUDE"]


@pytest.mark.parametrize("named", [1, None], ids=["the rig names the system", "the first autopilot"])
def test_another_component_of_the_vehicle_is_not_mixed_into_its_signals(named: int | None) -> None:
    codec = MavlinkCodec(device(system_id=named))
    ours, other = MavlinkEncoder(), MavlinkEncoder(component_id=191)
    data = other.heartbeat() + ours.heartbeat()
    for _ in range(50):
        data += ours.encode("ATTITUDE", {"pitch": 0.1}, 0) + other.encode("ATTITUDE", {"pitch": -0.4}, 0)
    assert told(codec, data) == [pytest.approx(0.1)] * 50
    assert codec.foreign == {"system 1, component 191": 51}
    assert codec.speaker == "system 1, component 1"


def test_the_rig_names_the_component() -> None:
    codec = MavlinkCodec(device(component_id=191))
    ours, other = MavlinkEncoder(), MavlinkEncoder(component_id=191)
    sent = ours.encode("ATTITUDE", {"pitch": 0.1}, 0) + other.encode("ATTITUDE", {"pitch": -0.4}, 0)
    assert told(codec, sent) == [pytest.approx(-0.4)]


def test_who_speaks_first_does_not_own_the_link() -> None:
    codec = MavlinkCodec(device(system_id=None))
    first, ours = MavlinkEncoder(system_id=9), MavlinkEncoder(system_id=7)
    assert told(codec, first.encode("ATTITUDE", {}, 0) * 3) == [], "no heartbeat"
    codec.feed(ours.heartbeat())
    sent = first.encode("ATTITUDE", {"pitch": -0.4}, 0) + ours.encode("ATTITUDE", {"pitch": 0.1}, 0)
    assert told(codec, sent) == [pytest.approx(0.1)]
    assert codec.foreign == {"system 9, component 1": 1}


def test_a_vehicle_that_is_not_named_and_has_gone_is_given_up() -> None:
    codec = MavlinkCodec(device(system_id=None, timesync=True))
    first, next_one = MavlinkEncoder(system_id=9), MavlinkEncoder(system_id=7)
    codec.feed(first.heartbeat())
    assert codec.outgoing(SECOND)
    codec.feed(next_one.heartbeat())
    assert codec.speaker == "system 9, component 1"
    assert codec.outgoing(5 * SECOND)
    assert codec.outgoing(7 * SECOND) == b"", "nobody is asked"
    codec.feed(next_one.heartbeat())
    assert codec.speaker == "system 7, component 1"


def test_more_others_than_can_be_told_apart_are_counted_together() -> None:
    codec = MavlinkCodec(device())
    for k in range(2, 250):
        codec.feed(MavlinkEncoder(system_id=k).heartbeat())
    assert len(codec.foreign) == MOST_FOREIGN + 1
    assert sum(codec.foreign.values()) == 248


def test_who_is_called_is_asked_the_time_before_it_speaks() -> None:
    codec = MavlinkCodec(device(timesync=True, request_streams=True, url="udpout:10.0.0.1:14550"))
    assert [p[7] for p in packets(codec.outgoing(0))] == [111], "the time, and nothing else"


# Time.


def test_times_of_one_device_are_on_one_timeline() -> None:
    """ArduPilot cuts the times of AOA_SSA and SERVO_OUTPUT_RAW to 32 bits of microseconds (71.6 min)."""
    codec, encoder = MavlinkCodec(device()), MavlinkEncoder()
    now_ns = 10_000 * SECOND
    short = struct.pack("<Qff", now_ns // 1000 % 2**32, 1.0, 2.0)
    data = [
        encoder.encode("ATTITUDE", {}, now_ns),
        packet(11020, AOA_SSA, short),
        encoder.encode("SERVO_OUTPUT_RAW", {}, now_ns),
        encoder.encode("AOA_SSA", {}, now_ns),
        encoder.encode("HIGHRES_IMU", {}, now_ns),
    ]
    got = readings(codec, b"".join(data))
    assert [r.t_device_ns for r in got] == [now_ns] * 5
    assert len({r.wrap_ns for r in got}) == 1


def test_a_short_time_alone_is_handed_on_with_its_period() -> None:
    (reading,) = readings(MavlinkCodec(device()), MavlinkEncoder().encode("SERVO_OUTPUT_RAW", {}, 5000 * SECOND))
    assert (reading.t_device_ns, reading.wrap_ns) == (5000 * SECOND % (2**32 * 1000), 2**32 * 1000)


def test_milliseconds_wrap_after_seven_weeks() -> None:
    at = 2**32 * 1_000_000 + 5 * SECOND
    (reading,) = readings(MavlinkCodec(device()), MavlinkEncoder().encode("ATTITUDE", {}, at))
    assert (reading.t_device_ns, reading.wrap_ns) == (5 * SECOND, 2**32 * 1_000_000)


def test_a_time_since_1970_is_not_the_boot_clock() -> None:
    payload = struct.pack("<Qff", 1_700_000_000_000_000, 1.0, 2.0)
    (reading,) = readings(MavlinkCodec(device()), packet(11020, AOA_SSA, payload))
    assert reading.t_device_ns is None
    assert reading.fields == {"AOA": 1.0, "SSA": 2.0}


# What the station sends.


@SEEDED
@given(st.lists(st.binary(max_size=100), max_size=5))
def test_nothing_is_sent_unless_the_rig_allows_it(blocks: list[bytes]) -> None:
    codec = MavlinkCodec(device())
    codec.feed(MavlinkEncoder().heartbeat())
    for k, block in enumerate(blocks):
        codec.feed(block)
        assert codec.outgoing(k * SECOND) == b""


def timesync(tc1: int, ts1: int) -> bytes:
    return packet(111, "TIMESYNC int64_t tc1 int64_t ts1", struct.pack("<qq", tc1, ts1))


def test_time_is_asked_four_times_a_second_and_the_answer_read() -> None:
    codec = MavlinkCodec(device(timesync=True))
    codec.feed(MavlinkEncoder().heartbeat())
    asked_ns = [t for t in range(SECOND, 3 * SECOND, 40_000_000) if codec.outgoing(t)]
    assert len(asked_ns) == pytest.approx(8, abs=1)
    assert codec.feed(timesync(55 * SECOND, asked_ns[-1])) == [TimeReply(asked_ns[-1], 55 * SECOND)]
    assert codec.feed(timesync(55 * SECOND, asked_ns[-1])) == [], "once answered"
    assert codec.feed(timesync(55 * SECOND, asked_ns[-1] + 1)) == [], "an answer to someone else"


def test_the_request_is_as_the_standard_has_it() -> None:
    codec = MavlinkCodec(device(timesync=True))
    assert codec.outgoing(123_456_789) == b"", "to nobody before the vehicle is heard"
    codec.feed(MavlinkEncoder().heartbeat())
    request = codec.outgoing(123_456_789)
    assert request[5] == STATION_SYSTEM
    definition = "TIMESYNC int64_t tc1 int64_t ts1"
    assert request == packet(111, definition, struct.pack("<qq", 0, 123_456_789), sender=(request[5], request[6]))


def test_the_emulated_autopilot_answers_with_its_clock() -> None:
    codec = MavlinkCodec(device(timesync=True))
    autopilot = MavlinkEncoder()
    codec.feed(autopilot.heartbeat())
    assert codec.feed(autopilot.answer(codec.outgoing(9 * SECOND), 4 * SECOND)) == [TimeReply(9 * SECOND, 4 * SECOND)]


def test_a_vehicle_that_asks_the_time_is_told_if_the_rig_allows_it() -> None:
    question = timesync(0, 777)
    for allowed in (True, False):
        codec = MavlinkCodec(device(timesync=allowed))
        codec.feed(MavlinkEncoder().heartbeat())
        codec.outgoing(SECOND)
        codec.feed(question)
        expected = timesync(SECOND + 5, 777)[10:-2] if allowed else b""
        assert codec.outgoing(SECOND + 5)[10:-2] == expected


def test_streams_are_asked_for_once_heard_and_again_while_missing() -> None:
    codec, autopilot = MavlinkCodec(device(request_streams=True)), MavlinkEncoder()
    assert codec.outgoing(0) == b""
    codec.feed(autopilot.heartbeat())
    # COMMAND_LONG on the wire: param1..7 float, command uint16, target system, target component
    requests = packets(codec.outgoing(SECOND))
    assert [struct.unpack_from("<7fHBB", p[10:-2].ljust(33, b"\0")) for p in requests] == [
        (30.0, 20_000.0, 0.0, 0.0, 0.0, 0.0, 0.0, 511, 1, 1),
        (32.0, 40_000.0, 0.0, 0.0, 0.0, 0.0, 0.0, 511, 1, 1),
    ]
    assert codec.outgoing(2 * SECOND) == b""
    codec.feed(autopilot.encode("ATTITUDE", {}, 0))
    assert len(packets(codec.outgoing(6 * SECOND))) == 1


def packets(data: bytes) -> list[bytes]:
    out = []
    while data:
        size = 12 + data[1]
        out.append(data[:size])
        data = data[size:]
    return out


# Signatures.

KEY = bytes(range(32))
NOW_NS = 1_763_700_000_000_000_000
NOW = (NOW_NS - 1_420_070_400_000_000_000) // 10_000


def signed(stamp: int, key: bytes = KEY, seq: int = 0, link: int = 0) -> bytes:
    """ATTITUDE with the signature of the standard: the first 48 bits of SHA-256(key, packet, link, time)."""
    payload = ATTITUDE_PAYLOAD.rstrip(b"\0")
    head = bytes([len(payload), 1, 0, seq, 1, 1, 30, 0, 0])
    crc = x25(head + payload + bytes([39]))
    frame = b"\xfd" + head + payload + struct.pack("<H", crc) + bytes([link]) + stamp.to_bytes(6, "little")
    return frame + hashlib.sha256(key + frame).digest()[:6]


def test_a_signature_by_hand_is_accepted() -> None:
    codec = MavlinkCodec(device(), KEY, NOW_NS)
    assert len(readings(codec, signed(NOW))) == 1
    assert (codec.bad, codec.refused) == (0, 0)


def test_the_encoder_signs_as_by_hand() -> None:
    assert MavlinkEncoder(key=KEY, utc_ns=NOW_NS).encode("ATTITUDE", ATTITUDE_FIELDS, 123_456_000_000) == signed(NOW)


@pytest.mark.parametrize(
    "data",
    [
        packet(30, ATTITUDE, ATTITUDE_PAYLOAD),
        packet_1(30, ATTITUDE, ATTITUDE_PAYLOAD),
        signed(NOW, key=bytes(32)),
        signed(NOW)[:-1] + b"\0",
        signed(NOW - 6_100_000),
    ],
    ids=["unsigned", "MAVLink 1", "another key", "wrong signature", "more than a minute old"],
)
def test_packets_without_a_good_signature_are_refused_and_counted(data: bytes) -> None:
    codec = MavlinkCodec(device(), KEY, NOW_NS)
    assert codec.feed(data) == []
    assert (codec.bad, codec.refused) == (1, 1)
    assert len(readings(codec, signed(NOW + 1))) == 1


def test_a_packet_played_back_is_refused() -> None:
    codec = MavlinkCodec(device(), KEY, NOW_NS)
    readings(codec, signed(NOW) + signed(NOW + 5))
    assert codec.feed(signed(NOW + 5) + signed(NOW + 4)) == []
    assert codec.refused == 2
    codec.reset()
    assert codec.feed(signed(NOW + 5)) == [], "a lost link opens no door"


def test_a_forged_time_does_not_lock_out_the_vehicle() -> None:
    codec = MavlinkCodec(device(), KEY, NOW_NS)
    readings(codec, signed(NOW))
    assert codec.feed(signed(2**48 - 1, key=bytes(32))) == []
    assert len(readings(codec, signed(NOW + 1))) == 1


def test_without_a_key_signed_packets_are_read_too() -> None:
    assert len(readings(MavlinkCodec(device()), signed(0))) == 1


def test_a_signed_link_works_both_ways() -> None:
    codec = MavlinkCodec(device(timesync=True), KEY, NOW_NS)
    autopilot = MavlinkEncoder(key=KEY, utc_ns=NOW_NS)
    codec.feed(autopilot.heartbeat())
    assert codec.feed(autopilot.answer(codec.outgoing(9), 8)) == [TimeReply(9, 8)]
    stranger = MavlinkCodec(device(timesync=True))
    stranger.feed(autopilot.heartbeat())
    assert stranger.outgoing(10)
    assert autopilot.answer(stranger.outgoing(10), 8) == b""


def heartbeat(stamp: int, key: bytes = KEY, sender: tuple[int, int] = (1, 1), kind: int = 1) -> bytes:
    """Signed by hand; of an ArduPilot plane unless another `kind` (6: a ground station)."""
    payload = struct.pack("<IBBBBB", 0, kind, 3, 0, 4, 3)
    head = bytes([len(payload), 1, 0, 0, *sender, 0, 0, 0])
    frame = b"\xfd" + head + payload + struct.pack("<H", x25(head + payload + bytes([50])))
    frame += b"\0" + stamp.to_bytes(6, "little")
    return frame + hashlib.sha256(key + frame).digest()[:6]


@pytest.mark.parametrize(
    ("datagram", "refused"),
    [
        (heartbeat(NOW, key=bytes(32)), 1),
        (packet(0, HEARTBEAT, struct.pack("<IBBBBB", 0, 1, 3, 0, 4, 3)), 1),
        (heartbeat(NOW - 7_000_000), 1),
        (signed(NOW), 0),
        (heartbeat(NOW, sender=(2, 1)), 0),
        (heartbeat(NOW, sender=(1, 191)), 0),
        (heartbeat(NOW, kind=6), 0),
        (b"", 0),
    ],
    ids=["another key", "unsigned", "old", "no heartbeat", "system", "component", "ground station", "empty"],
)
def test_the_codec_vouches_for_the_signed_heartbeat_of_the_vehicle_alone(datagram: bytes, refused: int) -> None:
    codec = MavlinkCodec(device(), KEY, NOW_NS)
    assert not codec.vouches_for(datagram)
    assert (codec.bad, codec.refused) == (refused, refused)
    assert codec.vouches_for(heartbeat(NOW))
    assert codec.vouches_for(heartbeat(NOW)), "to vouch takes no note"
    codec.feed(heartbeat(NOW))
    assert not codec.vouches_for(heartbeat(NOW)), "played back"
    assert codec.vouches_for(heartbeat(NOW + 1))


@pytest.mark.parametrize("after_s", [0, 1, 3600])
def test_what_is_sent_is_signed_with_the_time_of_sending(after_s: int) -> None:
    """A vehicle that was switched on an hour into the flight takes nothing that is a minute old."""
    station_ns = 77 * SECOND
    codec = MavlinkCodec(device(timesync=True), KEY, NOW_NS, station_ns)
    codec.feed(heartbeat(NOW))
    stamps = []
    for k in range(3):
        (request,) = packets_signed(codec.outgoing(station_ns + after_s * SECOND + k * SECOND // 4))
        stamps.append(int.from_bytes(request[-12:-6], "little"))
    assert stamps == [NOW + after_s * 100_000 + k * 25_000 for k in range(3)]


def packets_signed(data: bytes) -> list[bytes]:
    return [data[at : at + 25 + data[1]] for at in range(0, len(data), 25 + data[1])]


@pytest.mark.parametrize(
    ("text", "says"),
    [(None, "No such file"), ("00 11", "64 hexadecimal digits"), ("zz" * 32, "64 hexadecimal digits")],
)
def test_a_bad_key_file_is_named(tmp_path: Path, text: str | None, says: str) -> None:
    if text is not None:
        (tmp_path / "link.key").write_text(text)
    with pytest.raises(ProfileError, match=says) as error:
        read_signing_key(device(signing_key_file="link.key"), tmp_path)
    assert str(tmp_path / "link.key") in str(error.value)


def test_the_key_file(tmp_path: Path) -> None:
    (tmp_path / "link.key").write_text(KEY.hex() + "\n")
    assert read_signing_key(device(signing_key_file="link.key"), tmp_path) == KEY
    assert read_signing_key(device(), tmp_path) is None


@pytest.mark.parametrize(
    ("url", "key", "is_told"),
    [
        ("udpin:0.0.0.0:14550", None, True),
        ("udpin:192.168.1.20:14550", None, True),
        ("tcp:autopilot.local:5760", None, True),
        ("udpin:0.0.0.0:14550", "key.hex", False),
        ("udpin:127.0.0.1:14550", None, False),
        ("udpin:[::1]:14550", None, False),
        ("serial:/dev/ttyACM0:57600", None, False),
        ("emulated", None, False),
    ],
)
def test_that_anybody_may_be_the_vehicle_is_told_where_others_reach_an_unsigned_link(
    url: str, key: str | None, is_told: bool
) -> None:
    link = device().model_copy(update={"url": url, "signing_key_file": key})
    codec = MavlinkCodec(link)
    codec.feed(MavlinkEncoder().heartbeat())
    assert codec.speaker.startswith("system 1, component 1")
    for told in (codec.speaker, what_is_sent(link)):
        assert ("signing_key_file in the rig" in told) == is_told
