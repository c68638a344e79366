"""CAN frames as they travel through the adapter and into the log: slcan text lines, whatever interface they came from.

`tIIILDD..` or `TIIIIIIIILDD..` and a carriage return, after the Lawicel adapter protocol: a bus has one form for every
codec that reads its frames.
"""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Sequence
from typing import Final

from drivers.codec import Codec, Reading, TimeReply
from drivers.framing import Cutter

_LONGEST_LINE: Final = 64
REFUSED_LINE: Final = b"\x07\r"
"""Stands for a frame or line that could not be read; the codec counts it."""
_CARRIES_NOTHING: Final = re.compile(rb"[zZ]?|(?:r[0-9A-Fa-f]{3}|R[0-9A-Fa-f]{8})[0-8](?:[0-9A-Fa-f]{4})?")
"""An adapter's acknowledgement, or a remote request."""


class FrameCodec(Codec):
    """slcan text lines to readings, frame by frame."""

    def __init__(self) -> None:
        self.bad = 0
        self.resyncs = self.noise = 0
        self._cutter = Cutter(b"\r", _LONGEST_LINE)

    def feed(self, data: bytes) -> list[Reading | TimeReply]:
        readings: list[Reading | TimeReply] = []
        for line in self._cutter.feed(data):
            if _CARRIES_NOTHING.fullmatch(line):
                continue
            frame = read_slcan(line)
            if frame is None:
                self.bad += 1
                self.noise += len(line) + 1
            else:
                readings += self.read_frame(*frame)
        return readings

    @abstractmethod
    def read_frame(self, frame_id: int, is_extended: bool, data: bytes) -> Sequence[Reading]:
        """What a frame completes; one that is damaged is counted, one of no interest passed over."""

    def reset(self) -> None:
        self._cutter.reset()


def read_slcan(line: bytes) -> tuple[int, bool, bytes] | None:
    """Identifier, whether extended, and data of a classic data frame's line without its end; None if it is none.

    A four-digit time stamp of the adapter after the data is allowed and ignored.
    """
    digits = {b"t": 3, b"T": 8}.get(line[:1])
    if digits is None or not line[1:].isalnum():
        return None
    try:
        frame_id, length = int(line[1 : 1 + digits], 16), int(line[1 + digits : 2 + digits], 16)
        data = bytes.fromhex(line[2 + digits :].decode("ascii"))
    except ValueError:
        return None
    if length > 8 or len(data) not in (length, length + 2) or frame_id >= 1 << (29 if digits == 8 else 11):
        return None
    return frame_id, digits == 8, data[:length]


def encode_slcan(frame_id: int, is_extended: bool, data: bytes) -> bytes:
    """A frame's slcan text line."""
    head = f"T{frame_id:08X}" if is_extended else f"t{frame_id:03X}"
    return f"{head}{len(data)}{data.hex().upper()}\r".encode("ascii")
