"""Sound files of each kind, hurt, and what their readers make of them.

Files are small, so that most of what is hurt is what a reader decides by, and lie in memory. Of a recording's records,
and of a compressed matrix, half are hurt before they are sealed: their checksums fit.
"""

from __future__ import annotations

import os
import random
import struct
import time
import zlib
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Final

import zstandard
from mcap.opcode import Opcode

from station.conventions import SIGNALS
from station.convert import IMPORTERS, Importer, import_file
from station.convert.confined import confined
from station.convert.tracks import write_record
from station.log import read_rows, row_times, summarise, write_log
from station.log.index import mapping_of, string_of
from station.log.part import CHUNK, MAGIC, RECORD
from station.log.scan import CRC, seal
from station.rows import (
    AlphaEstimate,
    Code,
    Event,
    Extra,
    Frame,
    Health,
    LogError,
    MethodEstimate,
    ParamEstimate,
    Rows,
    Status,
    StreamHealth,
    Tick,
    TimeSync,
    Truth,
)
from tests.chapter10 import packet, pcm_packets, setup
from tests.reliability.counts import TOGETHER, Flown
from tests.reliability.endings import about, tick_rows
from tests.reliability.foreign import AIRCRAFT, DATAFLASH, dataflash, mat, onspeed, ulog, umn
from tests.reliability.hurting import mutated

BATCH: Final = 500
"""Files that one child reads: a child of its own for each would take longer than reading it."""
BATCH_S: Final = 30
"""Of processor time for so many, which take a second: one that hangs is not waited for long."""
WRITTEN: Final = 10
"""One of so many files that are read is made a recording too, which takes longer than to read it."""
_TOKENS: Final = (
    b"nan", b"inf", b"-inf", b"1e400", b"1e308", b"-0", b"0x1p3", b"1_0", b"+", b"", b" ", b",", b",,", b"\n", b"\r",
    b"#", b"[", b"]", b'"', b"'", b"\t", b"\0", b"\xef\xbb\xbf", b"\xff", "\u0661".encode(), "\u2028".encode(),
    b"9" * 400, b"time [s]", b"[deg]", b"degC", b"1;2",
)  # fmt: skip
"""What people and programs write into tables."""


def files(work: Path) -> dict[str, bytes]:
    """A sound file of each kind."""
    path = work / "made.mcap"
    path.unlink(missing_ok=True)
    write_log(path, about(), recorded())
    table = [f"{0.02 * k:.2f},{0.1 + 0.001 * k},{0.01 * k},100" for k in range(12)]
    return {
        "mcap": path.read_bytes(),
        "csv": "\n".join(["time [s],alpha_vane [rad],q [deg/s],airspeed [kt]", *table]).encode(),
        "asc": "\n".join(" ".join(f"{x:.4f}" for x in [0.1 * k, *[1.5] * 14]) for k in range(12)).encode(),
        "mat": mat(work / "made.mat", False, rows=12),
        "mat compressed": mat(work / "made.mat", True, rows=12),
        "bin": dataflash([1_000_000 + k * 20_000 for k in range(12)]),
        "ulg": ulog(12),
        "ch10": setup() + pcm_packets("packed") + pcm_packets("throughput"),
        "mat umn": umn(work / "made.mat"),
        "csv onspeed": onspeed(),
    }


def recorded() -> list[Rows]:
    """A row of each kind, and two ticks."""
    noise, n, t = random.Random(1), len(SIGNALS), 10**9
    health = StreamHealth("boom.vanes", "boom", 50.0, 0.01, "synced", 0.001, 12.0, 100, 1, 2, True)
    found: list[Rows] = [
        Event(t, "boom", Code.CONNECT, 1, "opened"),
        TimeSync(t, "boom", 12_345, 678),
        *tick_rows(0, t, noise)[:4],
        Frame(t, 0, (0.1,) * n, (0.0,) * n, (0,) * n),
        AlphaEstimate(t, *[0.1] * 12, "", *[0.0] * 3, True, ""),
        MethodEstimate(t, "II", (ParamEstimate("CL_alpha", 5.7, 0.1, Status.ESTIMATED, ""),), True, ""),
        Health(t, (health,), 0, 0),
        Truth(t, {"alpha": 0.1}),
        Extra(t, {"density": 1.2}),
    ]
    return [*found, Tick(t, 0, t - 60_000_000), *tick_rows(1, t + 20_000_000, noise)[:4], Tick(t + 20_000_000, 1, t)]


def hurt_text(data: bytes, noise: random.Random) -> bytes:
    """Or with another word in a cell's place."""
    if noise.random() < 0.5:
        return mutated(data, noise)
    cells = data.replace(b" ", b" \1").replace(b",", b",\1").replace(b"\n", b"\n\1").split(b"\1")
    cells[noise.randrange(len(cells))] = noise.choice(_TOKENS) + noise.choice((b"", b",", b" ", b"\n"))
    return b"".join(cells)


def hurt_compressed(data: bytes, noise: random.Random) -> bytes:
    """Or its matrix before it was compressed (*MAT-File Format*, miCOMPRESSED)."""
    if noise.random() < 0.5:
        return mutated(data, noise)
    packed = zlib.compress(mutated(_inflated(data), noise), 1)
    return data[:132] + struct.pack("<I", len(packed)) + packed


def hurt_chapter10(data: bytes, noise: random.Random) -> bytes:
    """Or what is in its packets, whose checksums then fit."""
    if noise.random() < 0.3:
        return mutated(data, noise)
    packets = list(_packets(data))
    for at in noise.sample(range(len(packets)), noise.choice((1, 1, 2))):
        channel, kind, body, ticks = packets[at]
        packets[at] = channel, kind, mutated(body, noise), ticks
    return b"".join(packet(*each) for each in packets)


def _packets(data: bytes) -> Iterator[tuple[int, int, bytes, int]]:
    """Channel, type of data, body and time of each (IRIG 106 Chapter 11, packet header)."""
    at = 0
    while at < len(data):
        _, channel, length, size, _, _, _, kind = struct.unpack_from("<HHIIBBBB", data, at)
        yield channel, kind, data[at + 24 : at + 24 + size], int.from_bytes(data[at + 16 : at + 22], "little")
        at += length


@lru_cache(maxsize=1)
def _inflated(data: bytes) -> bytes:
    return zlib.decompress(data[136:])


def hurt_recording(data: bytes, noise: random.Random) -> bytes:
    """Or one of its records, whose own checksum then fits, and mostly the file's as well."""
    if noise.random() < 0.5:
        return mutated(data, noise)
    records = list(records_of(data))
    inside = [n for n, (kind, _) in enumerate(records) if kind in _SEALED]
    at = noise.choice(inside) if noise.random() < 0.8 else noise.randrange(len(records))
    kind, content = records[at]
    records[at] = kind, _SEALED.get(kind, mutated)(content, noise)
    return together(records, is_summed=noise.random() < 0.8)


def together(records: Iterable[tuple[int, bytes]], *, is_summed: bool = True) -> bytes:
    """A file of these, with the checksum of the whole or none."""
    out = bytearray(MAGIC)
    for kind, content in records:
        if kind == Opcode.DATA_END:
            content = zlib.crc32(out).to_bytes(4, "little") if is_summed else bytes(4)
        out += RECORD.pack(kind, len(content)) + content
    return bytes(out + MAGIC)


@lru_cache(maxsize=1)
def records_of(data: bytes) -> tuple[tuple[int, bytes], ...]:
    """Kind and content of each, from the magic number at the start to that at the end."""
    found, at = [], len(MAGIC)
    while at < len(data) - len(MAGIC):
        kind, length = RECORD.unpack_from(data, at)
        at += RECORD.size + length
        found.append((kind, data[at - length : at]))
    return tuple(found)


def _chunk(content: bytes, noise: random.Random) -> bytes:
    first, last, size, _ = CHUNK.unpack_from(content)
    at = CHUNK.size + 8
    assert content[CHUNK.size + 4 : at] == b"zstd"
    body = mutated(zstandard.ZstdDecompressor().decompress(content[at + 8 :], max_output_size=size), noise)
    packed = zstandard.ZstdCompressor(level=1).compress(body)
    head = CHUNK.pack(first, last, len(body), zlib.crc32(body)) + content[CHUNK.size : at]
    return head + struct.pack("<Q", len(packed)) + packed


def _metadata(content: bytes, noise: random.Random) -> bytes:
    name, rest = string_of(content)
    found = mapping_of(rest)
    found.pop(CRC, None)
    if found:
        key = noise.choice(sorted(found))
        found[key] = mutated(found[key].encode(), noise).decode(errors="replace")
    found[CRC] = seal(found)
    pairs = b"".join(_string(key) + _string(value) for key, value in found.items())
    return _string(name) + struct.pack("<I", len(pairs)) + pairs


def _string(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def _attachment(content: bytes, noise: random.Random) -> bytes:
    _, rest = string_of(content[16:-4])
    _, rest = string_of(rest)
    head = content[: -4 - len(rest) + 8]
    held = mutated(rest[8:], noise)
    whole = head[:-8] + struct.pack("<Q", len(held)) + held
    return whole + zlib.crc32(whole).to_bytes(4, "little")


_SEALED: Final[dict[int, Callable[[bytes, random.Random], bytes]]] = {
    Opcode.CHUNK: _chunk,
    Opcode.METADATA: _metadata,
    Opcode.ATTACHMENT: _attachment,
}
HURT: Final[dict[str, Callable[[bytes, random.Random], bytes]]] = {
    "mcap": hurt_recording,
    "csv": hurt_text,
    "asc": hurt_text,
    "mat": mutated,
    "mat compressed": hurt_compressed,
    "bin": mutated,
    "ulg": mutated,
    "ch10": hurt_chapter10,
    "mat umn": mutated,
    "csv onspeed": hurt_text,
}
"""How a file of each kind is hurt."""


def fly_recording(data: bytes, flown: Flown, seed: int, work: Path) -> Iterator[None]:
    """Recordings of our own, in turn: judged, as `info` does; every row, as `replay` reads them; some, and
    times, by the index."""
    noise, path = random.Random(f"{seed} mcap"), work / "a.mcap"
    ways: list[Callable[[Path], object]] = [
        summarise,
        lambda p: list(read_rows(p)),
        lambda p: list(read_rows(p, (Tick, Frame), (10**9, 2 * 10**9))),
        lambda p: row_times(p, Tick),
    ]
    began = time.process_time()
    for count in range(1, 2**63):
        path.write_bytes(hurt_recording(data, noise))
        try:
            ways[count % len(ways)](path)
            flown.read += 1
        except LogError:
            pass
        except Exception as error:
            flown.fault(f"{flown.inputs}", f"{type(error).__name__}: {error}")
        if not count % TOGETHER:
            flown.longest_s = max(flown.longest_s, time.process_time() - began)
        yield
        if not count % TOGETHER:
            began = time.process_time()


def fly_files(kind: str, data: bytes, flown: Flown, seed: int, work: Path) -> Iterator[None]:
    """Files from elsewhere, many in one child; one that ends it is imported alone, as by a user, and then the rest."""
    suffix, noise = kind.split(maxsplit=1)[0], random.Random(f"{seed} {kind}")
    path = work / f"a.{suffix}"
    path.write_bytes(data)
    next(row for row in _kinds(path) if row.is_it(path)).read(path, AIRCRAFT)  # what children then need not import
    while True:
        batch = [HURT[kind](data, noise) for _ in range(BATCH)]
        while batch:
            told = _read_in_a_child(path, batch, work)
            for verdict, took, what in told:
                flown.read += verdict != "refused"
                flown.written += verdict == "written"
                flown.longest_s = max(flown.longest_s, took)
                if what:
                    flown.fault(f"{flown.inputs}", what)
                yield
            batch = batch[len(told) :]
            if batch:
                flown.ended += 1
                is_read, took = _imported(path, work / "out.mcap", batch.pop(0), flown)
                flown.read += is_read
                flown.longest_s = max(flown.longest_s, took)
                yield


def _kinds(path: Path) -> list[Importer]:
    return [row for row in (DATAFLASH, *IMPORTERS) if row.suffix == path.suffix]


def _read_in_a_child(path: Path, batch: list[bytes], work: Path) -> list[tuple[str, float, str]]:
    """Of each file up to one that ends the child: refused, read or written; processor time, s; and what is a fault."""
    kinds, out = _kinds(path), work / "out.mcap"

    def one(content: bytes, is_written: bool) -> tuple[str, str]:
        path.write_bytes(content)
        row = next((row for row in kinds if row.is_it(path)), kinds[-1])
        try:
            record = row.read(path, AIRCRAFT)
        except MemoryError:
            raise
        except Exception:  # what `confined` makes a LogError of
            return "refused", ""
        if not is_written:
            return "read", ""
        out.unlink(missing_ok=True)
        try:
            write_record(out, record)
            return "written", "" if summarise(out).verdict == "complete" else "left a recording that is not whole"
        except LogError as error:
            return "read", f"left a recording that cannot be read: {error}" if out.exists() else ""
        except Exception as error:
            return "read", f"{type(error).__name__} in writing: {error}"

    told = os.open(work / "told", os.O_RDWR | os.O_CREAT | os.O_TRUNC)

    def all_of_them() -> None:
        read, began = 0, time.process_time()
        for number, content in enumerate(batch, 1):
            verdict, what = one(content, not read % WRITTEN)
            read += verdict != "refused"
            took = 0.0
            if not number % TOGETHER:
                took, began = time.process_time() - began, time.process_time()
            os.write(told, f"{verdict}\t{took}\t{' '.join(what.split())}\n".encode(errors="replace"))

    path.write_bytes(b"")
    try:
        confined(path, all_of_them, BATCH_S)
    except LogError:
        pass
    finally:
        os.close(told)
    lines = [line.split("\t") for line in (work / "told").read_text().splitlines()]
    return [(verdict, float(took), what) for verdict, took, what in lines]


def _imported(path: Path, out: Path, content: bytes, flown: Flown) -> tuple[bool, float]:
    """Whether it made a recording, and how long that took."""
    path.write_bytes(content)
    out.unlink(missing_ok=True)
    began = sum(os.times()[:4])
    try:
        import_file(path, out, AIRCRAFT, (DATAFLASH,))
        summarise(out)
    except LogError as error:
        if out.exists():
            flown.fault(f"{flown.inputs}", f"left a recording that cannot be read: {error}")
        return False, sum(os.times()[:4]) - began
    return True, sum(os.times()[:4]) - began
