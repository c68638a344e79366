"""The times that MAVLink carries, and what the station asks for."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.codec import TimeReply
from drivers.mavlink import STATION_SYSTEM, MavlinkCodec, MavlinkEncoder
from tests.drivers.mavlink_by_hand import AOA_SSA, SECOND, SEEDED, device, packet, packets, readings


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
