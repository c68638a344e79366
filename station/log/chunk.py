"""What is in a chunk of an MCAP file, if it is sound."""

from __future__ import annotations

import struct
import zlib
from typing import Any, Final

import zstandard

from station.log.index import string_of
from station.log.part import CHUNK

_LARGEST: Final = 1 << 26
"""The station closes a chunk at 32 KiB and a tick, others at some MiB: larger ones are not worth the memory."""


def body_of(data: Any, start: int, end: int) -> bytes | str:
    """Records of the chunk whose content stands from `start` to `end` of `data`, or what is wrong with it."""
    if end - start < CHUNK.size + 12:
        return "a chunk is too short"
    _, _, size, crc = CHUNK.unpack_from(data, start)
    try:
        name, _ = string_of(data[start + CHUNK.size : min(end, start + CHUNK.size + 64)])
    except (struct.error, UnicodeDecodeError):
        return "a chunk's compression has no name"
    at = start + CHUNK.size + 4 + len(name)
    if at + 8 > end:
        return "a chunk is too short"
    (length,) = struct.unpack_from("<Q", data, at)
    packed = data[at + 8 : end]
    if length != len(packed) or size > _LARGEST:
        return "a chunk's length does not fit"
    # What is packed says its size too, and would get the memory for that.
    if name == "zstd" and _unpacked_size(packed) not in (size, None):
        return "a chunk's size does not fit"
    if name not in ("", "zstd"):
        return f"a chunk is compressed with {name!r}, which the station does not write"
    try:
        body = packed if name == "" else zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    except zstandard.ZstdError:
        return "a chunk cannot be decompressed"
    return body if not crc or zlib.crc32(body) == crc else "a chunk's checksum does not fit"


def _unpacked_size(packed: bytes) -> int | None:
    """As zstd's frame states it; None where it does not."""
    try:
        size = int(zstandard.frame_content_size(packed))
    except zstandard.ZstdError:
        return None
    return None if size < 0 else size
