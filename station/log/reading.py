"""Rows of a recording in the order they were written, through all its files, as far as they can be read."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Final

import numpy as np
from mcap.records import Channel
from numpy.typing import NDArray

from station.log.about import LogInfo, counts_of, info_of
from station.log.messages import ROW_KINDS, read_row
from station.log.scan import PartReader
from station.rows import LogError, Row, Rows

_END_OF_TIME: Final = 2**63 - 1
_PART = re.compile(r"\.(\d{4,})$")


def parts(path: Path) -> tuple[Path, ...]:
    """The files of a recording: name.mcap and its numbered parts. A numbered part stands for itself alone."""
    if _PART.search(path.stem):
        return (path,)
    numbered = [p for p in path.parent.glob(f"{_escaped(path.stem)}.*.mcap") if _PART.search(p.stem)]
    numbered = [p for p in numbered if _PART.sub("", p.stem) == path.stem]
    return (path, *sorted(numbered, key=number_of))


def _escaped(text: str) -> str:
    return re.sub(r"([*?[])", r"[\1]", text)


def metadata(path: Path) -> LogInfo:
    """What a recording says of itself, from its first file. Raises LogError if that is nothing."""
    if not path.is_file():
        later = parts(path)[1:]
        mend = f"\nlater files of it are: read {later[0]} and those after it one by one" if later else ""
        raise LogError(f"{path}: no such file{mend}")
    reader = PartReader(path)
    reader.open()
    return info_of(reader)


def read_part(reader: PartReader) -> Iterator[Rows]:
    """All rows of one file; what cannot be made a row is noted as damage."""
    yield from _rows(reader, reader.messages())


def _rows(reader: PartReader, messages: Iterable[tuple[Channel, int, bytes]]) -> Iterator[Rows]:
    for channel, time_ns, data in messages:
        kind = channel.metadata.get("row", "")
        try:
            yield read_row(kind, channel.metadata["key"], time_ns, data)
        except (ValueError, KeyError, TypeError) as error:
            reader.note(f"a message on {channel.topic} is no row: {error}")


def read_rows(
    path: Path,
    kinds: Collection[type[Row]] | None = None,
    span_ns: tuple[int, int] | None = None,
) -> Iterator[Rows]:
    """Every readable row of a recording in the order it was written, through all its parts.

    `kinds` leaves out the others unread, `span_ns` those whose time is not within (both ends are). A cut or damaged
    file gives what it has; `summarise` says what is missing.
    Raises LogError if there is no recording or its start cannot be read.
    """
    names = set(ROW_KINDS) if kinds is None else _names(kinds)
    if kinds is None and span_ns is None:
        for reader in readers(path):
            yield from read_part(reader)
        return
    first_ns, last_ns = span_ns if span_ns is not None else (0, _END_OF_TIME)
    for reader in readers(path):
        yield from _rows(reader, reader.select(names, first_ns, last_ns))


def row_times(path: Path, kind: type[Row]) -> NDArray[np.int64]:
    """Time (ns) of every row of a kind, in the order written; read from the index where a file has one."""
    found = [reader.times(_names((kind,))) for reader in readers(path)]
    return np.concatenate([np.zeros(0, dtype=np.int64), *found])


def _names(kinds: Collection[type[Row]]) -> set[str]:
    names = {kind.__name__ for kind in kinds}
    if not names <= ROW_KINDS.keys():
        raise ValueError(f"not rows: {names - ROW_KINDS.keys()}")
    return names


def absent(path: Path, info: LogInfo) -> list[str]:
    """Files of a recording that ought to be beside the one that is named, and are not. A later file whose first is
    there stands for itself alone."""
    if number := _PART.search(path.stem):
        first = path.with_name(f"{path.stem[: number.start()]}.mcap")
        return [] if first.exists() else [first.name]
    files = parts(path)
    wanted = [path.with_name(f"{path.stem}.{n:04d}.mcap") for n in range(info.part + 1, number_of(files[-1]))]
    # A later file that has been given a name of its own says itself which it is.
    gone = [f"what came before {path.name}"] if info.part else []
    gone += [p.name for p in wanted if not p.exists()]
    last = counts_of(PartReader(files[-1]))
    return [*gone, f"the file after {files[-1].name}"] if last is not None and last.goes_on else gone


def number_of(path: Path) -> int:
    """Of a file in its recording; 0 of the first."""
    number = _PART.search(path.stem)
    return int(number[1]) if number else 0


def readers(path: Path, first: LogInfo | None = None) -> Iterator[PartReader]:
    """Each file of a recording, opened. Passed over is what is of another flight or no recording; of a file that cannot
    say whose it is, its name does. `first`: what the recording is, where its own file cannot say that either."""
    flight = (first or metadata(path)).flight
    for part in parts(path):
        reader = PartReader(part)
        try:
            reader.open()
        except LogError:
            continue
        try:
            if info_of(reader).flight != flight and first is None:
                continue
        except LogError:
            if part.stat().st_size and not reader.doubtful and not reader.damage and reader.truncated_at is None:
                continue  # an MCAP file of somebody else
        yield reader
