"""Every wire format against bytes worked out by hand or published, however the bytes are cut and whatever is around.

Oracles: CRC check values of the CRC catalogue and binascii's CRC, Cheshire and Baker's COBS rule by hand, u-blox's
layout packed with struct, sentences printed in every NMEA primer, cantools and python-can.
"""

from __future__ import annotations

import binascii
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass

import pytest
from fastcrc import crc8, crc16
from hypothesis import given
from hypothesis import strategies as st

from drivers.can_frames import read_slcan
from drivers.codec import Codec, Reading
from drivers.framing import open_line
from drivers.serial_boombox import BoomboxAsciiCodec, BoomboxCodec
from drivers.serial_gnss import DAY_NS, NmeaCodec, UbxCodec
from drivers.serial_vectornav import VectorNavCodec
from tests.drivers.wire_bytes import (
    GGA,
    GYRO,
    GYRO_FIELDS,
    KT,
    NOON_ISH,
    PACKET,
    PACKET_READING,
    PVT,
    PVT_READING,
    RMC,
    VTG,
    can_codec,
    nav_pvt,
    ubx,
)


@dataclass(frozen=True)
class Case:
    name: str
    codec: Callable[[], Codec]
    wire: bytes
    reading: Reading


CASES = (
    Case("boombox", BoomboxCodec, PACKET, PACKET_READING),
    Case("boombox_ascii", BoomboxAsciiCodec, b"$BOOM,1,2,256,-1,300*3E\r\n", PACKET_READING),
    Case("ubx", UbxCodec, PVT, PVT_READING),
    Case(
        "rmc",
        NmeaCodec,
        RMC,
        Reading(
            "RMC",
            NOON_ISH,
            None,
            {
                "lat": 48 + 7.038 / 60,
                "lon": 11 + 31 / 60,
                "spd": 22.4,
                "cog": 84.4,
                "v_north": 22.4 * KT * math.cos(math.radians(84.4)),
                "v_east": 22.4 * KT * math.sin(math.radians(84.4)),
            },
            DAY_NS,
        ),
    ),
    Case(
        "gga",
        NmeaCodec,
        GGA,
        Reading("GGA", NOON_ISH, None, {"lat": 48 + 7.038 / 60, "lon": 11 + 31 / 60, "alt": 545.4}, DAY_NS),
    ),
    Case(
        "vtg",
        NmeaCodec,
        VTG,
        Reading(
            "VTG",
            None,
            None,
            {
                "cogt": 54.7,
                "sogn": 5.5,
                "v_north": 5.5 * KT * math.cos(math.radians(54.7)),
                "v_east": 5.5 * KT * math.sin(math.radians(54.7)),
            },
        ),
    ),
    # VN-100 user manual (UM001 v2.22), 4.3.7, example case 1: yaw, pitch and roll of the Common group.
    Case(
        "vectornav",
        VectorNavCodec,
        bytes.fromhex("fa 01 0800 93502e42 833ef13f 48b504bb 9288"),
        Reading(
            "Common",
            None,
            None,
            {"YawPitchRoll.yaw": 43.578686, "YawPitchRoll.pitch": 1.8847202, "YawPitchRoll.roll": -2.0249654e-3},
        ),
    ),
    Case("can", can_codec, GYRO, Reading("GYRO", 246_800_000, 5, GYRO_FIELDS, 1_638_400_000, 16)),
)
every_case = pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)


def same(found: object, expected: Reading) -> bool:
    assert isinstance(found, Reading)
    assert found.fields == pytest.approx(expected.fields, rel=1e-7, abs=1e-9)  # the manual prints eight figures
    rest = ("message", "t_device_ns", "seq", "wrap_ns", "seq_wrap")
    return [getattr(found, name) for name in rest] == [getattr(expected, name) for name in rest]


@every_case
def test_a_whole_message_is_read(case: Case) -> None:
    codec = case.codec()
    (found,) = codec.feed(case.wire)
    assert same(found, case.reading)
    assert (codec.bad, codec.resyncs) == (0, 0)


@every_case
def test_a_message_may_come_byte_by_byte(case: Case) -> None:
    codec = case.codec()
    found = [reading for byte in case.wire * 3 for reading in codec.feed(bytes((byte,)))]
    assert len(found) == 3
    assert all(same(reading, case.reading) for reading in found)
    assert (codec.bad, codec.resyncs) == (0, 0)


@every_case
@pytest.mark.parametrize(
    "garbage", [b"\xff" * 3, b"\x00\x01\r\n$\xb5bq*\xfa", bytes(range(256)) * 8], ids=["short", "trap", "long"]
)
def test_garbage_costs_no_more_than_the_message_it_touches_and_is_counted(case: Case, garbage: bytes) -> None:
    codec = case.codec()
    found = codec.feed(garbage + case.wire + case.wire + garbage + case.wire + case.wire)
    assert 2 <= len(found) <= 4
    assert all(same(reading, case.reading) for reading in found)
    assert codec.bad + codec.resyncs >= 2


@every_case
def test_any_flipped_bit_is_caught(case: Case) -> None:
    """CRCs and checksums catch any single bit; what is left may only be counted, ignored or wait for its end."""
    for i in range(8 * len(case.wire)):
        hit = bytearray(case.wire)
        hit[i // 8] ^= 1 << i % 8
        codec = case.codec()
        found = [r for r in codec.feed(bytes(hit) + case.wire) if not same_or_false(r, case.reading)]
        assert not found, f"bit {i}"


def same_or_false(found: object, expected: Reading) -> bool:
    try:
        return same(found, expected)
    except AssertionError:
        return False


@every_case
def test_half_a_message_is_forgotten_on_reset(case: Case) -> None:
    codec = case.codec()
    codec.feed(case.wire[: len(case.wire) // 2])
    codec.reset()
    assert len(codec.feed(case.wire)) == 1
    assert (codec.bad, codec.resyncs) == (0, 0)


@every_case
@given(
    st.lists(
        st.one_of(
            st.binary(max_size=80),
            st.sampled_from((b"\xb5\x62", b"$GPRMC,", b"t100", b"\xfa\x01\x08\0", b"\r\n", b"\0")),
        )
    )
)
def test_any_bytes_are_counted_never_raised_and_may_be_cut_anywhere(case: Case, pieces: list[bytes]) -> None:
    whole, cut, single = case.codec(), case.codec(), case.codec()
    stream = b"".join(pieces)
    readings = whole.feed(stream)
    assert repr([r for piece in pieces for r in cut.feed(piece)]) == repr(readings)
    assert repr([r for byte in stream for r in single.feed(bytes((byte,)))]) == repr(readings)
    assert (cut.bad, cut.resyncs) == (single.bad, single.resyncs) == (whole.bad, whole.resyncs)


@every_case
@given(noise=st.binary(min_size=1100, max_size=1400))
def test_noise_that_gives_nothing_is_counted(case: Case, noise: bytes) -> None:
    codec = case.codec()
    if not codec.feed(noise.replace(b"\0", b"\1").replace(b"\r", b"\1")):
        assert codec.bad + codec.resyncs > 0


def test_check_values_of_the_crc_catalogue() -> None:
    assert crc16.ibm_3740(b"123456789") == 0x29B1 == binascii.crc_hqx(b"123456789", 0xFFFF)
    assert crc8.sae_j1850(b"123456789") == 0x4B


# --- what is passed over, what is refused ---


def test_a_receiver_without_a_fix_gives_no_numbers() -> None:
    (searching,) = UbxCodec().feed(nav_pvt(0, 0, flags=0))
    (timed,) = UbxCodec().feed(nav_pvt(0, 0, fix=0))
    (void,) = NmeaCodec().feed(b"$GPRMC,123519,V,,,,,,,230394,,*33\r\n")
    (cold,) = NmeaCodec().feed(b"$GPGGA,,,,,,0,,,,,,,,*66\r\n")
    for reading in (searching, timed, void, cold):
        assert isinstance(reading, Reading)
        assert reading.fields == {}
    assert isinstance(cold, Reading)
    assert cold.t_device_ns is None


def test_a_standing_receiver_needs_no_track() -> None:
    (found,) = NmeaCodec().feed(b"$GPRMC,123519,A,4807.038,N,01131.000,E,0.0,,230394,,*33\r\n")
    assert isinstance(found, Reading)
    assert (found.fields["v_north"], found.fields["v_east"]) == (0.0, 0.0)


def test_other_messages_on_the_line_are_no_errors() -> None:
    codec = UbxCodec()
    assert len(codec.feed(GGA + PVT + ubx(b"\x01\x35", bytes(200)) + RMC + PVT)) == 2
    assert (codec.bad, codec.resyncs) == (0, 0)
    text = BoomboxAsciiCodec()
    assert text.feed(GGA) == []
    assert text.bad == 0
    nmea = NmeaCodec()
    assert nmea.feed(b"$GPGSV,1,1,00*79\r\n") == []
    assert nmea.bad == 0
    can = can_codec()
    assert can.feed(b"\r\rZ\rt7FF10A\rr1008\rT1ABCDE012AABB\r") == []
    assert can.bad == 0


def test_a_damaged_length_does_not_swallow_the_frame_behind_it() -> None:
    codec = UbxCodec()
    hit = bytearray(ubx(b"\x01\x35", bytes(20)))
    hit[4] = 120
    assert len(codec.feed(bytes(hit) + PVT + PVT)) == 2
    assert codec.bad == 1


@pytest.mark.parametrize(
    "line",
    [
        b"t100",
        b"t1008AABB",
        b"t1009" + b"00" * 9,
        b"tG000",
        b"t8000",
        b"T200000000",
        b"q1230",
        b"t10 0",
        b"\x07",
        b"\xff\xfe",
    ],
)
def test_a_corrupt_slcan_line_is_refused(line: bytes) -> None:
    assert read_slcan(line) is None
    codec = can_codec()
    assert len(codec.feed(line + b"\r" + GYRO)) == 1
    assert codec.bad == 1


def test_an_slcan_line_may_carry_the_adapters_time_stamp() -> None:
    assert read_slcan(b"t1232AABB1F40") == (0x123, False, b"\xaa\xbb")
    assert read_slcan(b"T000001232AABB") == (0x123, True, b"\xaa\xbb")


@pytest.mark.parametrize(
    "body",
    [
        "BOOM",
        "BOOM,1",
        "BOOM,1,2",
        "BOOM,256,0,0",
        "BOOM,1,256,0",
        "BOOM,1,0,4294967296",
        "BOOM,x,0,0",
        "BOOM,1,0,0,zz",
    ],
)
def test_a_sealed_line_with_nonsense_inside_is_refused(body: str) -> None:
    checksum = 0
    for byte in body.encode():
        checksum ^= byte
    codec = BoomboxAsciiCodec()
    assert codec.feed(f"${body}*{checksum:02X}\r\n".encode()) == []
    assert codec.bad == 1


def test_a_packet_with_a_sound_crc_and_half_a_value_is_refused() -> None:
    body = b"\x01\x02\x01\x01\x01\x01\x05"
    piece = body + struct.pack("<H", binascii.crc_hqx(body, 0xFFFF))
    codec = BoomboxCodec()
    assert codec.feed(bytes((len(piece) + 1,)) + piece + b"\0") == []
    assert codec.bad == 1


def test_the_checksum_of_a_line_may_be_in_small_letters() -> None:
    assert open_line(RMC.replace(b"6A", b"6a").rstrip(b"\n")) is not None
    assert open_line(RMC.replace(b"6A", b"6B").rstrip(b"\n")) is None
