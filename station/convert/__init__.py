"""Records from elsewhere into recordings, and recordings into the files that others read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from station.convert.delimited import read_csv, read_hfb
from station.convert.export import Format, export
from station.convert.fdata import read_fdata
from station.convert.record import Record, Track, write_record
from station.convert.ulog import read_ulog
from station.profile import Aircraft
from station.rows import LogError

__all__ = ["Format", "Reader", "Record", "Track", "export", "import_file"]

Reader = Callable[[Path, Aircraft], Record]

READERS: Mapping[str, Reader] = {".mat": read_fdata, ".csv": read_csv, ".asc": read_hfb, ".ulg": read_ulog}


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
