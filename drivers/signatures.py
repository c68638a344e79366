"""What a line's bytes look like, whoever was expected: so that a device behind the wrong protocol is named in words.

SIGNATURES is the one table: a protocol as the rig calls it, what it is in words, how many of its messages are in some
bytes. Each count is that of sound messages, by their checksums or by headers that point at each other: three are no
accident. Pure.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from drivers.can_frames import read_slcan
from drivers.codec import Reading
from drivers.framing import open_line
from drivers.protocols import protocol_named
from station.profile import Device, MavlinkDevice, SerialDevice

ENOUGH: Final = 3
"""Messages that are no accident."""
FIRST_LOOK: Final = 512
"""Bytes after which a line is looked at first."""
LAST_LOOK: Final = 4096
"""Bytes after which what has not been recognised is said to be unknown."""
_PRINTABLE_SHARE: Final = 0.95
_LONGEST_SHOWN: Final = 48


@dataclass(frozen=True, slots=True)
class Signature:
    """One row."""

    words: str
    """What it is called where the rig's user reads it."""
    count: Callable[[bytes], int]
    """Sound messages in these bytes."""
    protocol: str = ""
    """What to write into the rig; empty where the station does not read it."""


def _readings(protocol: str) -> Callable[[bytes], int]:
    """Those of the protocol's own codec, where all its messages give one."""

    def count(data: bytes) -> int:
        return sum(isinstance(reading, Reading) for reading in protocol_named(protocol).codec().feed(data))

    return count


def _lines(opening: bytes) -> Callable[[bytes], int]:
    """Sealed text lines that begin so (a pattern)."""
    pattern = re.compile(opening)

    def count(data: bytes) -> int:
        return sum(pattern.match(line) is not None and open_line(line) is not None for line in data.split(b"\n"))

    return count


def _ubx(data: bytes) -> int:
    """Frames whose Fletcher checksum holds."""
    found = at = 0
    while (at := data.find(b"\xb5\x62", at)) >= 0:
        end = at + 8 + int.from_bytes(data[at + 4 : at + 6], "little")
        a = b = 0
        for byte in data[at + 2 : min(end, len(data)) - 2]:
            a = (a + byte) & 0xFF
            b = (b + a) & 0xFF
        is_sound = at + 8 <= end <= len(data) and data[end - 2 : end] == bytes((a, b))
        found += is_sound
        at = end if is_sound else at + 2
    return found


def _chain(data: bytes, sync: int, around: int) -> int:
    """The most packets in a row of which each, by the length in its second byte, ends where the next begins."""
    best = 0
    reached: dict[int, int] = {}
    for at, byte in enumerate(data[:-1]):
        if byte == sync:
            run = reached.get(at, 0) + 1
            end = at + around + data[at + 1]
            reached[end] = max(run, reached.get(end, 0))
            best = max(best, run if end <= len(data) else run - 1)
    return best


def _mavlink(data: bytes) -> int:
    """Version 2 (0xFD, unsigned or signed) or 1 (0xFE)."""
    return max(_chain(data, 0xFD, 12), _chain(data, 0xFD, 25), _chain(data, 0xFE, 8))


def _slcan(data: bytes) -> int:
    return sum(read_slcan(line) is not None for line in data.split(b"\r"))


def _msp(data: bytes) -> int:
    return len(re.findall(rb"\$[MX][<>!]", data))


def _numbers(data: bytes) -> int:
    """Lines of numbers, where nearly all lines are; the first and last are cut."""
    lines = [line for line in data.split(b"\n")[1:-1] if line.strip()]
    found = _readings("lines")(b"".join(line + b"\n" for line in lines))
    return found if found >= _PRINTABLE_SHARE * len(lines) else 0


SIGNATURES: Final[Mapping[str, Signature]] = MappingProxyType(
    {
        "ubx": Signature("u-blox UBX", _ubx, "ubx"),
        "vectornav": Signature("VectorNav's binary output", _readings("vectornav"), "vectornav"),
        "boombox": Signature("the boom box's binary packets", _readings("boombox"), "boombox"),
        "boombox_ascii": Signature("the boom box's text lines", _lines(rb"\$BOOM,"), "boombox_ascii"),
        "vectornav_text": Signature("VectorNav's text output", _lines(rb"\$VN")),
        "nmea": Signature("NMEA 0183", _lines(rb"\$[A-Z]{2}[A-Z]{3},"), "nmea"),
        "mavlink": Signature("MAVLink", _mavlink),
        "slcan": Signature("a CAN adapter that speaks slcan", _slcan),
        "msp": Signature("an iNav angle-of-attack sensor's MSP", _readings("msp"), "msp"),
        "msp_other": Signature("MSP, as of Betaflight and iNav", _msp),
        "lines": Signature("lines of numbers", _numbers, "lines"),
    }
)
"""In order of how sure they are of themselves."""

_TO_WRITE: Final = {
    "mavlink": 'link = "mavlink", url = the port',
    "slcan": 'link = "can" or "dronecan", interface = "slcan", channel = the port',
    "vectornav_text": 'switch on a binary output in the device, protocol = "vectornav"',
    "msp_other": "set the port to MAVLink telemetry in the flight controller",
}


def recognised(data: bytes) -> str:
    """The row of SIGNATURES that these bytes show; empty if none."""
    return next((name for name, row in SIGNATURES.items() if row.count(data) >= ENOUGH), "")


def how_to_read(name: str) -> str:
    """What a rig writes for a row of SIGNATURES."""
    return _TO_WRITE.get(name) or f'protocol = "{SIGNATURES[name].protocol}"'


def shown_as_text(data: bytes) -> str:
    """A whole line of bytes that are text; empty if they are not."""
    lines = [line.strip() for line in data.split(b"\n")[1:-1] if line.strip()]
    printable = sum(byte in b"\t\r\n" or 32 <= byte < 127 for byte in data)
    if not lines or printable < _PRINTABLE_SHARE * len(data):
        return ""
    return lines[-1].decode("ascii", "replace")[:_LONGEST_SHOWN]


class Unread:
    """What has come over a link of which nothing could be read yet, until it says what it is."""

    def __init__(self, expected: str, baud: int | None) -> None:
        """`expected`: the protocol that the rig says. `baud`: of a serial line."""
        self._expected = expected
        self._baud = baud
        self._data = bytearray()
        self._next_look = FIRST_LOOK

    def take(self, block: bytes) -> str:
        """What to say of the bytes so far, once; empty mostly."""
        if len(self._data) >= LAST_LOOK:
            return ""
        self._data += block[: LAST_LOOK - len(self._data)]
        if len(self._data) < self._next_look:
            return ""
        self._next_look *= 2
        is_last = len(self._data) >= LAST_LOOK
        data = bytes(self._data)
        name = recognised(data)
        if name == self._expected or (not name and not is_last):
            return self._no_messages(name) if is_last else ""
        self._data += bytes(LAST_LOOK - len(self._data))  # said: no more of it
        if name:
            return f"this looks like {SIGNATURES[name].words}, the rig says {self._expected}: {how_to_read(name)}"
        if text := shown_as_text(data):
            return f"lines of text that are not {self._expected}: {text!r}"
        rate = f" ({self._baud} baud in the rig)" if self._baud else ""
        return f"nothing of {self._expected} nor of any protocol that the station knows: is the speed right{rate}?"

    def _no_messages(self, name: str) -> str:
        return f"{SIGNATURES[name].words} is heard, but none of the messages that are read of it"


def unread(device: Device) -> Unread | None:
    """Of a line whose bytes tell by themselves what they are: a bus's frames do not."""
    match device:
        case SerialDevice():
            return Unread(device.protocol, device.baud or protocol_named(device.protocol).baud)
        case MavlinkDevice():
            return Unread("mavlink", device.baud if device.url.startswith("/") else None)
        case _:
            return None
