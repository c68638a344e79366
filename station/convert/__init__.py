"""Records from elsewhere into recordings, and recordings into the files that others read."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.io import whosmat

from station.convert.delimited import read_csv, read_hfb
from station.convert.exporter import Format, export
from station.convert.fdata import read_fdata
from station.convert.onspeed import is_onspeed, read_onspeed
from station.convert.tracks import Record, Track, write_record
from station.convert.ulog import read_ulog
from station.convert.umn import VARIABLE as UMN_VARIABLE
from station.convert.umn import read_umn
from station.profile import Aircraft
from station.rows import LogError

__all__ = ["Format", "Reader", "Record", "Track", "export", "import_file", "reader_of"]

Reader = Callable[[Path, Aircraft], Record]

Columns = tuple[str, Sequence[int], Mapping[str, Sequence[float]]]
"""Signals on one time base: name, times in ns, SI values by signal."""


def _read_any_csv(path: Path, aircraft: Aircraft) -> Record:
    """A CSV of the station's or of OnSpeed's, told by its first line."""
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            first = file.readline()
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error
    return read_onspeed(path, aircraft) if is_onspeed(first) else read_csv(path, aircraft)


def _read_any_mat(path: Path, aircraft: Aircraft) -> Record:
    """A .mat of SIDPAC's or of the University of Minnesota's, told by its variables."""
    try:
        structs = {name for name, _, kind in whosmat(path) if kind == "struct"}
    except Exception:  # scipy raises whatever a broken file makes of it; read_fdata says it in words
        structs = set()
    return read_umn(path, aircraft) if UMN_VARIABLE in structs else read_fdata(path, aircraft)


READERS: Mapping[str, Reader] = {".mat": _read_any_mat, ".csv": _read_any_csv, ".asc": read_hfb, ".ulg": read_ulog}


def reader_of(source: str, read: Callable[[Path], Sequence[Columns]]) -> Reader:
    """A reader made of a function that gives plain columns: for the drivers, which do not know recordings."""

    def reader(path: Path, aircraft: Aircraft) -> Record:
        tracks = [
            Track(name, np.array(t_ns, dtype=np.int64), {n: np.array(c, dtype=np.float64) for n, c in columns.items()})
            for name, t_ns, columns in read(path)
        ]
        return Record(tracks, aircraft, source, {"file": path.name})

    return reader


def import_file(path: Path, out: Path, aircraft: Aircraft, more_readers: Mapping[str, Reader] | None = None) -> int:
    """Make a recording of a file of another kind, told by its suffix; returns the number of rows.

    `more_readers` adds kinds, by suffix in lower case. Raises LogError.
    """
    readers = {**READERS, **(more_readers or {})}
    read = readers.get(path.suffix.lower())
    if read is None:
        raise LogError(f"{path}: cannot import {path.suffix or 'a file without a suffix'}; known: {', '.join(readers)}")
    if not path.is_file():
        raise LogError(f"{path}: no such file")
    if out.exists():
        raise LogError(f"{out}: exists already, and a recording is never overwritten")
    return write_record(out, read(path, aircraft))
