"""MSP of an angle-of-attack sensor: frames worked by hand, with the CRC by its polynomial."""

from __future__ import annotations

import math

import pytest

from drivers.codec import Reading
from drivers.serial_msp import MspCodec, encode
from drivers.signatures import recognised


def sealed(body: str) -> bytes:
    """`$X<`, the body (hex: flag, message, length, payload), CRC-8 of x8+x7+x6+x4+x2+1 bit by bit (ETSI EN 302 307)."""
    crc, given = 0, bytes.fromhex(body)
    for byte in given:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1) ^ 0xD5 if crc & 0x80 else crc << 1
        crc &= 0xFF
    return b"$X<" + given + bytes((crc,))


# 4.5 deg up and 1.2 deg the other way: 45 = 0x002D, -12 = 0xFFF4.
ANGLES = sealed("00 081f 0400 2d00 f4ff")


def readings(codec: MspCodec, data: bytes) -> list[dict[str, float]]:
    return [r.fields for r in codec.feed(data) if isinstance(r, Reading)]


def test_angles_are_tenths_of_a_degree() -> None:
    assert readings(MspCodec(), ANGLES) == [pytest.approx({"aoa": 4.5, "sideslip": -1.2})]
    assert encode(Reading("AOA", None, None, {"aoa": 4.5, "sideslip": -1.2})) == ANGLES


def test_the_largest_count_is_no_reading() -> None:
    (fields,) = readings(MspCodec(), sealed("00 081f 0400 ff7f 0000"))
    assert math.isnan(fields["aoa"])
    assert fields["sideslip"] == 0.0
    assert encode(Reading("AOA", None, None, {"sideslip": 0.0})) == sealed("00 081f 0400 ff7f 0000")


def test_however_the_bytes_are_cut_and_whatever_stands_between() -> None:
    data = b"boot\r\n" + ANGLES + sealed("00 011f 0500 ff64000000") + b"$X" + ANGLES + b"$"
    codec = MspCodec()
    found = [fields for k in range(len(data)) for fields in readings(codec, data[k : k + 1])]
    assert len(found) == 2
    whole = MspCodec()
    assert readings(whole, data) == found
    assert whole.bad == codec.bad
    assert whole.noise == codec.noise


def test_a_wrong_sum_or_another_length_is_counted_and_no_reading() -> None:
    codec = MspCodec()
    broken = bytearray(ANGLES)
    broken[9] ^= 1
    assert readings(codec, bytes(broken) + ANGLES) == readings(MspCodec(), ANGLES)
    assert codec.bad == 1
    first = sealed("00 081f 0300 ff 2d00")  # the request's first sensors: quality, angle
    assert readings(codec, first) == []
    assert codec.bad == 2
    assert readings(codec, b"$X<" + bytes.fromhex("00 081f ffff") + ANGLES) == readings(MspCodec(), ANGLES)


def test_a_line_is_recognised() -> None:
    assert recognised(3 * ANGLES) == "msp"
    assert recognised(3 * sealed("00 6400 0000")) == "msp_other"
