"""The packets of an IRIG 106 Chapter 10 (11) file, and the text of its setup record (TMATS).

Own reader: pychapter10 (last release 2023) wants a version of bitstruct that cantools refuses, and ends at the first
kind of packet that it does not know.
"""

from __future__ import annotations

import mmap
import re
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from station.rows import LogError

TICK_NS: Final = 100
"""The relative time counter runs at 10 MHz."""
SETUP, PCM, ANALOG = 0x01, 0x09, 0x21
"""Data types: setup record (TMATS), PCM format 1, analog format 1."""
KINDS: Final[Mapping[int, str]] = {
    0x00: "user defined", 0x01: "setup", 0x02: "events", 0x03: "index", 0x04: "streaming configuration",
    0x09: "PCM", 0x11: "time", 0x12: "network time", 0x19: "MIL-STD-1553", 0x1A: "16PP194", 0x21: "analog",
    0x29: "discrete", 0x30: "messages", 0x38: "ARINC 429", 0x40: "video", 0x41: "video", 0x42: "video",
    0x43: "video", 0x44: "video", 0x48: "images", 0x49: "images", 0x4A: "images", 0x50: "UART",
    0x58: "IEEE 1394", 0x59: "IEEE 1394", 0x60: "parallel", 0x68: "Ethernet", 0x69: "ARINC 664",
    0x70: "time and space", 0x71: "time and space", 0x78: "CAN", 0x79: "Fibre Channel", 0x7A: "Fibre Channel",
}  # fmt: skip
ABOUT_ITSELF: Final = frozenset({0x00, 0x01, 0x02, 0x03, 0x04, 0x11, 0x12})
"""What a recorder says of the recording; no measurement is in it."""

_SYNC: Final = b"\x25\xeb"
_HEADER: Final = struct.Struct("<HHIIBBBB6sH")
_SECONDARY_BYTES: Final = 12
_SECONDARY: Final = 0x80
_SECONDARY_TIMES: Final = 0x40
_CHECKSUM: Final = 0x03
_LONGEST: Final = 134_217_728
"""Of a setup record; other packets are at most 524288 bytes long (Chapter 11, 11.2.1)."""
_XML: Final = 0x200
_ATTRIBUTE: Final = re.compile(r"([^:;]+):([^;]*);")


class Packet(NamedTuple):
    channel: int
    kind: int
    ticks: int
    """Relative time of its first bit, 100 ns."""
    other_times: bool
    """Times within it are not the relative time counter's."""
    body: bytes
    """From the channel specific data word on."""


class Damage:
    """What was passed over."""

    __slots__ = ("bytes", "packets")

    def __init__(self) -> None:
        self.bytes = 0
        self.packets = 0


def packets(path: Path, damage: Damage) -> Iterator[Packet]:
    """All that are whole. Raises LogError for an empty file."""
    with path.open("rb") as file:
        if not path.stat().st_size:
            raise LogError(f"{path}: empty")
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield from _walk(data, damage)


def _walk(data: mmap.mmap, damage: Damage) -> Iterator[Packet]:
    at, end = 0, len(data)
    while (found := data.find(_SYNC, at)) >= 0 and found + _HEADER.size <= end:
        damage.bytes += found - at
        raw = data[found : found + _HEADER.size]
        _, channel, length, size, _, _, flags, kind, ticks, checksum = _HEADER.unpack(raw)
        head = _HEADER.size + (_SECONDARY_BYTES if flags & _SECONDARY else 0)
        # The header's checksum is the sum of its other 16-bit words.
        if sum(struct.unpack("<11H", raw[:-2])) & 0xFFFF != checksum or not head <= length <= _LONGEST + head:
            damage.bytes += 1
            at = found + 1
            continue
        if found + length > end or head + size > length:
            damage.packets += 1
            at = found + _HEADER.size
            continue
        at = found + length
        if not _whole(data[found + head : at], flags & _CHECKSUM):
            damage.packets += 1
            continue
        body = data[found + head : found + head + size]
        yield Packet(channel, kind, int.from_bytes(ticks, "little"), bool(flags & _SECONDARY_TIMES), body)
    damage.bytes += end - at


def _whole(content: bytes, form: int) -> bool:
    """Whether data, filler and the checksum behind them (8, 16 or 32 bits, or none) fit."""
    if not form:
        return True
    width = 2 ** (form - 1)
    words = np.frombuffer(content[: len(content) // width * width], dtype=f"<u{width}").astype(np.uint64)
    return len(words) > 0 and int(words[:-1].sum()) & (2 ** (8 * width) - 1) == int(words[-1])


def setup(path: Path) -> dict[str, str]:
    """The attributes of the setup record, names in capitals. Raises LogError where there is none, or it is XML."""
    text = b""
    for packet in packets(path, Damage()):
        if packet.kind == SETUP:
            (word,) = struct.unpack_from("<I", packet.body)
            if word & _XML:
                raise LogError(
                    f"{path}: its setup record (TMATS) is XML, and only the text form is read\n"
                    "have the recorder or the range's TMATS tool write it as text (CODE:value;)"
                )
            text += packet.body[4:]
        elif text:
            break
    found = {m[1].strip().upper(): m[2].strip() for m in _ATTRIBUTE.finditer(text.decode("latin-1"))}
    if not found:
        raise LogError(
            f"{path}: no setup record (TMATS): nothing says where in its channels which measurement is\n"
            "the first packet of a Chapter 10 file is the setup record: take the file as the recorder wrote it"
        )
    return found
