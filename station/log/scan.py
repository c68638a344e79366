"""Reading one MCAP file: every intact record in file order, however the file ends and whatever is wrong within it."""

from __future__ import annotations

import itertools
import json
import mmap
import os
import struct
import zlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel
from numpy.typing import NDArray

from station.log.chunk import body_of
from station.log.index import (
    FOOTER,
    WRONG,
    Index,
    checksum,
    entries,
    is_sound,
    let_go,
    mapping_of,
    read_index,
    shown,
    string_of,
)
from station.log.index import times as listed_times
from station.log.part import CHUNK, CHUNK_MARK, MAGIC, RECORD
from station.rows import LogError

CRC: Final = "crc32"
"""In metadata, the checksum of the rest of it: MCAP has none for metadata."""
_LET_GO: Final = 500
"""Chunks, of 32 KiB or less, that are read before their memory is given back."""
_PROFILES_AGAIN: Final = 2
"""Behind so many chunks what a recording says of itself has been read a second time."""


@dataclass(frozen=True, slots=True)
class Damage:
    """A place in a file that could not be read."""

    offset: int | None
    why: str
    lost_s: float | None
    """Seconds of recording in it; None if not known."""


@dataclass(slots=True)
class PartReader:
    """Everything intact in a file, in file order, however it ends.

    `messages` yields (channel, log time in ns, bytes) and fills the rest as it goes: after it is exhausted `verdict`
    holds. A record whose checksum is wrong is left out and noted; after a broken one reading goes on at the next chunk.
    """

    path: Path
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    damage: list[Damage] = field(default_factory=list)
    truncated_at: int | None = None
    tail_s: float | None = None
    """Seconds of recording in the chunk that the end of a truncated file cuts, if its head can be read."""
    doubtful: set[str] = field(default_factory=set)
    """Metadata and attachments whose checksum does not fit, and of which there is no second copy that does."""
    _last_ns: int | None = None
    _hurt: int | None = None

    @property
    def verdict(self) -> str:
        """complete, truncated (stops before its end) or damaged (bytes within it are wrong)."""
        return "damaged" if self.damage else "complete" if self.truncated_at is None else "truncated"

    def open(self) -> None:
        """Read the metadata and attachments at the start. Raises LogError if it is no MCAP file or cannot be read."""
        for _ in self._records(head_only=True):
            pass

    def open_again(self) -> None:
        """Read on to where what it says of itself stands a second time, and take that for what was hurt."""
        for number, _ in enumerate(self._records(head_only=False), 1):
            if number > _PROFILES_AGAIN:
                return

    def messages(self) -> Iterator[tuple[Channel, int, bytes]]:
        for kind, payload in self._anew():
            if kind == Opcode.CHUNK:
                yield from self._chunk_messages(payload)
            else:
                message = self._message(payload, 0, len(payload))
                if message is not None:
                    yield message

    def check(self) -> None:
        """Come to the verdict that `messages` does, and take no message apart."""
        for _ in self._anew():
            pass

    def _anew(self) -> Iterator[tuple[int, bytes]]:
        self.channels.clear()
        self.damage.clear()
        self.truncated_at = None
        return self._records(head_only=False)

    def select(self, kinds: Collection[str], first_ns: int, last_ns: int) -> Iterator[tuple[Channel, int, bytes]]:
        """The `messages` of these kinds of rows from `first_ns` to `last_ns`, by the file's index where it has one that
        is sound: the rest is then not read, and neither judged."""
        with self._mapped() as (data, file):
            index = read_index(data, file) if data is not None else None
            if index is not None:
                yield from self._selected(data, index, self._wanted(index, kinds), first_ns, last_ns)
                return
        for channel, time_ns, content in self.messages():
            if channel.metadata.get("row", "") in kinds and first_ns <= time_ns <= last_ns:
                yield channel, time_ns, content

    def times(self, kinds: Collection[str]) -> NDArray[np.int64]:
        """Log times (ns) of all messages of these kinds of rows, which are not read where the file has an index."""
        with self._mapped() as (data, file):
            index = read_index(data, file) if data is not None else None
            if index is not None:
                with suppress(*WRONG):
                    return listed_times(data, index, self._wanted(index, kinds))
        return shown([t for channel, t, _ in self.messages() if channel.metadata.get("row", "") in kinds])

    def is_sound(self) -> bool:
        """Whether the file is complete and its checksum fits: nothing of it needs to be taken apart to know that."""
        with self._mapped() as (data, file):
            return data is not None and is_sound(data, file)

    def metadata_at_end(self, name: str) -> dict[str, str] | None:
        """Metadata of a sound file, found by its index; None where it has none of that name."""
        with self._mapped() as (data, file):
            index = read_index(data, file) if data is not None else None
            if data is None or index is None or name not in index.metadata:
                return None
            at, length = index.metadata[name]
            try:
                found, rest = string_of(data[at + RECORD.size : at + length])
                content = mapping_of(rest)
            except (struct.error, UnicodeDecodeError):
                return None
            return content if found == name and content.pop(CRC, None) == seal(content) else None

    def _wanted(self, index: Index, kinds: Collection[str]) -> frozenset[int]:
        for content in index.channels:
            with suppress(struct.error, UnicodeDecodeError):
                self._channel(content)
        return frozenset(n for n, c in self.channels.items() if c.metadata.get("row", "") in kinds)

    def _selected(
        self, data: Any, index: Index, wanted: frozenset[int], first_ns: int, last_ns: int
    ) -> Iterator[tuple[Channel, int, bytes]]:
        for number, chunk in enumerate(index.chunks if wanted else ()):
            if not number % _LET_GO:
                let_go(data)
            if chunk.last_ns < first_ns or chunk.first_ns > last_ns:
                continue
            if chunk.at + chunk.length > len(data) or data[chunk.at] != Opcode.CHUNK:
                continue
            try:
                places = [at for _, at in entries(data, chunk, wanted, first_ns, last_ns)]
                is_listed = True
            except WRONG:
                places, is_listed = [], False
            body = body_of(data, chunk.at + RECORD.size, chunk.at + chunk.length) if places or not is_listed else ""
            if isinstance(body, str):
                continue
            try:
                found = [self._message_at(body, at) for at in places]
            except WRONG:
                is_listed = False
            all_of_it = found if is_listed else self._chunk_messages(body)
            yield from (m for m in all_of_it if m and m[0].id in wanted and first_ns <= m[1] <= last_ns)

    def _message_at(self, body: bytes, at: int) -> tuple[Channel, int, bytes] | None:
        _, length = RECORD.unpack_from(body, at)
        return self._message(body, at + RECORD.size, at + RECORD.size + length)

    @contextmanager
    def _mapped(self) -> Iterator[tuple[mmap.mmap | None, os.stat_result]]:
        """The file in memory, None where it is empty, and what the system says of it. Raises LogError."""
        try:
            with self.path.open("rb") as file:
                known = os.fstat(file.fileno())
                if known.st_size == 0:
                    yield None, known
                    return
                with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                    yield data, known
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read: {error.strerror or error}") from error

    def _message(self, data: bytes, at: int, end: int) -> tuple[Channel, int, bytes] | None:
        channel_id, _, time_ns, _ = struct.unpack_from("<HIQQ", data, at)
        channel = self.channels.get(channel_id)
        return None if channel is None else (channel, time_ns, data[at + 22 : end])

    def _chunk_messages(self, body: bytes) -> Iterator[tuple[Channel, int, bytes]]:
        at = 0
        while at + RECORD.size <= len(body):
            kind, length = RECORD.unpack_from(body, at)
            at += RECORD.size
            try:
                message = self._message(body, at, at + length) if kind == Opcode.MESSAGE else None
                if kind == Opcode.CHANNEL:
                    self._channel(body[at : at + length])
            except (struct.error, UnicodeDecodeError) as error:
                self.note(f"a record in a chunk cannot be taken apart: {error}")
                message = None
            if message is not None:
                yield message
            at += length

    def _records(self, head_only: bool) -> Iterator[tuple[int, bytes]]:
        """Top-level records that carry messages: (CHUNK, its body) or (MESSAGE, its content)."""
        with self._mapped() as (data, _):
            if data is None:
                self.truncated_at = 0
                return
            yield from self._walk(data, len(data), head_only)

    def _walk(self, data: Any, size: int, head_only: bool) -> Iterator[tuple[int, bytes]]:
        if data[: min(8, size)] != MAGIC[: min(8, size)]:
            if self._next_chunk(data, 0) is None:
                raise LogError(f"{self.path}: not an MCAP file\nimport other formats with: station import")
            self._hurts(0, "the first bytes are wrong", 0.0)
        at, before, ended = 8, 8, False
        for number in itertools.count():
            if not number % (_LET_GO * 10):
                let_go(data)
            if at + RECORD.size > size:
                self.truncated_at = min(at, size)
                return
            kind, length = RECORD.unpack_from(data, at)
            start, end = at + RECORD.size, at + RECORD.size + length
            problem = ""
            if end > size:
                problem = "a record runs past the end of the file"
            elif not Opcode.HEADER <= kind <= Opcode.DATA_END:
                problem = f"a record of unknown kind {kind}"
            if problem:
                # The record before may have led here by a wrong length.
                following = self._next_chunk(data, before + 1)
                if following is None and end > size and data[size - 8 : size] != MAGIC:
                    self.truncated_at = at
                    self.tail_s = self._span(data, at, size) if kind == Opcode.CHUNK else None
                    return
                self._hurts(at, problem, None)
                self._index_channels(data, size)
                if following is None:
                    return
                at = before = following
                continue
            if kind == Opcode.FOOTER:
                self._check_end(data, start, end, size)
                return
            if kind in (Opcode.CHUNK, Opcode.MESSAGE) and head_only:
                return
            if kind == Opcode.DATA_END and start + 4 <= size:
                (stated,) = struct.unpack_from("<I", data, start)
                ended = True
                if stated and not self.damage and stated != checksum(data, 0, at):
                    self._hurts(at, "the checksum of the whole file does not fit", 0.0)
            elif not ended:
                yield from self._read(data, kind, at, start, end)
            before, at = at, end

    def _read(self, data: Any, kind: int, at: int, start: int, end: int) -> Iterator[tuple[int, bytes]]:
        try:
            if kind == Opcode.CHUNK:
                body = body_of(data, start, end)
                if isinstance(body, str):
                    self._hurts(at, body, self._span(data, at, end))
                    return
                first, last = struct.unpack_from("<QQ", data, start)
                self._healed(first)
                self._last_ns = max(last, self._last_ns or 0)
                yield kind, body
            elif kind == Opcode.MESSAGE:
                yield kind, data[start:end]
            elif kind == Opcode.CHANNEL:
                self._channel(data[start:end])
            elif kind == Opcode.METADATA:
                name, rest = string_of(data[start:end])
                found = mapping_of(rest)
                stated = found.pop(CRC, None)
                if self._keeps(at, name, stated is None or stated == seal(found)):
                    self.metadata[name] = found
            elif kind == Opcode.ATTACHMENT:
                (crc,) = struct.unpack_from("<I", data, end - 4)
                name, rest = string_of(data[start + 16 : end - 4])
                if self._keeps(at, name, not crc or crc == zlib.crc32(data[start : end - 4])):
                    _, rest = string_of(rest)
                    self.attachments[name] = rest[8:]
        except (struct.error, UnicodeDecodeError, IndexError) as error:
            self._hurts(at, f"a record cannot be taken apart: {error}", None)

    def _keeps(self, at: int, name: str, is_sound: bool) -> bool:
        """Whether what is read is to be kept: what is hurt only until a sound copy comes, as it may be readable."""
        is_new = name not in self.metadata and name not in self.attachments
        if is_sound:
            self.doubtful.discard(name)
            return True
        self._hurts(at, f"the checksum of {name!r} does not fit", 0.0)
        if is_new:
            self.doubtful.add(name)
        return is_new

    def _channel(self, content: bytes) -> None:
        channel = _channel_of(content)
        self.channels[channel.id] = channel

    def _index_channels(self, data: Any, size: int) -> None:
        """Channels from the index at the end, for those whose own records are lost."""
        footer = size - len(MAGIC) - 20
        if data[size - len(MAGIC) : size] != MAGIC or footer < RECORD.size:
            return
        try:
            (at,) = struct.unpack_from("<Q", data, footer)
            while 0 < at < footer - RECORD.size:
                kind, length = RECORD.unpack_from(data, at)
                start, at = at + RECORD.size, at + RECORD.size + length
                if kind == Opcode.CHANNEL and struct.unpack_from("<H", data, start)[0] not in self.channels:
                    self._channel(data[start:at])
        except (struct.error, UnicodeDecodeError):
            return

    def _next_chunk(self, data: Any, at: int) -> int | None:
        """Where the next intact chunk starts."""
        found: int = data.find(CHUNK_MARK, at)
        while found >= 0:
            start = found - RECORD.size - CHUNK.size
            if start >= at and data[start] == Opcode.CHUNK:
                _, length = RECORD.unpack_from(data, start)
                end = start + RECORD.size + length
                if end <= len(data) and isinstance(body_of(data, start + RECORD.size, end), bytes):
                    return start
            found = data.find(CHUNK_MARK, found + 1)
        return None

    def note(self, why: str) -> None:
        """Add something wrong that was found in a message's content; the first of a kind only."""
        if all(d.why != why for d in self.damage):
            self.damage.append(Damage(None, why, 0.0))

    def _span(self, data: Any, at: int, end: int) -> float | None:
        """Seconds between the first and last message of a broken chunk, as far as its head can be believed."""
        if end - at < RECORD.size + 16:
            return None
        first, last = struct.unpack_from("<QQ", data, at + RECORD.size)
        believable = first <= last < first + 3600 * 10**9 and abs(first - (self._last_ns or first)) < 3600 * 10**9
        return (last - first) * 1e-9 if believable else None

    def _hurts(self, at: int, why: str, lost_s: float | None) -> None:
        self.damage.append(Damage(at, why, lost_s))
        if lost_s is None:
            self._hurt = len(self.damage) - 1

    def _healed(self, first_ns: int) -> None:
        """Where nothing else says so, what was lost is the time between the last row before and the first after."""
        if self._hurt is not None and self._last_ns is not None:
            hurt = self.damage[self._hurt]
            self.damage[self._hurt] = Damage(hurt.offset, hurt.why, max(0.0, (first_ns - self._last_ns) * 1e-9))
        self._hurt = None

    def _check_end(self, data: Any, start: int, end: int, size: int) -> None:
        if max(end, start + FOOTER.size) + len(MAGIC) > size:
            self.truncated_at = start
            return
        summary, _, crc = FOOTER.unpack_from(data, start)
        if data[end : end + 8] != MAGIC:
            self._hurts(end, "the last bytes are wrong", 0.0)
        elif crc and summary < start and crc != checksum(data, summary, end - 4) and not self.damage:
            self._hurts(start, "the checksum of the index does not fit", 0.0)


@lru_cache(maxsize=256)
def _channel_of(content: bytes) -> Channel:
    """Of a channel's record, which stands before each chunk that needs it, at the end, and in each file."""
    number, schema = struct.unpack_from("<HH", content)
    topic, rest = string_of(content[4:])
    encoding, rest = string_of(rest)
    return Channel(number, topic, encoding, metadata=mapping_of(rest), schema_id=schema)


def seal(metadata: Mapping[str, str]) -> str:
    """The checksum that metadata carry under CRC."""
    return f"{zlib.crc32(json.dumps(dict(metadata), sort_keys=True).encode()):08x}"
