"""VectorNav's binary outputs against the manual's examples and packets laid out by ArduPilot.

Oracles: VN-100 user manual (UM001 v2.22), 4.3.7; the two packets of ArduPilot's SITL (SIM_VectorNav.cpp), whose headers
and structures are written here with struct; CRC-16 by binascii.
"""

from __future__ import annotations

import binascii
import math
import struct

import pytest

from drivers.codec import Reading
from drivers.serial_vectornav import GROUPS, VectorNavCodec, encode_packet

# ArduPilot's VN_INS_packet1: IMU, Attitude and INS groups, with the numbers of a level turn.
AHRS = (
    bytes.fromhex("34 2e07 0601 1206")
    + struct.pack("<3f3f3f", *(0.2, 0.0, 0.4), *(0.1, 0.2, -9.8), *(0.01, 0.02, 0.03))
    + struct.pack("<f3f3f3f", 95.25, *(0.2, 0.0, 0.4), *(1.5, -0.25, -9.75), *(0.5, -0.125, 0.0625))
    + struct.pack("<3f4f3f", *(-90.0, 2.0, 30.0), *(0.0, 0.0, 0.0, 1.0), *(0.1, 0.1, 0.2))
    + struct.pack("<3d3f2f", *(48.0, 11.5, 545.25), *(1.0, -56.0, 0.5), *(0.5, 0.25))
)
# VN_INS_packet2: Time, IMU, GNSS and GNSS2.
GNSS = (
    bytes.fromhex("4e 0200 1000 b820 1800")
    + struct.pack("<Qf", 1_500_000_000, 12.5)
    + struct.pack("<2B3d3f7f", 19, 3, *(48.0, 11.5, 545.25), *(1.0, -56.0, 0.5), *(1.0,) * 7)
    + struct.pack("<2B", 18, 3)
)


def sealed(body: bytes) -> bytes:
    return b"\xfa" + body + binascii.crc_hqx(body, 0).to_bytes(2, "big")


def read(body: bytes) -> dict[str, Reading]:
    codec = VectorNavCodec()
    found = codec.feed(sealed(body))
    assert (codec.bad, codec.resyncs) == (0, 0)
    return {str(r.message): r for r in found if isinstance(r, Reading)}


def test_the_manuals_second_example() -> None:
    """It prints 01 as the fields of group 3, which its own CRC refutes: that is of 20, one float of that group."""
    (ypr, imu) = VectorNavCodec().feed(bytes.fromhex("fa 05 0800 2000 a4150242 4ddfeb3f f61a36be bf2da441 a83a"))
    assert isinstance(ypr, Reading)
    assert isinstance(imu, Reading)
    assert list(ypr.fields.values()) == pytest.approx([32.521133, 1.8427521, -0.17783722], rel=1e-7)
    assert list(imu.fields.values()) == pytest.approx([20.522337], rel=1e-7)


def test_packets_of_many_groups_as_ardupilot_lays_them_out() -> None:
    ahrs = read(AHRS)
    assert set(ahrs) == {"IMU", "Attitude", "INS"}
    assert [ahrs["IMU"].fields[f"Accel.{n}"] for n in "xyz"] == [1.5, -0.25, -9.75]
    assert [ahrs["IMU"].fields[f"AngularRate.{n}"] for n in "xyz"] == [0.5, -0.125, 0.0625]
    assert ahrs["IMU"].fields["Pres"] == 95.25
    assert list(ahrs["Attitude"].fields.values()) == [-90.0, 2.0, 30.0]
    assert list(ahrs["INS"].fields.values()) == [48.0, 11.5, 545.25, 1.0, -56.0, 0.5]
    gnss = read(GNSS)
    assert gnss["IMU"].fields == {"Temp": 12.5}
    assert list(gnss["GNSS"].fields.values()) == [48.0, 11.5, 545.25, 1.0, -56.0, 0.5]
    assert gnss["GNSS"].t_device_ns is None, "there is TimeGps only: the device has one clock, that of TimeStartup"


def test_a_packet_is_stamped_by_its_startup_time_whichever_group_has_it() -> None:
    times = struct.pack("<Q", 3_600_000_000_123)
    for body in (bytes.fromhex("11 0100 0200") + times, bytes.fromhex("12 0100 0200") + times):
        readings = read(body + struct.pack("<3f", 1.0, 2.0, 3.0))
        assert readings["Attitude"].t_device_ns == 3_600_000_000_123
        assert set(readings) == {"Attitude"}, "a group of time alone is no reading"


@pytest.mark.parametrize(("status", "is_tracking"), [(0, False), (1, True), (2, True), (0x0004, False)])
def test_without_tracking_there_is_no_position_nor_velocity(status: int, is_tracking: bool) -> None:
    body = bytes.fromhex("20 1300") + struct.pack("<H3d", status, 48.0, 11.5, 545.0) + struct.pack("<3f", 1, 2, 3)
    assert bool(read(body)["INS"].fields) is is_tracking


def test_without_a_fix_there_is_no_position_nor_velocity() -> None:
    body = bytes.fromhex("08 b000") + struct.pack("<B3d3f", 0, 48.0, 11.5, 545.0, 1.0, 2.0, 3.0)
    assert read(body)["GNSS"].fields == {}


def test_satellites_in_view_make_a_packet_longer() -> None:
    """SatInfo: a count, a reserved byte, eight bytes a satellite."""
    satellites = bytes((3, 0)) + bytes(range(24))
    body = bytes.fromhex("28 1040 0200") + bytes((3,)) + satellites + struct.pack("<3d", 48.0, 11.5, 545.0)
    assert read(body)["INS"].fields["PosLla.altitude"] == 545.0


@pytest.mark.parametrize("header", ["ff 0100", "01 0080", "02 0004", "01 0000", "00", "80 01"])
def test_a_header_of_groups_or_fields_that_nobody_knows_is_counted_and_passed_over(header: str) -> None:
    codec = VectorNavCodec()
    found = codec.feed(sealed(bytes.fromhex(header) + bytes(40)) + sealed(AHRS))
    assert {r.message for r in found if isinstance(r, Reading)} == {"IMU", "Attitude", "INS"}
    assert codec.bad == 1


def test_text_lines_of_the_device_are_no_noise() -> None:
    codec = VectorNavCodec()
    line = b"$VNRRG,01,VN-300*58\r\n"
    found = codec.feed(line + sealed(AHRS) + line)
    assert len(found) == 3
    assert (codec.bad, codec.resyncs) == (0, 0)


def test_lengths_are_those_of_the_manuals_table() -> None:
    """UM001 v2.22, 4.3.6, groupLen; newer manuals give SatInfo its own."""
    printed = (
        (8, 8, 8, 12, 16, 12, 24, 12, 12, 24, 20, 28, 2, 4, 8),
        (8, 8, 8, 2, 8, 8, 8, 4, 4, 1),
        (2, 12, 12, 12, 4, 4, 16, 12, 12, 12, 12, 2),
        (8, 8, 2, 1, 1, 24, 24, 12, 12, 12, 4, 4, 2, 28, 2),
        (2, 12, 16, 36, 12, 12, 12, 12, 12),
        (2, 24, 24, 12, 12, 12, 12, 12, 12, 4, 4),
    )
    assert tuple(tuple(f.size for f in fields) for _, fields in GROUPS) == (*printed, printed[3])


def test_what_a_rig_does_not_map_is_sent_as_no_number() -> None:
    stamp = {"TimeStartup": bytes(8)}
    packet = encode_packet({"Common": stamp | {"Accel": struct.pack("<3f", math.nan, 0.0, -9.8125)}})
    assert packet == sealed(bytes.fromhex("01 0101") + bytes(8) + struct.pack("<3f", math.nan, 0.0, -9.8125))
