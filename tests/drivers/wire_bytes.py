"""Bytes of each wire format, worked out by hand."""

from __future__ import annotations

import struct

from drivers.can_dbc import CanCodec
from drivers.codec import Reading
from drivers.serial_gnss import WEEK_NS
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
