"""Cutting a byte stream at a delimiter, and the checksum of NMEA-style text lines. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from operator import xor

from drivers.codec import Codec, Reading, TimeReply


class Cutter:
    """Pieces of a stream between delimiters; the result does not depend on how the stream arrives.

    A piece longer than `limit` without a delimiter is handed out in limit-sized parts, so that noise cannot fill the
    memory and is seen (and refused) at once.
    """

    def __init__(self, delimiter: bytes, limit: int) -> None:
        self._delimiter = delimiter
        self._limit = limit
        self._rest = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        rest = self._rest
        rest += data
        pieces = []
        start = 0
        while True:
            end = rest.find(self._delimiter, start)
            if 0 <= end <= start + self._limit:
                pieces.append(bytes(rest[start:end]))
                start = end + 1
            elif len(rest) - start > self._limit:
                pieces.append(bytes(rest[start : start + self._limit]))
                start += self._limit
            else:
                break
        del rest[:start]
        return pieces

    def reset(self) -> None:
        self._rest.clear()


class CutCodec(Codec):
    """Readings from the pieces between delimiters."""

    def __init__(
        self, delimiter: bytes, limit: int, read: Callable[[bytes], Sequence[Reading] | None], whole: bool = True
    ) -> None:
        """`read`: the readings of a piece, none if it is to be passed over; None if it is bad. Not `whole`: the first
        piece is passed over, as its beginning may be missing and no checksum would tell."""
        self.bad = 0
        self.resyncs = 0
        self.noise = 0
        self._cutter = Cutter(delimiter, limit)
        self._limit = limit
        self._read = read
        self._is_whole = self._from_start = whole

    def feed(self, data: bytes) -> list[Reading | TimeReply]:
        readings: list[Reading | TimeReply] = []
        for piece in self._cutter.feed(data):
            was_whole, self._is_whole = self._is_whole, True
            if not was_whole and len(piece) < self._limit:
                continue
            found = self._read(piece)
            if found is None:
                self.bad += 1
                self.noise += len(piece) + 1
            else:
                readings += found
        return readings

    def reset(self) -> None:
        self._cutter.reset()
        self._is_whole = self._from_start


def seal_line(body: str) -> bytes:
    """`$body*HH` and CR LF, HH the exclusive or of the body's bytes (NMEA 0183)."""
    return f"${body}*{reduce(xor, body.encode('ascii'), 0):02X}\r\n".encode("ascii")


def open_line(line: bytes) -> str | None:
    """The body of a `$body*HH` line without its line feed; None if it is no such line or its checksum is wrong."""
    line = line.strip(b"\r ")
    if len(line) < 5 or line[:1] != b"$" or line[-3:-2] != b"*":
        return None
    body = line[1:-3]
    if f"{reduce(xor, body, 0):02X}".encode() != line[-2:].upper():
        return None
    try:
        return body.decode("ascii")
    except UnicodeDecodeError:
        return None
