"""Writing one MCAP file, its chunks closed by size or by time.

Done here rather than with the mcap package's Writer because that one closes a chunk by size only: at a low data rate a
killed station would lose seconds. Its record types are used for all but messages and chunks, and its readers check the
result in the tests. Format: mcap.dev/spec.
"""

from __future__ import annotations

import contextlib
import os
import struct
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Final

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from station.log.disk import Disk
from station.log.spill import Spill

MAGIC: Final = bytes((137, 77, 67, 65, 80, 48, 13, 10))
RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<BQHIQQ")
_OPCODE: Final = int(Opcode.MESSAGE)
_NEVER: Final = 2**64 - 1
CHUNK = struct.Struct("<QQQI")
CHUNK_MARK = struct.pack("<I", 4) + b"zstd"
_INDEX = struct.Struct("<BQHI")
_CHUNK_INDEX = struct.Struct("<BQ4QI")
"""Opcode, length, first and last time, place, length of the chunk; bytes of the places that follow."""
_CHUNK_INDEX_END = struct.Struct("<Q8s2Q")
"""Length of the message indexes, compression, packed and full size."""


@dataclass(frozen=True, slots=True, eq=False)
class Topic:
    """A channel and its schema, before either has a number in a file. Compared by identity: one object a channel."""

    name: str
    encoding: str
    schema_name: str
    schema: bytes
    about: Mapping[str, str]


class _Channel:
    """A topic's number in a file, and time and place of its messages in the open chunk, alternately."""

    __slots__ = ("index", "number")

    def __init__(self, number: int) -> None:
        self.number = number
        self.index: list[int] = []


class PartWriter:
    """A file being written. Every method may raise OSError; after that only `abandon` is allowed.

    What it says of itself stands at its start, and a second time behind the first chunk. The file is created
    exclusively (FileExistsError). Each chunk goes to the operating system in one write, together with the channels it
    needs, so that a kill leaves whole chunks. `closing` gives the metadata that it ends with, by name.
    """

    def __init__(
        self,
        path: Path,
        disk: Disk,
        metadata: Mapping[str, Mapping[str, str]],
        attachments: Mapping[str, bytes],
        closing: Callable[[], Mapping[str, Mapping[str, str]]] = dict,
    ) -> None:
        self.path = path
        self._closing = closing
        self._disk = disk
        self._is_entered = self._is_closed = False
        self.size = 0
        self.chunk_size = 0
        self._crc = 0
        self._channels: dict[Topic, _Channel] = {}
        self._open: list[_Channel] = []
        self._records: list[McapRecord] = []
        self._head = RecordBuilder()
        self._body: list[bytes] = []
        self._first = self._last = 0
        self._compress = zstandard.ZstdCompressor(level=1).compress
        # As the summary will hold them: made at the end, an hour's would take a second; held, they would be 20 MiB.
        self._chunk_indexes = Spill(path.parent)
        self._chunk_count = 0
        self._other_indexes: list[McapRecord] = []
        self._counts: dict[int, int] = {}
        self._start = self._end = 0
        self._file = disk.create(path)
        try:
            self._preamble(metadata, attachments)
        except OSError:
            self.abandon()
            path.unlink(missing_ok=True)
            raise

    def _preamble(self, metadata: Mapping[str, Mapping[str, str]], attachments: Mapping[str, bytes]) -> None:
        out = RecordBuilder()
        out.write(MAGIC)
        Header("", "flight-test-station").write(out)
        begin = out.count
        for name, data in metadata.items():
            at = out.count
            Metadata(name=name, metadata=dict(data)).write(out)
            self._other_indexes.append(MetadataIndex(offset=at, length=out.count - at, name=name))
        for name, blob in attachments.items():
            at = out.count
            kind = "application/json" if name.endswith(".json") else "application/octet-stream"
            Attachment(create_time=0, log_time=0, name=name, media_type=kind, data=blob).write(out)
            self._other_indexes.append(
                AttachmentIndex(at, out.count - at, 0, 0, data_size=len(blob), name=name, media_type=kind)
            )
        head = _taken(out)
        self._write(head)
        self._begin, self._profiles = begin, head[begin:]

    def _profiles_again(self, at: int) -> bytes:
        """What a recording says of itself, a second time at this place: one wrong byte costs no flight its profiles."""
        moved: list[McapRecord] = []
        for index in self._other_indexes:
            assert isinstance(index, MetadataIndex | AttachmentIndex)
            moved.append(replace(index, offset=index.offset + at - self._begin))
        self._other_indexes += moved
        return self._profiles

    @property
    def messages(self) -> int:
        """How many have been handed to the operating system."""
        return sum(self._counts.values())

    def add(self, messages: Iterable[tuple[Topic, int, int, bytes]]) -> None:
        """Add topic, sequence number, time (ns) and data of each to the chunk in memory.

        Nothing reaches the file before `close_chunk`.
        """
        channels, body, at = self._channels, self._body, self.chunk_size
        first, last = (self._first, self._last) if self._open else (_NEVER, 0)
        for topic, sequence, time_ns, data in messages:
            channel = channels.get(topic)
            if channel is None:
                channel, again = self._register(topic)
                body.append(again)
                at += len(again)
            if time_ns < first:
                first = time_ns
            if time_ns > last:
                last = time_ns
            if not channel.index:
                self._open.append(channel)
            channel.index += (time_ns, at)
            length = len(data)
            head = _MESSAGE.pack(_OPCODE, 22 + length, channel.number, sequence & 0xFFFFFFFF, time_ns, time_ns)
            body += (head, data)
            at += _MESSAGE.size + length
        self._first, self._last, self.chunk_size = first, last, at

    def _register(self, topic: Topic) -> tuple[_Channel, bytes]:
        """A new channel, and its record as the chunk must hold it."""
        number = len(self._channels) + 1
        self._channels[topic] = _Channel(number)
        schema = number if topic.schema_name else 0
        if schema:
            self._records.append(Schema(id=schema, data=topic.schema, encoding="jsonschema", name=topic.schema_name))
            self._records[-1].write(self._head)
        channel = Channel(number, topic.name, topic.encoding, metadata=dict(topic.about), schema_id=schema)
        self._records.append(channel)
        # Twice: before the chunk, where it outlives a damaged chunk, and within, where the checksum vouches for it.
        again = RecordBuilder()
        for out in (self._head, again):
            channel.write(out)
        return self._channels[topic], _taken(again)

    def close_chunk(self) -> None:
        """Hand what is in memory to the operating system."""
        if not self._body:
            return
        body = b"".join(self._body)
        packed = self._compress(body)
        head = _taken(self._head)
        length = CHUNK.size + len(CHUNK_MARK) + 8 + len(packed)
        out = [
            head,
            RECORD.pack(Opcode.CHUNK, length),
            CHUNK.pack(self._first, self._last, len(body), zlib.crc32(body)),
            CHUNK_MARK,
            struct.pack("<Q", len(packed)),
            packed,
        ]
        at = self.size + len(head)
        begin = index_at = at + RECORD.size + length
        places: list[int] = []
        for channel in self._open:
            entries = channel.index
            size = 8 * len(entries)
            out.append(_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + size, channel.number, size))
            out.append(struct.pack(f"<{len(entries)}Q", *entries))
            places += (channel.number, index_at)
            index_at += _INDEX.size + size
        if self._chunk_count == 0:
            out.append(self._profiles_again(index_at))
        self._write(b"".join(out))
        mapped = struct.pack("<" + "HQ" * len(self._open), *places)
        rest = _CHUNK_INDEX.size - RECORD.size + len(mapped) + _CHUNK_INDEX_END.size
        self._chunk_indexes.add(
            b"".join(
                (
                    _CHUNK_INDEX.pack(
                        Opcode.CHUNK_INDEX, rest, self._first, self._last, at, RECORD.size + length, len(mapped)
                    ),
                    mapped,
                    _CHUNK_INDEX_END.pack(index_at - begin, CHUNK_MARK, len(packed), len(body)),
                )
            )
        )
        self._chunk_count += 1
        self._start = min(self._start, self._first) if self._counts else self._first
        self._end = max(self._end, self._last)
        for channel in self._open:
            self._counts[channel.number] = self._counts.get(channel.number, 0) + len(channel.index) // 2
            channel.index.clear()
        self._body.clear()
        self._open.clear()
        self.chunk_size = 0

    def sync(self) -> None:
        """Return when all written so far, and the file's name in its folder, outlast a power cut.

        May be called from another thread than the one that writes; does nothing once the file is closed.
        """
        try:
            if not self._is_closed:
                self._disk.sync(self._file)
            if not self._is_entered:
                self._disk.sync_folder(self.path.parent)
                self._is_entered = True
        except OSError:
            if not self._is_closed:
                raise

    def finish(self, *, sync: bool = False) -> None:
        """Close the last chunk, write the index, `sync` if asked to, and close the file: it is complete."""
        self.close_chunk()
        end = RecordBuilder()
        for name, data in self._closing().items():
            Metadata(name=name, metadata=dict(data)).write(end)
            record = _taken(end)
            self._other_indexes.append(MetadataIndex(offset=self.size, length=len(record), name=name))
            self._write(record)
        DataEnd(self._crc).write(end)
        self._write(_taken(end))
        summary_at = self.size
        counted = Statistics(
            attachment_count=sum(isinstance(r, AttachmentIndex) for r in self._other_indexes),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=self._chunk_count,
            message_count=sum(self._counts.values()),
            message_end_time=self._end,
            message_start_time=self._start,
            metadata_count=sum(isinstance(r, MetadataIndex) for r in self._other_indexes),
            schema_count=sum(isinstance(r, Schema) for r in self._records),
        )
        summary: list[Iterable[bytes]] = []
        groups = RecordBuilder()
        at = summary_at
        for opcode, group in (
            (Opcode.SCHEMA, _written(self._records, Schema)),
            (Opcode.CHANNEL, _written(self._records, Channel)),
            (Opcode.STATISTICS, _written([counted], Statistics)),
            (Opcode.CHUNK_INDEX, self._chunk_indexes),
            (Opcode.ATTACHMENT_INDEX, _written(self._other_indexes, AttachmentIndex)),
            (Opcode.METADATA_INDEX, _written(self._other_indexes, MetadataIndex)),
        ):
            if group:
                SummaryOffset(opcode, at, len(group)).write(groups)
                summary.append(group.pieces() if isinstance(group, Spill) else [group])
                at += len(group)
        crc = 0
        for piece in chain(*summary, [_taken(groups)]):
            crc = zlib.crc32(piece, crc)
            self._write(piece)
        crc = zlib.crc32(struct.pack("<BQQQ", Opcode.FOOTER, 20, summary_at, at), crc)
        Footer(summary_at, at, crc).write(end)
        self._write(_taken(end) + MAGIC)
        if sync:
            self.sync()
        self._close()

    def abandon(self) -> None:
        """Close the file as it is."""
        self._close()

    def _close(self) -> None:
        self._is_closed = True
        self._chunk_indexes.close()
        self._disk.close(self._file)

    def is_there(self) -> bool:
        """Whether the path still leads to this file: the folder may have been removed or renamed."""
        try:
            at_path = os.stat(self.path)
        except OSError:
            return False
        ours = os.fstat(self._file)
        return (at_path.st_ino, at_path.st_dev) == (ours.st_ino, ours.st_dev)

    def is_gone(self) -> bool:
        """Whether it has been removed, as far as the system can tell."""
        try:
            return not self.is_there() and not self.is_linked()
        except OSError:
            return False

    def is_linked(self) -> bool:
        """Whether any path leads to this file."""
        return os.fstat(self._file).st_nlink > 0

    def _write(self, data: bytes) -> None:
        done = 0
        try:
            while done < len(data):
                done += self._disk.write(self._file, memoryview(data)[done:])
        except OSError:
            # The disk took a part of it: cut back to the last whole record, if that still can be done.
            with contextlib.suppress(OSError):
                self._disk.cut(self._file, self.size)
            raise
        self._crc = zlib.crc32(data, self._crc)
        self.size += done


def _taken(records: RecordBuilder) -> bytes:
    built: bytes = records.end()  # type: ignore[no-untyped-call]
    return built


def _written(records: Iterable[McapRecord], kind: type[McapRecord]) -> bytes:
    """Those of one kind."""
    out = RecordBuilder()
    for record in records:
        if isinstance(record, kind):
            record.write(out)
    return _taken(out)
