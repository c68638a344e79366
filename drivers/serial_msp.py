"""MSP version 2, as a sensor speaks it to iNav: angle of attack and sideslip of its message MSP2_SENSOR_AOA.

A frame is `$X<`, a flag, the message u16, the length u16, as many bytes, and CRC-8/DVB-S2 over all from the flag on;
little-endian. MSP2_SENSOR_AOA (0x1F08) holds two int16 of 0.1 degree, angle of attack and sideslip; 32767 is no
reading. That is the definition of iNav's pull request 11484 and of its author's sensor; until the request is merged
both may change, and its first sensors sent a quality and one angle, which is refused here as of another length. Neither
says what a positive sideslip is: look at the vane, and turn it by the rig's scale.

The fields are "aoa" and "sideslip", deg. There is no device time and no counter. Other messages are passed over.
"""

from __future__ import annotations

import math
import struct
from typing import Final

from fastcrc import crc8

from drivers.codec import Codec, Reading, TimeReply
from drivers.protocols import Protocol

OPENING: Final = b"$X"
AOA: Final = 0x1F08
FIELDS: Final = ("aoa", "sideslip")
_HEAD: Final = struct.Struct("<2scBHH")
_ANGLES: Final = struct.Struct("<2h")
_NO_READING: Final = 32767
_STEP: Final = 0.1
"""deg"""
_LONGEST: Final = 512
"""Bytes in a frame: a length beyond them is noise."""


class MspCodec(Codec):
    """Frames to readings."""

    def __init__(self) -> None:
        self.bad = 0
        self.resyncs = 0
        self.noise = 0
        self._rest = bytearray()

    def feed(self, data: bytes) -> list[Reading | TimeReply]:
        rest = self._rest
        rest += data
        found: list[Reading | TimeReply] = []
        at = 0
        while True:
            start = rest.find(OPENING, at)
            if start < 0:
                start = len(rest) - rest.endswith(OPENING[:1])
            if start > at:
                self.resyncs += 1
                self.noise += start - at
            at = start
            if len(rest) - at < _HEAD.size:
                break
            *_, message, length = _HEAD.unpack_from(rest, at)
            end = at + _HEAD.size + length
            if length <= _LONGEST and len(rest) <= end:
                break
            if length > _LONGEST or crc8.dvb_s2(bytes(rest[at + 3 : end])) != rest[end]:
                self.bad += 1
                self.noise += len(OPENING)
                at += len(OPENING)
                continue
            found += self._readings(message, bytes(rest[end - length : end]))
            at = end + 1
        del rest[:at]
        return found

    def _readings(self, message: int, payload: bytes) -> list[Reading]:
        if message != AOA:
            return []
        if len(payload) != _ANGLES.size:
            self.bad += 1
            return []
        angles = (math.nan if n == _NO_READING else _STEP * n for n in _ANGLES.unpack(payload))
        return [Reading("AOA", None, None, dict(zip(FIELDS, angles, strict=True)))]

    def reset(self) -> None:
        self._rest.clear()


def encode(reading: Reading) -> bytes:
    """A frame as the sensor sends it; what is no number or beyond 3276 deg is no reading."""
    steps = [reading.fields.get(name, math.nan) / _STEP for name in FIELDS]
    held = [round(n) if abs(n) < _NO_READING else _NO_READING for n in steps]
    frame = _HEAD.pack(OPENING, b"<", 0, AOA, _ANGLES.size) + _ANGLES.pack(*held)
    return frame + bytes((crc8.dvb_s2(frame[3:]),))


MSP: Final = Protocol(
    "MSP version 2 of a sensor for iNav: MSP2_SENSOR_AOA (its pull request 11484)", MspCodec, {"AOA": FIELDS}, encode
)
