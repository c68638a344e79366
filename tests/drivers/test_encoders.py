"""The encoders, read by somebody else."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pynmeagps import NMEAReader
from pyubx2 import UBXReader

from drivers.can_dbc import encode_frame, load_dbc
from drivers.can_frames import encode_slcan
from drivers.codec import Reading
from drivers.serial_boombox import FIELDS, BoomboxAsciiCodec, BoomboxCodec, encode_line, encode_packet
from drivers.serial_gnss import DAY_NS, UBX_FIELDS, WEEK_NS, UbxCodec, encode_nav_pvt, encode_sentence
from tests.drivers.wire_bytes import DBC, GYRO, GYRO_FIELDS, KT, PACKET, can_codec, ubx


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


@given(st.binary(min_size=92, max_size=92), st.sampled_from([84, 92]), st.booleans())
def test_whatever_a_receiver_says_is_read_as_pyubx2_reads_it(payload: bytes, length: int, is_fixed: bool) -> None:
    if is_fixed:  # of random bytes few say so
        payload = payload[:20] + b"\3\1" + payload[22:]
    frame = ubx(b"\x01\x07", payload[:length])
    (found,) = UbxCodec().feed(frame)
    pvt: Any = UBXReader.parse(frame)
    wanted = [n for n in UBX_FIELDS["NAV-PVT"] if not (pvt.invalidLlh and n in ("lat", "lon", "height", "hMSL"))]
    has_fix = pvt.gnssFixOk and pvt.fixType in (2, 3, 4)
    assert isinstance(found, Reading)
    # The library multiplies degrees by 1e-7 and rounds; ours are the floats nearest to the decimals.
    expected = {n: float(getattr(pvt, n)) for n in wanted} if has_fix else {}
    assert found.fields == pytest.approx(expected, rel=1e-14)


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
