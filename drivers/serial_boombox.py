"""The boom box: vanes, pots and whatever else it digitises, as binary packets or as text lines.

Binary, little-endian: COBS( id u8, seq u8, t_us u32, n x int16, crc u16 ) then a zero byte. The CRC is CRC-16/IBM-3740
(polynomial 0x1021, initial value 0xFFFF) over everything before it. Text: `$BOOM,id,seq,t_us,v0,v1,...*HH` CR LF with
the same meaning and the NMEA checksum.

`id` is the rig's message; the fields are "v0", "v1", ... in counts, which the rig's channels turn into signals. `seq`
counts the packets of one id. `t_us` is the box's microsecond counter, which wraps after 71.6 min. The count -32768 (an
empty field in a text line) means that the box has no reading, -32767 and 32767 that it is beyond what a count carries.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from typing import Final

from cobs import cobs
from fastcrc import crc16

from drivers.codec import Reading
from drivers.framing import CutCodec, open_line, seal_line
from drivers.protocols import Protocol

WRAP_US: Final = 2**32
WRAP_NS: Final = WRAP_US * 1000
SEQ_WRAP: Final = 256
NO_READING: Final = -32768
_MOST: Final = 32767
FIELDS: Final = tuple(f"v{i}" for i in range(120))
"""What a rig may name."""
_HEADER: Final = struct.Struct("<BBI")
_CRC: Final = struct.Struct("<H")
_LONGEST_PACKET: Final = 256
_LAYOUTS: Final = {8 + 2 * n: struct.Struct(f"<BBI{n}hH") for n in range(_LONGEST_PACKET // 2 - 3)}
"""Of a whole packet, by its length."""
_LONGEST_LINE: Final = 1024


class BoomboxCodec(CutCodec):
    """Binary packets to readings."""

    def __init__(self) -> None:
        super().__init__(b"\x00", _LONGEST_PACKET, _read_packet)


def _read_packet(piece: bytes) -> Sequence[Reading] | None:
    if not piece:  # two delimiters running: a sender's way to start afresh
        return ()
    try:
        packet = cobs.decode(piece)
    except cobs.DecodeError:
        return None
    layout = _LAYOUTS.get(len(packet))
    if layout is None:
        return None
    message, seq, t_us, *counts, crc = layout.unpack(packet)
    if crc16.ibm_3740(packet[:-2]) != crc:
        return None
    if counts and (min(counts) <= -_MOST or max(counts) >= _MOST):
        counts = [_value(count) for count in counts]
    return (_reading(message, seq, t_us, counts),)


def _value(count: float) -> float:
    """A count as a field: NaN for no reading, infinite at the ends."""
    if count == NO_READING:
        return math.nan
    return math.copysign(math.inf, count) if abs(count) == _MOST else float(count)


def _reading(message: int, seq: int, t_us: int, counts: Sequence[float]) -> Reading:
    return Reading(message, t_us * 1000, seq, dict(zip(FIELDS, counts, strict=False)), WRAP_NS, SEQ_WRAP)


class BoomboxAsciiCodec(CutCodec):
    """Text lines to readings. Other sealed lines (a banner, another talker) are passed over."""

    def __init__(self) -> None:
        super().__init__(b"\n", _LONGEST_LINE, _read_line)


def _read_line(line: bytes) -> Sequence[Reading] | None:
    body = open_line(line)
    if body is None:
        return None
    if body.split(",", 1)[0] != "BOOM":
        return ()
    try:
        _, message, seq, t_us, *texts = body.split(",")
        numbers = int(message), int(seq), int(t_us)
        counts = [float(text) if text else math.nan for text in texts]
    except ValueError:
        return None
    if not all(0 <= n < limit for n, limit in zip(numbers, (256, SEQ_WRAP, WRAP_US), strict=True)):
        return None
    return (_reading(*numbers, [_value(count) for count in counts]),)


def encode_packet(message: int, seq: int, t_us: int, counts: Sequence[float]) -> bytes:
    """A binary packet with its delimiter. Counts are rounded and held within +-32767; NaN is sent as no reading.

    `seq` and `t_us` are taken modulo their widths.
    """
    body = _HEADER.pack(message, seq % SEQ_WRAP, t_us % WRAP_US)
    body += struct.pack(f"<{len(counts)}h", *(_int16(count) for count in counts))
    encoded: bytes = cobs.encode(body + _CRC.pack(crc16.ibm_3740(body)))
    return encoded + b"\x00"


def encode_line(message: int, seq: int, t_us: int, counts: Sequence[float]) -> bytes:
    """The same as a text line."""
    texts = ("" if math.isnan(count) else str(_int16(count)) for count in counts)
    return seal_line(",".join(("BOOM", str(message), str(seq % SEQ_WRAP), str(t_us % WRAP_US), *texts)))


def _int16(count: float) -> int:
    if math.isnan(count):
        return NO_READING
    return round(min(max(count, -_MOST), _MOST))


def _encoder(encode: Callable[[int, int, int, Sequence[float]], bytes]) -> Callable[[Reading], bytes]:
    """Packets of readings: as many counts as the last field that the rig maps, no reading for those it does not."""

    def box(reading: Reading) -> bytes:
        highest = max(int(name[1:]) for name in reading.fields)
        counts = [reading.fields.get(name, math.nan) for name in FIELDS[: highest + 1]]
        return encode(int(reading.message), reading.seq or 0, (reading.t_device_ns or 0) // 1000, counts)

    return box


_MESSAGES: Final[dict[str | int, Sequence[str]]] = dict.fromkeys(range(256), FIELDS)
BOOMBOX: Final = Protocol(
    "the boom box's binary packets: COBS, CRC-16, counts of 16 bits",
    BoomboxCodec,
    _MESSAGES,
    _encoder(encode_packet),
    messages="a packet id, 0 to 255",
)
BOOMBOX_ASCII: Final = Protocol(
    "the boom box's text lines: `$BOOM,id,seq,t_us,v0,v1,...*HH`",
    BoomboxAsciiCodec,
    _MESSAGES,
    _encoder(encode_line),
    messages="a packet id, 0 to 255",
)
