"""GNSS receivers: u-blox UBX (NAV-PVT) and NMEA 0183 (GGA, RMC and VTG, through pynmeagps).

Fields keep the names and units of pyubx2, which writes what is emulated and is the tests' second reader, and of
pynmeagps. NAV-PVT: lat, lon, headMot deg; height, hMSL mm; velN, velE, velD,
gSpeed mm/s. GGA: lat, lon deg; alt m. RMC: lat, lon, cog deg; spd kt. VTG: cogt deg; sogn kt. RMC and VTG also give
v_north and v_east in m/s. A message without a fix has no fields, and NAV-PVT no position that it calls invalid. Device
time is the time of week (UBX) or of day (NMEA), both UTC or GPS time as the receiver says; VTG carries none.
"""

from __future__ import annotations

import itertools
import math
import re
import struct
from collections.abc import Sequence
from typing import Any, Final

from pynmeagps import GET as NMEA_GET
from pynmeagps import NMEAMessage, NMEAReader
from pyubx2 import GET as UBX_GET
from pyubx2 import UBXMessage

from drivers.codec import Codec, Reading, TimeReply
from drivers.framing import CutCodec, open_line
from drivers.protocols import Protocol
from station.conventions import to_si

WEEK_NS: Final = 604_800 * 10**9
DAY_NS: Final = 86_400 * 10**9

UBX_FIELDS: Final[dict[str | int, Sequence[str]]] = {
    "NAV-PVT": ("lat", "lon", "height", "hMSL", "velN", "velE", "velD", "gSpeed", "headMot")
}
NMEA_FIELDS: Final[dict[str | int, Sequence[str]]] = {
    "GGA": ("lat", "lon", "alt"),
    "RMC": ("lat", "lon", "spd", "cog", "v_north", "v_east"),
    "VTG": ("cogt", "sogn", "v_north", "v_east"),
}
"""What a rig may name: message and its fields."""

_DERIVED: Final = ("v_north", "v_east")
_VELOCITY: Final = ("velN", "velE", "velD", "gSpeed")
_PVT: Final = struct.Struct("<I12xiBB2x4i8x5i10xH")
"""iTOW, nano, fixType, flags; lon, lat, height, hMSL; velN, velE, velD, gSpeed, headMot; flags3, whose bit 0 is
invalidLlh."""
_SYNC: Final = b"\xb5\x62"
_DOLLAR: Final = ord("$")
_BEGIN: Final = re.compile(rb"\xb5(?:\x62|\Z)|\$(?!\$)")
"""Where something may begin: of a run of dollars only the last begins a sentence."""
_NAV_PVT: Final = b"\x01\x07"
_NAV_PVT_LENGTHS: Final = (84, 92)
_LONGEST_UBX: Final = 4096
_LONGEST_TEXT: Final = 128
_NOISE_RUN: Final = 256


class UbxCodec(Codec):
    """UBX frames to readings. Sound frames of other messages, and NMEA sentences between frames, are passed over.

    Whatever the bytes are, each is looked at a fixed number of times: checksums come from running sums.
    """

    def __init__(self) -> None:
        self.bad = 0
        self.resyncs = 0
        self.noise = 0
        self._rest = bytearray()
        self._noise = 0
        self._enough = 0
        """So many bytes must wait before anything more can be said of them."""

    def feed(self, data: bytes) -> list[Reading | TimeReply]:
        self._rest += data
        if len(self._rest) < self._enough:
            return []
        readings: list[Reading | TimeReply] = []
        waiting = _Waiting(bytes(self._rest))
        at, self._enough = 0, 0
        while at < len(waiting.bytes) and (taken := self._take(waiting, at, readings)) > 0:
            at += taken
        del self._rest[:at]
        self._enough = max(0, self._enough - at)
        return readings

    def reset(self) -> None:
        self._rest.clear()
        self._noise = self._enough = 0

    def _take(self, waiting: _Waiting, at: int, readings: list[Reading | TimeReply]) -> int:
        """Bytes used up from `at` on; 0 to wait for more."""
        data = waiting.bytes
        if data.startswith(_SYNC, at):
            return self._take_frame(waiting, at, readings)
        if data[at:] == _SYNC[:1]:
            return 0
        if data[at] == _DOLLAR:
            end = waiting.line_end(at)
            if (
                0 <= end < at + _LONGEST_TEXT
                and data.rfind(b"$", at, end) == at
                and open_line(data[at:end]) is not None
            ):
                self._noise = 0
                return end + 1 - at
            if end < 0 and len(data) - at < _LONGEST_TEXT and data.find(_SYNC, at) < 0:
                return 0
        begins = _BEGIN.search(data, at + 1)
        skipped = (begins.start() if begins else len(data)) - at
        # One resync for each run of noise, and another each so many bytes of a run without end.
        self.resyncs += (self._noise + skipped - 1) // _NOISE_RUN - (self._noise - 1) // _NOISE_RUN
        self._noise += skipped
        self.noise += skipped
        return skipped

    def _take_frame(self, waiting: _Waiting, at: int, readings: list[Reading | TimeReply]) -> int:
        data = waiting.bytes
        if len(data) < at + 6:
            return 0
        length = int.from_bytes(data[at + 4 : at + 6], "little")
        is_pvt = data.startswith(_NAV_PVT, at + 2)
        if length not in _NAV_PVT_LENGTHS if is_pvt else length > _LONGEST_UBX:
            return self._refuse()
        end = at + length + 8
        if len(data) < end:
            self._enough = end
            return 0
        if not waiting.checksum_holds(at, end):
            # Perhaps the length itself was hit: look for the next frame inside, not behind it.
            return self._refuse()
        self._noise = 0
        if is_pvt:
            readings.append(_read_nav_pvt(data[at:end]))
        return end - at

    def _refuse(self) -> int:
        """What looked like a frame's start is none."""
        self.bad += 1
        self.noise += len(_SYNC)
        return len(_SYNC)


class _Waiting:
    """Bytes not yet read, with what makes looking at them again and again cheap."""

    def __init__(self, data: bytes) -> None:
        self.bytes = data
        self._line_end = -2
        self._sums: tuple[list[int], list[int]] | None = None

    def line_end(self, at: int) -> int:
        """Where the next line feed stands; -1 for none."""
        if self._line_end != -1 and self._line_end < at:
            self._line_end = self.bytes.find(b"\n", at)
        return self._line_end

    def checksum_holds(self, at: int, end: int) -> bool:
        """Fletcher's 8-bit checksum over class, id, length and payload (u-blox interface description)."""
        if self._sums is None:
            once = list(itertools.accumulate(self.bytes, initial=0))
            self._sums = once, list(itertools.accumulate(once))
        once, twice = self._sums
        first, last = at + 2, end - 2
        a = once[last] - once[first]
        b = twice[last] - twice[first] - (last - first) * once[first]
        return self.bytes[last:end] == bytes((a & 0xFF, b & 0xFF))


def _read_nav_pvt(frame: bytes) -> Reading:
    """Of a sound frame of either length, the first 84 bytes of which are the same (u-blox interface description)."""
    i_tow, nano, fix_type, flags, lon, lat, height, h_msl, *ground, flags3 = _PVT.unpack_from(frame, 6)
    # iTOW is the epoch rounded to the millisecond; nano is the whole fraction of the second: its rest refines iTOW.
    below_ms = (nano + 500_000) % 1_000_000 - 500_000
    t_ns = (i_tow * 1_000_000 + below_ms) % WEEK_NS
    fields: dict[str, float] = {}
    if flags & 1 and fix_type in (2, 3, 4):
        if not flags3 & 1:
            fields = {"lat": _degrees(lat, 7), "lon": _degrees(lon, 7), "height": float(height), "hMSL": float(h_msl)}
        *velocity, course = ground
        fields |= {name: float(v) for name, v in zip(_VELOCITY, velocity, strict=True)}
        fields["headMot"] = _degrees(course, 5)
    return Reading("NAV-PVT", t_ns, None, fields, WEEK_NS)


def _degrees(count: int, decimals: int) -> float:
    """The float nearest to the decimal number that the count stands for: so many of its digits are decimals."""
    return count / 10.0**decimals


class NmeaCodec(CutCodec):
    """NMEA sentences of any talker to readings. Sound sentences of other kinds are passed over."""

    def __init__(self) -> None:
        super().__init__(b"\n", _LONGEST_TEXT, _read_sentence)


def _read_sentence(line: bytes) -> Sequence[Reading] | None:
    body = open_line(line)
    if body is None:
        return None
    if body.split(",", 1)[0][2:] not in NMEA_FIELDS:
        return ()
    try:
        sentence: Any = NMEAReader.parse(line.strip() + b"\r\n")
        kind = sentence.msgID
        t_ns = _time_of_day_ns(sentence.time) if kind != "VTG" else None
        fields = {} if _says_no_fix(kind, sentence) else _numbers(kind, sentence)
    except Exception:  # the library's parser raises whatever its conversions do
        return None
    return (Reading(kind, t_ns, None, fields, DAY_NS if t_ns is not None else 0),)


def _says_no_fix(kind: str, sentence: Any) -> bool:
    return (kind == "GGA" and sentence.quality == 0) or (kind == "RMC" and sentence.status != "A")


def _numbers(kind: str, sentence: Any) -> dict[str, float]:
    """The sentence's numbers under the library's names, and the velocity that speed and track make."""
    fields = {n: float(v) for n in NMEA_FIELDS[kind] if isinstance(v := getattr(sentence, n, ""), int | float)}
    speed, track = ("spd", "cog") if kind == "RMC" else ("sogn", "cogt")
    if speed in fields and fields[speed] == 0:
        fields.setdefault(track, 0.0)  # receivers leave the track of a standing antenna empty
    if speed in fields and track in fields:
        v, chi = to_si(fields[speed], "kt"), to_si(fields[track], "deg")
        fields["v_north"], fields["v_east"] = v * math.cos(chi), v * math.sin(chi)
    return fields


def _time_of_day_ns(time: Any) -> int | None:
    """None where the receiver does not know the time yet (an empty field)."""
    if isinstance(time, str):
        return None
    return int(((time.hour * 60 + time.minute) * 60 + time.second) * 10**9 + time.microsecond * 1000)


def encode_nav_pvt(
    t_ns: int, lat: float, lon: float, hmsl_mm: float, vel_ned_mm_s: tuple[float, float, float]
) -> bytes:
    """A UBX-NAV-PVT frame. `t_ns` is the receiver's time (taken modulo a week); lat and lon in deg.

    Of a position not wholly known (NaN) it says that it is invalid, without a whole velocity that there is no fix.
    """
    t_ns %= WEEK_NS
    second_of_day = t_ns % DAY_NS // 10**9
    has_position = all(math.isfinite(x) for x in (lat, lon, hmsl_mm))
    if not has_position:
        lat = lon = hmsl_mm = 0.0
    fix = all(math.isfinite(v) for v in vel_ned_mm_s)
    north, east, down = vel_ned_mm_s if fix else (0.0, 0.0, 0.0)
    message = UBXMessage(
        "NAV",
        "NAV-PVT",
        UBX_GET,
        iTOW=round(t_ns / 1e6) % (WEEK_NS // 10**6),
        hour=second_of_day // 3600,
        min=second_of_day // 60 % 60,
        second=second_of_day % 60,
        nano=t_ns % 10**9,
        fixType=3 if fix else 0,
        gnssFixOk=int(fix),
        numSV=12 if fix else 0,
        lat=lat,
        lon=lon,
        hMSL=round(hmsl_mm),
        velN=round(north),
        velE=round(east),
        velD=round(down),
        gSpeed=round(math.hypot(north, east)),
        headMot=math.degrees(math.atan2(east, north)),
        invalidLlh=int(not has_position),
    )
    frame: bytes = message.serialize()
    return frame


def encode_sentence(kind: str, t_ns: int, **fields: float) -> bytes:
    """A GGA, RMC or VTG sentence of talker GN from the fields of NMEA_FIELDS. `t_ns` is taken modulo a day.

    `v_north` and `v_east` (m/s) stand for speed and track where those are not given. What is not given stays empty.
    """
    ms_of_day = t_ns % DAY_NS // 1_000_000
    speed, track = ("spd", "cog") if kind == "RMC" else ("sogn", "cogt")
    if "v_north" in fields and "v_east" in fields:
        north, east = fields.pop("v_north"), fields.pop("v_east")
        fields.setdefault(speed, round(math.hypot(north, east) / to_si(1.0, "kt"), 3))
        fields.setdefault(track, round(math.degrees(math.atan2(east, north)) % 360.0, 2))
    values: dict[str, Any] = {name: "" for name in NMEA_FIELDS[kind] if name not in _DERIVED} | fields
    if kind != "VTG":
        seconds, ms = divmod(ms_of_day, 1000)
        hours, seconds = divmod(seconds, 3600)
        values["time"] = f"{hours:02d}:{seconds // 60:02d}:{seconds % 60:02d}.{ms:03d}"
    if kind == "GGA":
        values.update(quality=1, numSV=12, altUnit="M", sepUnit="M")
    elif kind == "RMC":
        values.update(status="A", posMode="A", date="2026-01-01")
    else:
        values.update(cogtUnit="T", cogmUnit="M", sognUnit="N", sogkUnit="K")
    sentence: bytes = NMEAMessage("GN", kind, NMEA_GET, hpnmeamode=True, **values).serialize()
    return sentence


def _ubx_frame(reading: Reading) -> bytes:
    # What the rig does not read is 0; what the flight lacks is NaN.
    lat, lon, height, *velocity = (reading.fields.get(n, 0.0) for n in ("lat", "lon", "hMSL", "velN", "velE", "velD"))
    north, east, down = velocity
    return encode_nav_pvt(reading.t_device_ns or 0, lat, lon, height, (north, east, down))


def _nmea_sentence(reading: Reading) -> bytes:
    known = {name: value for name, value in reading.fields.items() if not math.isnan(value)}
    return encode_sentence(str(reading.message), reading.t_device_ns or 0, **known)


UBX: Final = Protocol("u-blox UBX: NAV-PVT", UbxCodec, UBX_FIELDS, _ubx_frame)
NMEA: Final = Protocol("NMEA 0183 sentences of any talker", NmeaCodec, NMEA_FIELDS, _nmea_sentence)
