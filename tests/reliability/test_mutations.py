"""Whatever comes in, a codec counts it and a reader refuses it or reads it; nothing raises, hangs or grows."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import pytest
import zstandard
from mcap.opcode import Opcode

from drivers.codec import Codec, Reading, TimeReply
from drivers.protocols import PROTOCOLS
from drivers.serial_boombox import BoomboxCodec
from station.log import read_rows, row_times, summarise
from station.log.part import CHUNK, RECORD
from station.rows import Event, Sample
from tests.reliability.counts import Flown
from tests.reliability.hurting import mutated
from tests.reliability.mutated_files import files, records_of, together
from tests.reliability.mutated_links import LINKS, Link, fly_link, links
from tests.reliability.mutations import NAMES, fly


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("inputs", [60, pytest.param(20_000, marks=pytest.mark.slow)])
def test_mutated_inputs(name: str, inputs: int) -> None:
    flown = fly(name, inputs, seconds=600.0)
    assert flown.is_sound, flown.words()
    assert flown.inputs == inputs
    assert flown.read < inputs


class Raising(Codec):
    """Trips over what the boom box's own counts as bad."""

    def __init__(self) -> None:
        self.bad = self.resyncs = 0
        self._codec = BoomboxCodec()

    def feed(self, data: bytes) -> list[Reading | TimeReply]:
        found = self._codec.feed(data)
        if self._codec.bad > self.bad:
            self.bad = self._codec.bad
            raise ValueError("bad")
        return found

    def reset(self) -> None:
        self._codec.reset()


def test_each_link_is_there() -> None:
    assert tuple(links()) == LINKS
    assert set(PROTOCOLS) < set(LINKS)


def test_a_codec_that_raises_is_seen() -> None:
    flown = Flown("raising")
    flight = fly_link("raising", Link(Raising, links()["boombox"].sound, mutated), flown, seed=1)
    for _ in range(50):
        next(flight)
    assert flown.raised > 10
    assert "ValueError: bad" in flown.first
    assert not flown.is_sound


@pytest.mark.parametrize("hurt", [Opcode.MESSAGE_INDEX, Opcode.CHUNK, Opcode.FOOTER])
def test_records_made_wrong_in_a_file_whose_checksum_fits(tmp_path: Path, hurt: int) -> None:
    """Each of these raised struct.error or ValueError: what is hurt before it is sealed no checksum tells."""

    def shortened(kind: int, content: bytes) -> bytes:
        if kind != hurt:
            return content
        if kind == Opcode.FOOTER:
            return content[:3]
        if kind == Opcode.MESSAGE_INDEX:  # its list is said to be a byte shorter
            return content[:2] + struct.pack("<I", len(content) - 7) + content[6:]
        body = zstandard.ZstdDecompressor().decompress(content[44:])
        at = body.index(b"/tick")  # a channel's topic, behind its length
        body = body[: at - 4] + b"\xff\xff\0\0" + body[at:]
        packed = zstandard.ZstdCompressor().compress(body)
        head = content[:16] + struct.pack("<QI", len(body), zlib.crc32(body)) + content[28:36]
        return head + struct.pack("<Q", len(packed)) + packed

    sound = files(tmp_path)["mcap"]
    path, good = tmp_path / "a.mcap", tmp_path / "made.mcap"
    path.write_bytes(together((kind, shortened(kind, content)) for kind, content in records_of(sound)))
    times = row_times(path, Sample)
    assert times.tolist() == row_times(good, Sample).tolist()
    assert list(read_rows(path, (Sample,), (0, 2**62))) == list(read_rows(good, (Sample,)))
    assert summarise(path).rows > 0
    assert set(map(repr, read_rows(path))) <= set(map(repr, read_rows(good)))


def test_lists_of_messages_that_lead_beyond_all_numbers_are_no_fault(tmp_path: Path) -> None:
    """Six of a million recordings ended in an OverflowError."""

    def beyond(kind: int, content: bytes) -> bytes:
        if kind != Opcode.MESSAGE_INDEX:
            return content
        # Behind channel and length each entry is a time and a place, of 8 bytes.
        entries = [content[at : at + 8] + b"\xff" * 8 for at in range(6, len(content), 16)]
        return content[:6] + b"".join(entries)

    sound = files(tmp_path)["mcap"]
    path, good = tmp_path / "a.mcap", tmp_path / "made.mcap"
    path.write_bytes(together((kind, beyond(kind, content)) for kind, content in records_of(sound)))
    assert list(read_rows(path, (Sample,), (0, 2**62))) == list(read_rows(good, (Sample,)))
    assert row_times(path, Sample).tolist() == row_times(good, Sample).tolist()


def test_times_beyond_all_clocks_are_no_times_and_no_fault(tmp_path: Path) -> None:
    """Two of a million recordings, in which such a time stood where no index was to be had."""

    def beyond(kind: int, content: bytes) -> bytes:
        if kind != Opcode.CHUNK:
            return content
        at = CHUNK.size + 8  # behind the name of the compression
        body = bytearray(zstandard.ZstdDecompressor().decompress(content[at + 8 :], max_output_size=10**6))
        there = 0
        while there < len(body):
            record, length = RECORD.unpack_from(body, there)
            if record == Opcode.MESSAGE:  # behind channel and sequence, when it was written
                body[there + RECORD.size + 6 : there + RECORD.size + 14] = b"\xff" * 8
                break
            there += RECORD.size + length
        else:
            return content
        first, last, _, _ = CHUNK.unpack_from(content)
        packed = zstandard.ZstdCompressor().compress(bytes(body))
        head = CHUNK.pack(first, last, len(body), zlib.crc32(body)) + content[CHUNK.size : at]
        return head + struct.pack("<Q", len(packed)) + packed

    kept = [(k, beyond(k, c)) for k, c in records_of(files(tmp_path)["mcap"]) if k != Opcode.FOOTER]
    path, good = tmp_path / "a.mcap", tmp_path / "made.mcap"
    path.write_bytes(together(kept))
    times, sound = row_times(path, Event).tolist(), row_times(good, Event).tolist()
    assert times == sound[1:]
