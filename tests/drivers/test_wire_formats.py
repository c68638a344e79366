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
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest
from fastcrc import crc8, crc16
from hypothesis import given
from hypothesis import strategies as st
from pynmeagps import NMEAReader
from pyubx2 import UBXReader

from drivers.can_dbc import CanCodec, encode_frame, load_dbc
from drivers.can_frames import encode_slcan, read_slcan
from drivers.codec import Codec, Reading
from drivers.framing import open_line
from drivers.serial_boombox import FIELDS, BoomboxAsciiCodec, BoomboxCodec, encode_line, encode_packet
from drivers.serial_gnss import DAY_NS, WEEK_NS, NmeaCodec, UbxCodec, encode_nav_pvt, encode_sentence
from drivers.serial_vectornav import VectorNavCodec
from station.profile import CanDevice, load_rig, profiles_dir

RIGS = profiles_dir() / "rigs"
DBC = RIGS / "bench.dbc"

# 01 02 00 | 01 00 | 00 | ff ff 2c 01 and the CRC 0x2710, each group headed by its length plus one.
PACKET = bytes.fromhex("03 01 02  02 01  01  07 ff ff 2c 01 10 27  00")
PACKET_READING = Reading(1, 256_000, 2, {"v0": -1.0, "v1": 300.0}, 2**32 * 1000, 256)

# p = 40, q = -80, r = 1, stamp = 1234, counter = 5 at bits 0, 13, 26, 39, 52; CRC-8 of those bytes and 0x00 is 0x5f.
GYRO = b"t10082800F6070069525F\r"
GYRO_FIELDS = {"p": 1.0, "q": -2.0, "r": 0.025, "stamp": 1234 * 0.0002, "counter": 5.0, "checksum": 95.0}

RMC = b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A\r\n"
GGA = b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n"
VTG = b"$GPVTG,054.7,T,034.4,M,005.5,N,010.2,K*48\r\n"
NOON_ISH = ((12 * 60 + 35) * 60 + 19) * 10**9
KT = 1852 / 3600


def ubx(kind: bytes, payload: bytes) -> bytes:
    body = kind + struct.pack("<H", len(payload)) + payload
    a = b = 0
    for byte in body:
        a = (a + byte) % 256
        b = (b + a) % 256
    return b"\xb5\x62" + body + bytes((a, b))


def nav_pvt(tow_ms: int, nano: int, flags: int = 1, fix: int = 3) -> bytes:
    """Field after field of the u-blox M8 interface description, 32.17.14."""
    payload = struct.pack(
        "<IH6BIi4B4i2I5i2I2H4xihH",
        *(tow_ms, 2026, 11, 21, 15, 59, 29, 0x37, 25, nano, fix, flags, 0, 14),
        *(-751_234_567, 451_234_567, 145_000, 100_250, 900, 1200, 56_001, -20, 3, 56_001, -2_000, 50, 30_000, 162),
        *(0, 0, 0, 0),
    )
    assert len(payload) == 92
    return ubx(b"\x01\x07", payload)


PVT = nav_pvt(403_187_200, 199_629_557)
PVT_READING = Reading(
    "NAV-PVT",
    403_187_200_000_000 - 370_443,
    None,
    {
        "lat": 45.1234567,
        "lon": -75.1234567,
        "height": 145_000.0,
        "hMSL": 100_250.0,
        "velN": 56_001.0,
        "velE": -20.0,
        "velD": 3.0,
        "gSpeed": 56_001.0,
        "headMot": -0.02,
    },
    WEEK_NS,
)


def can_codec() -> CanCodec:
    device = load_rig("can_only").devices[0]
    assert isinstance(device, CanDevice)
    return CanCodec(device, RIGS)


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


# --- the encoders, read by somebody else ---


def test_the_boom_box_encoder_writes_the_packet_worked_out_by_hand() -> None:
    assert encode_packet(1, 2, 256, [-1, 300]) == PACKET
    assert encode_line(1, 2, 256, [-1, 300]) == b"$BOOM,1,2,256,-1,300*3E\r\n"


@pytest.mark.parametrize(("encode", "codec"), [(encode_packet, BoomboxCodec), (encode_line, BoomboxAsciiCodec)])
def test_counts_are_rounded_and_held_time_and_sequence_wrap(encode: Any, codec: Any) -> None:
    (found,) = codec().feed(encode(255, 256 + 7, 2**32 + 5, [0.6, 32766.4, 1e9, -1e9, math.nan]))
    assert (found.message, found.seq, found.t_device_ns) == (255, 7, 5000)
    np.testing.assert_array_equal(list(found.fields.values()), [1, 32766, math.inf, -math.inf, math.nan])


@given(
    st.integers(0, 255),
    st.integers(0, 10**6),
    st.integers(0, 2**40),
    st.lists(st.integers(-32766, 32766), max_size=len(FIELDS)),
)
def test_what_the_boom_box_sends_is_read_in_both_forms(message: int, seq: int, t_us: int, counts: list[int]) -> None:
    (binary,) = BoomboxCodec().feed(encode_packet(message, seq, t_us, counts))
    (text,) = BoomboxAsciiCodec().feed(encode_line(message, seq, t_us, counts))
    assert binary == text
    assert isinstance(binary, Reading)
    assert list(binary.fields.values()) == counts


@pytest.mark.parametrize(("encode", "codec"), [(encode_packet, BoomboxCodec), (encode_line, BoomboxAsciiCodec)])
def test_the_longest_message_is_read(encode: Any, codec: Any) -> None:
    (found,) = codec().feed(encode(255, 255, 2**32 - 1, [-32767] * len(FIELDS)))
    assert len(found.fields) == len(FIELDS)


def test_pyubx2_reads_our_frames() -> None:
    pvt: Any = UBXReader.parse(
        encode_nav_pvt(WEEK_NS + 403_187_199_629_557, 45.1234567, -75.1, 100_250.4, (1000.4, -20, 3))
    )
    assert (pvt.iTOW, pvt.nano, pvt.second) == (403_187_200, 199_629_557, 47)
    assert (pvt.lat, pvt.lon, pvt.hMSL, pvt.velN, pvt.velE, pvt.velD) == (45.1234567, -75.1, 100_250, 1000, -20, 3)


def test_a_fix_says_what_it_lacks() -> None:
    nan = math.nan
    (nowhere,) = UbxCodec().feed(encode_nav_pvt(0, nan, -75.1, 100.0, (1000.0, -20.0, 3.0)))
    (lost,) = UbxCodec().feed(encode_nav_pvt(0, 45.0, -75.1, 100.0, (1000.0, nan, 3.0)))
    assert isinstance(nowhere, Reading)
    assert isinstance(lost, Reading)
    assert "lat" not in nowhere.fields
    assert nowhere.fields["velN"] == 1000.0
    assert lost.fields == {}


@pytest.mark.parametrize("t_ns", [0, 403_187_199_629_557, 403_187_999_999_999, WEEK_NS - 1])
def test_the_time_of_week_survives_its_rounding(t_ns: int) -> None:
    (found,) = UbxCodec().feed(encode_nav_pvt(t_ns, 0.0, 0.0, 0.0, (0, 0, 0)))
    assert isinstance(found, Reading)
    assert found.t_device_ns == t_ns


def test_pynmeagps_reads_our_sentences() -> None:
    t_ns = DAY_NS + 45_296_123_456_789
    gga: Any = NMEAReader.parse(encode_sentence("GGA", t_ns, lat=45.1234567, lon=-75.1, alt=123.45))
    assert (gga.lat, gga.lon, gga.alt, gga.quality) == (45.1234567, -75.1, 123.45, 1)
    assert (gga.time.hour, gga.time.minute, gga.time.second, gga.time.microsecond) == (12, 34, 56, 123_000)
    rmc: Any = NMEAReader.parse(encode_sentence("RMC", t_ns, lat=45.0, lon=-75.1, v_north=-3.0, v_east=-4.0))
    assert rmc.spd * KT == pytest.approx(5.0, abs=1e-3)
    assert rmc.cog == pytest.approx(233.13, abs=0.005)
    vtg: Any = NMEAReader.parse(encode_sentence("VTG", t_ns, v_north=-3.0, v_east=4.0))
    assert (vtg.cogt, vtg.sogn * KT) == (pytest.approx(126.87, abs=0.005), pytest.approx(5.0, abs=1e-3))


def test_cantools_reads_our_frames_and_the_checksum_covers_the_identifier() -> None:
    database: Any = cantools.database.load_file(DBC)
    frame_id, is_extended, data = encode_frame(
        load_dbc(DBC)["GYRO"], {"p": 1.0, "q": -2.0, "r": 0.025}, 8_438_800_000, 21
    )
    assert encode_slcan(frame_id, is_extended, data) == GYRO
    assert database.decode_message(frame_id, data) == pytest.approx(GYRO_FIELDS)
    codec = can_codec()
    assert codec.feed_frame(0x101, False, data) is None  # the same bytes under ACCEL's identifier
    assert codec.bad == 1


def test_a_can_value_beyond_its_width_and_none_at_all_are_told_from_a_measurement() -> None:
    messages, database = load_dbc(DBC), cantools.database.load_file(DBC)
    frame = encode_frame(messages["ACCEL"], {"ax": 100.0, "ay": -100.0, "az": math.nan}, 0, 0)
    assert read(frame, "ax", "ay", "az") == [math.inf, -math.inf, "none"]
    seen: Any = database.decode_message(frame[0], frame[2])
    assert (seen["ax"], seen["ay"], str(seen["az"])) == (4.095, -4.095, "no reading")
    most = encode_frame(messages["ACCEL"], {"ax": 4.094, "ay": -4.094}, 0, 0)
    assert read(most, "ax", "ay", "az") == [pytest.approx(4.094), pytest.approx(-4.094), "none"]
    air = encode_frame(messages["AIR"], {"airspeed": 0.0, "dynamic_pressure": math.nan}, 0, 0)
    assert read(air, "airspeed", "dynamic_pressure") == [0.0, "none"]
    assert read(encode_frame(messages["AIR"], {"airspeed": 700.0}, 0, 0), "airspeed") == [math.inf]
    assert read(encode_frame(messages["AIR"], {"airspeed": -1.0}, 0, 0), "airspeed") == [0.0]
    unknown: Any = database.decode_message(0x110, encode_frame(messages["AIR"], {}, 0, 0)[2])
    assert {str(unknown[n]) for n in ("airspeed", "dynamic_pressure")} == {"no reading"}


def read(frame: tuple[int, bool, bytes], *names: str) -> list[float | str]:
    found = can_codec().feed_frame(*frame)
    assert found is not None
    return ["none" if math.isnan(found.fields[n]) else found.fields[n] for n in names]


def test_a_count_that_the_dbc_has_a_word_for_is_no_measurement(tmp_path: Path) -> None:
    (tmp_path / "own.dbc").write_text(
        'VERSION ""\nBU_: A\nBO_ 5 TEMP: 8 A\n SG_ t : 0|16@1+ (0.1,-40) [0|0] "degC" A\n'
        ' SG_ gear : 16|2@1+ (1,0) [0|3] "" A\n SG_ f : 32|32@1- (1,0) [0|0] "" A\n'
        'SIG_VALTYPE_ 5 f : 1;\nVAL_ 5 t 65024 "SNA" 65025 "broken wire" ;\n'
    )
    message = load_dbc(tmp_path / "own.dbc")["TEMP"]
    assert [message.signals["t"].value(count) for count in (0, 650, 65023)] == pytest.approx([-40, 25, 6462.3])
    assert all(math.isnan(message.signals["t"].value(count)) for count in (65024, 65025, 65535))
    assert math.isnan(message.signals["f"].value(math.nan))
    assert [message.signals["gear"].value(count) for count in (0, 3)] == [0, 3]
    definition = message.definition
    frame = encode_frame(message, {"t": 25.04, "f": 1.5}, 0, 0)
    assert definition.decode(frame[2]) == {"t": pytest.approx(25.0), "gear": 0, "f": 1.5}
    assert math.isnan(definition.decode(encode_frame(message, {}, 0, 0)[2])["f"])


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
