"""The index at the end of a complete file: where its chunks are, and which messages each holds.

By it a minute of an hour is read in the time of a minute, and one kind of rows without the others. A file that is cut
has none; one whose checksum does not fit is not read by it, since the lists of messages have none of their own. Such
files are read from their beginning (scan.py).
"""

from __future__ import annotations

import mmap
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from station.log.part import MAGIC, RECORD

FOOTER: Final = struct.Struct("<QQI")
_INDEX_HEAD: Final = struct.Struct("<4QI")
_DATA_END: Final = struct.Struct("<BQI")
_PLACE: Final = np.dtype([("channel", "<u2"), ("at", "<u8")])
_ENTRY: Final = np.dtype([("t_ns", "<u8"), ("at", "<u8")])
_LIST: Final = struct.Struct("<HI")
WRONG: Final = (struct.error, ValueError, OverflowError)
"""What a place or a length that is made wrong ends in, in a file whose checksum fits."""
_PIECE: Final = 1 << 25
"""Of a file that is in memory at once, where all of it is read."""


class ChunkPlace(NamedTuple):
    """A chunk's first and last time (ns), where its record begins and how long it is, and the file's bytes that say
    where the list of each channel's messages is."""

    first_ns: int
    last_ns: int
    at: int
    length: int
    lists: bytes


@dataclass(frozen=True, slots=True)
class Index:
    """Of one file: its `chunks` in their order, and the contents of its channel records."""

    chunks: list[ChunkPlace] = field(default_factory=list)
    channels: list[bytes] = field(default_factory=list)
    metadata: dict[str, tuple[int, int]] = field(default_factory=dict)
    """Place and length of metadata records, by name; the last of a name."""


class End(NamedTuple):
    """What the end of a file says: where the index begins, where the data end and their checksum, 0 if not stated."""

    index_at: int
    data_end: int
    crc: int


def read_end(data: Any, size: int) -> End | None:
    """The end of a file of `size` bytes; None where it is cut or wrong."""
    at = size - len(MAGIC) - FOOTER.size
    if at - RECORD.size < len(MAGIC) or data[size - len(MAGIC) : size] != MAGIC:
        return None
    kind, length = RECORD.unpack_from(data, at - RECORD.size)
    summary, _, crc = FOOTER.unpack_from(data, at)
    if kind != Opcode.FOOTER or length != FOOTER.size or not _DATA_END.size < summary <= at - RECORD.size or not crc:
        return None
    if crc != checksum(data, summary, at + FOOTER.size - 4):
        return None
    data_end = summary - _DATA_END.size
    kind, length, stated = _DATA_END.unpack_from(data, data_end)
    return End(summary, data_end, stated) if (kind, length) == (Opcode.DATA_END, 4) else None


_sound: Final[dict[tuple[int, ...], bool]] = {}
"""Whether the checksum of a file fits, by its device, number, size and time of last change: half a second an hour."""


def is_sound(data: Any, file: os.stat_result) -> bool:
    """Whether a file is complete and has the checksum that it states."""
    key = file.st_dev, file.st_ino, file.st_size, file.st_mtime_ns
    if key not in _sound:
        end = read_end(data, file.st_size)
        _sound[key] = end is not None and end.crc != 0 and end.crc == checksum(data, 0, end.data_end)
    return _sound[key]


def read_index(data: Any, file: os.stat_result) -> Index | None:
    """The index of a file; None where it is not sound."""
    size = file.st_size
    end = read_end(data, size) if is_sound(data, file) else None
    if end is None:
        return None
    found = Index()
    at = end.index_at
    while at + RECORD.size <= size:
        kind, length = RECORD.unpack_from(data, at)
        start, at = at + RECORD.size, at + RECORD.size + length
        if kind == Opcode.CHUNK_INDEX:
            first, last, place, size_of_it, lists = _INDEX_HEAD.unpack_from(data, start)
            begin = start + _INDEX_HEAD.size
            found.chunks.append(ChunkPlace(first, last, place, size_of_it, data[begin : begin + lists]))
        elif kind == Opcode.CHANNEL:
            found.channels.append(data[start:at])
        elif kind == Opcode.METADATA_INDEX:
            place, size_of_it, letters = struct.unpack_from("<QQI", data, start)
            name = data[start + 20 : start + 20 + letters].decode(errors="replace")
            found.metadata[name] = place, size_of_it
        elif kind == Opcode.FOOTER:
            break
    return found


def entries(
    data: Any, chunk: ChunkPlace, wanted: frozenset[int], first_ns: int, last_ns: int
) -> Iterator[tuple[int, int]]:
    """Channel and place within the chunk's body of each message of the `wanted` channels from `first_ns` to `last_ns`,
    in the order they were written."""
    found: list[tuple[int, int]] = []
    for channel, at in np.frombuffer(chunk.lists, _PLACE).tolist():
        if channel in wanted:
            found += [(place, channel) for place in _listed(data, at, first_ns, last_ns)["at"].tolist()]
    for place, channel in sorted(found):
        yield channel, place


def times(data: Any, index: Index, wanted: frozenset[int]) -> NDArray[np.int64]:
    """Of all messages of the `wanted` channels, ns, chunk by chunk; no message is read."""
    found = [np.zeros(0, dtype=np.uint64)]
    kept_from = 0
    for chunk in index.chunks:
        if chunk.at - kept_from > _PIECE:
            let_go(data)
            kept_from = chunk.at
        for channel, at in np.frombuffer(chunk.lists, _PLACE).tolist():
            if channel in wanted:
                found.append(_listed(data, at, chunk.first_ns, chunk.last_ns)["t_ns"])
    return shown(np.concatenate(found))


def shown(times: NDArray[np.uint64] | list[int]) -> NDArray[np.int64]:
    """Those that a clock may show; beyond 2**63 ns, or 292 years, bytes are wrong."""
    every = np.asarray(times, dtype=np.uint64)
    return every[every < 2**63].astype(np.int64)


def _listed(data: Any, at: int, first_ns: int, last_ns: int) -> NDArray[Any]:
    """The list of a channel's messages at this place of the file, as far as they are within the times."""
    kind, _ = RECORD.unpack_from(data, at)
    _, length = _LIST.unpack_from(data, at + RECORD.size)
    if kind != Opcode.MESSAGE_INDEX:
        return np.zeros(0, _ENTRY)
    begin = at + RECORD.size + _LIST.size
    listed = np.frombuffer(data[begin : begin + length], _ENTRY)
    return listed[(listed["t_ns"] >= first_ns) & (listed["t_ns"] <= last_ns)]


def checksum(data: Any, start: int, end: int) -> int:
    crc = 0
    for at in range(start, end, _PIECE):
        with memoryview(data) as view, view[at : min(at + _PIECE, end)] as part:
            crc = zlib.crc32(part, crc)
        let_go(data)
    return crc


def let_go(data: Any) -> None:
    """What of a mapped file has been read need not stay in this process's memory: the system keeps it while it can."""
    if hasattr(data, "madvise"):
        data.madvise(mmap.MADV_DONTNEED)


def string_of(data: bytes) -> tuple[str, bytes]:
    """A record's string, and what follows it. Raises struct.error."""
    text, at = _string_at(data, 0)
    return text, data[at:]


def mapping_of(data: bytes) -> dict[str, str]:
    """A record's map of strings. Raises struct.error."""
    (length,) = struct.unpack_from("<I", data)
    at, end, found = 4, min(4 + length, len(data)), dict[str, str]()
    while at < end:
        key, at = _string_at(data, at)
        found[key], at = _string_at(data, at)
    return found


def _string_at(data: bytes, at: int) -> tuple[str, int]:
    """The string there, and where it ends."""
    (length,) = struct.unpack_from("<I", data, at)
    end = at + 4 + length
    if end > len(data):
        raise struct.error("a string runs past its record")
    return data[at + 4 : end].decode(), end
