"""VectorNav VN-100, VN-200 and VN-300: binary outputs, after their user manuals (UM001, UM004, UM005).

A packet is 0xFA, a byte of groups, a word of fields for each group, the fields in order, CRC-16 (polynomial 0x1021,
initial value 0, high byte first) over all but the 0xFA; everything else is little-endian. Which groups and fields come
is set in the device, and the header of each packet says so: nothing of it stands in the rig.

Each group of a packet is one message: Common, IMU, GNSS, Attitude, INS, GNSS2. A field is the manual's name and its
component, in the manual's units: YawPitchRoll deg, AngularRate and UncompGyro rad/s, accelerations m/s2, Position and
PosLla deg, deg and m above the ellipsoid, velocities m/s, Temp degC, Pres kPa. Body axes are those on the box.

Device time is TimeStartup, where the packet has it (in Common or Time). Position and velocity are no reading where the
same group says that there is no fix (Fix) or that the INS does not track (InsStatus).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from fastcrc import crc16

from drivers.codec import Codec, Reading, TimeReply
from drivers.framing import open_line
from drivers.protocols import Protocol


@dataclass(frozen=True, slots=True)
class _Field:
    """One bit of a group's word. `names` are its components in order, of one of struct's types; none: passed over."""

    name: str
    size: int
    names: tuple[str, ...] = ()
    kind: str = "f"

    @property
    def layout(self) -> str:
        return f"<{len(self.names)}{self.kind}"


_XYZ: Final = ("x", "y", "z")
_NED: Final = ("north", "east", "down")
_YPR: Final = ("yaw", "pitch", "roll")


def _floats(name: str, parts: tuple[str, ...] = ()) -> _Field:
    names = tuple(f"{name}.{part}" for part in parts) or (name,)
    return _Field(name, 4 * len(names), names)


def _lla(name: str) -> _Field:
    return _Field(name, 24, tuple(f"{name}.{part}" for part in ("latitude", "longitude", "altitude")), "d")


_TIME_STARTUP: Final = _Field("TimeStartup", 8)
_INS_STATUS: Final = _Field("InsStatus", 2)
_FIX: Final = _Field("Fix", 1)
_SAT_INFO: Final = _Field("SatInfo", 2)
"""Two bytes and eight for each satellite that the first of them counts."""
_GNSS: Final = (
    _Field("UTC", 8), _Field("Tow", 8), _Field("Week", 2), _Field("NumSats", 1), _FIX, _lla("PosLla"),
    _Field("PosEcef", 24), _floats("VelNed", _NED), _Field("VelEcef", 12), _Field("PosU", 12), _Field("VelU", 4),
    _Field("TimeU", 4), _Field("TimeInfo", 2), _Field("DOP", 28), _SAT_INFO,
)  # fmt: skip
GROUPS: Final[tuple[tuple[str, tuple[_Field, ...]], ...]] = (
    ("Common", (
        _TIME_STARTUP, _Field("TimeGps", 8), _Field("TimeSyncIn", 8), _floats("YawPitchRoll", _YPR),
        _Field("Quaternion", 16), _floats("AngularRate", _XYZ), _lla("Position"), _floats("Velocity", _NED),
        _floats("Accel", _XYZ),
        _floats("Imu", ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z")),
        _floats("MagPres", ("mag_x", "mag_y", "mag_z", "temp", "pres")), _Field("DeltaThetaVel", 28), _INS_STATUS,
        _Field("SyncInCnt", 4), _Field("TimeGpsPps", 8),
    )),
    ("Time", (
        _TIME_STARTUP, _Field("TimeGps", 8), _Field("GpsTow", 8), _Field("GpsWeek", 2), _Field("TimeSyncIn", 8),
        _Field("TimeGpsPps", 8), _Field("TimeUtc", 8), _Field("SyncInCnt", 4), _Field("SyncOutCnt", 4),
        _Field("TimeStatus", 1),
    )),
    ("IMU", (
        _Field("ImuStatus", 2), _floats("UncompMag", _XYZ), _floats("UncompAccel", _XYZ), _floats("UncompGyro", _XYZ),
        _floats("Temp"), _floats("Pres"), _Field("DeltaTheta", 16), _Field("DeltaVel", 12), _floats("Mag", _XYZ),
        _floats("Accel", _XYZ), _floats("AngularRate", _XYZ), _Field("SensSat", 2),
    )),
    ("GNSS", _GNSS),
    ("Attitude", (
        _Field("VpeStatus", 2), _floats("YawPitchRoll", _YPR), _Field("Quaternion", 16), _Field("DCM", 36),
        _Field("MagNed", 12), _Field("AccelNed", 12), _Field("LinearAccelBody", 12), _Field("LinearAccelNed", 12),
        _Field("YprU", 12),
    )),
    ("INS", (
        _INS_STATUS, _lla("PosLla"), _Field("PosEcef", 24), _floats("VelBody", _XYZ), _floats("VelNed", _NED),
        _Field("VelEcef", 12), _Field("MagEcef", 12), _Field("AccelEcef", 12), _Field("LinearAccelEcef", 12),
        _Field("PosU", 4), _Field("VelU", 4),
    )),
    ("GNSS2", _GNSS),
)  # fmt: skip
"""Groups by their bit, each with its fields by theirs: lengths as in the manuals' table of the binary groups."""

FIELDS: Final[dict[str | int, Sequence[str]]] = {
    name: names for name, fields in GROUPS if (names := tuple(n for f in fields for n in f.names))
}
"""What a rig may name."""

SYNC: Final = 0xFA
_EXTENDED_GROUPS: Final = 0x80
_EXTENDED_FIELDS: Final = 0x8000
_LONGEST_PACKET: Final = 1024
"""Ten times what 115,200 baud carry 100 times a second; noise may announce no more."""
_LONGEST_TEXT: Final = 256
_NOISE_RUN: Final = 256
_TRACKING: Final = 0x0003
"""Bits of InsStatus that are 0 while the INS waits for its first solution (mode 0) or has lost it."""
_NAVIGATED: Final = ("Position.", "Velocity.", "PosLla.", "VelNed.", "VelBody.")
_CRC: Final = struct.Struct(">H")


@dataclass(frozen=True, slots=True)
class _Layout:
    """What a header announces: each field with its group, in order of the payload."""

    header: int
    fields: tuple[tuple[str, _Field], ...]


@lru_cache(maxsize=256)
def _layout(groups: int, words: tuple[int, ...]) -> _Layout | None:
    """None for a header with a group or field that is not in GROUPS, whose length nobody knows."""
    found: list[tuple[str, _Field]] = []
    for word, (name, fields) in zip(words, (g for bit, g in enumerate(GROUPS) if groups >> bit & 1), strict=True):
        if word == 0 or word >> len(fields):
            return None
        found += ((name, field) for bit, field in enumerate(fields) if word >> bit & 1)
    return _Layout(2 + 2 * len(words), tuple(found))


class VectorNavCodec(Codec):
    """Binary packets to readings. The device's text lines (`$VN...`) between them are passed over.

    Takes time in proportion to the bytes: a packet that is none costs its own length at most, once for its first byte.
    """

    def __init__(self) -> None:
        self.bad = 0
        self.resyncs = 0
        self.noise = 0
        self._rest = bytearray()
        self._noise = 0

    def feed(self, data: bytes) -> list[Reading | TimeReply]:
        self._rest += data
        readings: list[Reading | TimeReply] = []
        at = 0
        while at < len(self._rest):
            if self._rest[at] == SYNC:
                taken = self._take_packet(at, readings)
            elif self._rest[at] == ord("$"):
                taken = self._take_line(at)
            else:
                taken = self._skip_noise()
            if not taken:
                break
            at += taken
        del self._rest[:at]
        return readings

    def reset(self) -> None:
        self._rest.clear()
        self._noise = 0

    def _skip_noise(self) -> int:
        """One resync for each run of noise, and another each so many bytes of a run without end."""
        self.resyncs += self._noise % _NOISE_RUN == 0
        self._noise += 1
        self.noise += 1
        return 1

    def _take_line(self, at: int) -> int:
        """Bytes of a text line at `at`; 0 to wait for more."""
        end = self._rest.find(b"\n", at, at + _LONGEST_TEXT)
        if end >= 0 and open_line(bytes(self._rest[at:end])) is not None:
            self._noise = 0
            return end + 1 - at
        if end < 0 and len(self._rest) - at < _LONGEST_TEXT and SYNC not in self._rest[at : at + _LONGEST_TEXT]:
            return 0
        return self._skip_noise()

    def _take_packet(self, at: int, readings: list[Reading | TimeReply]) -> int:
        """Bytes used up at `at`; 0 to wait for more."""
        rest = self._rest
        if len(rest) - at < 2:
            return 0
        groups = rest[at + 1]
        words = groups.bit_count()
        if groups == 0 or groups & _EXTENDED_GROUPS:
            return self._refuse()
        if len(rest) - at < 2 + 2 * words:
            return 0
        layout = _layout(groups, struct.unpack_from(f"<{words}H", rest, at + 2))
        if layout is None:
            return self._refuse()
        length = _payload_length(layout, rest, at)
        if length is None:
            return 0
        whole = layout.header + length + _CRC.size
        if whole > _LONGEST_PACKET:
            return self._refuse()
        if len(rest) - at < whole:
            return 0
        packet = bytes(rest[at : at + whole])
        if crc16.xmodem(packet[1:]) != 0:  # the CRC over what it covers and itself
            return self._refuse()
        self._noise = 0
        readings += _readings(layout, packet)
        return whole

    def _refuse(self) -> int:
        """The next packet is looked for inside this one: perhaps it was none."""
        self.bad += 1
        self.noise += 1
        return 1


def _payload_length(layout: _Layout, data: bytes | bytearray, at: int) -> int | None:
    """None where the count of a variable field has not come yet."""
    length = 0
    for _, field in layout.fields:
        if field is _SAT_INFO:
            counted = at + layout.header + length
            if counted >= len(data):
                return None
            length += 8 * data[counted]
        length += field.size
    return length


def _readings(layout: _Layout, packet: bytes) -> Iterator[Reading]:
    """A reading for each group that has fields to read."""
    groups: dict[str, dict[str, float]] = {}
    lost: set[str] = set()
    t_ns = None
    offset = layout.header
    for group, field in layout.fields:
        if field.names:
            values = struct.unpack_from(field.layout, packet, offset)
            groups.setdefault(group, {}).update(zip(field.names, values, strict=True))
        elif field is _TIME_STARTUP:
            t_ns = int.from_bytes(packet[offset : offset + 8], "little")
        elif (field is _FIX and packet[offset] == 0) or (field is _INS_STATUS and not packet[offset] & _TRACKING):
            lost.add(group)
        elif field is _SAT_INFO:
            offset += 8 * packet[offset]
        offset += field.size
    for group, fields in groups.items():
        if group in lost:
            fields = {name: value for name, value in fields.items() if not name.startswith(_NAVIGATED)}
        yield Reading(group, t_ns, None, fields)


def encode_packet(groups: Mapping[str, Mapping[str, bytes]]) -> bytes:
    """A packet of the fields' bytes by group and name."""
    bits, words, payload = 0, b"", b""
    for bit, (group, fields) in enumerate(GROUPS):
        if group not in groups:
            continue
        bits |= 1 << bit
        named = {field.name: 1 << k for k, field in enumerate(fields)}
        words += sum(named[name] for name in groups[group]).to_bytes(2, "little")
        payload += b"".join(groups[group][field.name] for field in fields if field.name in groups[group])
    body = bytes((bits,)) + words + payload
    return bytes((SYNC,)) + body + _CRC.pack(crc16.xmodem(body))


def _packet(reading: Reading) -> bytes:
    """The reading's group alone, and when it was: what of a field the rig does not map is no number."""
    group = str(reading.message)
    given: dict[str, bytes] = {}
    for field in dict(GROUPS)[group]:
        if any(name in reading.fields for name in field.names):
            values = (reading.fields.get(name, math.nan) for name in field.names)
            given[field.name] = struct.pack(field.layout, *values)
    stamp = {"TimeStartup": (reading.t_device_ns or 0).to_bytes(8, "little")}
    if group == "Common":
        return encode_packet({group: stamp | given})
    return encode_packet({"Common": stamp, group: given})


VECTORNAV: Final = Protocol(
    "VectorNav VN-100, VN-200, VN-300: binary outputs",
    VectorNavCodec,
    FIELDS,
    _packet,
    messages=f"one of {', '.join(map(str, FIELDS))}, as the device's binary output has them",
)
