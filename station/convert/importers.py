"""The files of others that become recordings: a row for each kind, told by its suffix and what is in it.

Packages add their own through the entry point group `station.importers`, whose names are theirs and whose objects are
rows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from station.convert.ch10 import read_ch10
from station.convert.confined import confined
from station.convert.delimited import read_csv, read_hfb
from station.convert.fdata import read_fdata
from station.convert.onspeed import is_onspeed, read_onspeed
from station.convert.tracks import Record, Track, write_record
from station.convert.ulog import read_ulog
from station.convert.umn import is_umn, read_umn
from station.profile import Aircraft, Rig
from station.rows import LogError

GROUP: Final = "station.importers"

CH10: Final = (".ch10", ".c10")

Reader = Callable[[Path, Aircraft], Record]

Columns = tuple[str, Sequence[int], Mapping[str, Sequence[float]]]
"""Signals on one time base: name, times in ns, SI values by signal."""


class Importer(NamedTuple):
    """One row."""

    suffix: str
    """In lower case, with its dot."""
    sentence: str
    """Whose files they are."""
    read: Reader
    """Raises LogError."""
    is_it: Callable[[Path], bool] = lambda _: True
    """Whether a file of that suffix is of this kind. Never raises."""


def ch10_rows(names: Mapping[str, str]) -> tuple[Importer, ...]:
    """The rows of Chapter 10 files; `names`: their measurements by signal, beyond those called as signals are."""
    sentence = "IRIG 106 Chapter 10 with TMATS: PCM and analog channels"
    return tuple(Importer(suffix, sentence, partial(read_ch10, names=names)) for suffix in CH10)


IMPORTERS: Final = (
    Importer(".csv", "OnSpeed's log with boom and VectorNav", read_onspeed, is_onspeed),
    Importer(".csv", "the station's own: each column's name with its unit", read_csv),
    Importer(".mat", "the University of Minnesota's structure `flight_data`", read_umn, is_umn),
    Importer(".mat", "SIDPAC's matrix `fdata`", read_fdata),
    Importer(".asc", "the HFB-320's columns of *Flight Vehicle System Identification*", read_hfb),
    Importer(".ulg", "PX4's ULog", read_ulog),
    *ch10_rows({}),
)
"""Of rows of one suffix the first that knows the file reads it."""


def reader_of(
    source: str,
    read: Callable[[Path], Sequence[Columns]],
    remarks: Callable[[Path], Mapping[str, str]] = lambda _: {},
) -> Reader:
    """A reader made of a function that gives plain columns, and one of remarks: for the drivers, which do not know
    recordings."""

    def reader(path: Path, aircraft: Aircraft) -> Record:
        tracks = [
            Track(name, np.array(t_ns, dtype=np.int64), {n: np.array(c, dtype=np.float64) for n, c in columns.items()})
            for name, t_ns, columns in read(path)
        ]
        return Record(tracks, aircraft, source, {"file": path.name, **remarks(path)})

    return reader


def import_file(
    path: Path,
    out: Path,
    aircraft: Aircraft,
    more: Sequence[Importer] = (),
    rig: Rig | None = None,
    told: Callable[[float | None], None] = lambda _: None,
) -> int:
    """Make a recording of a file of another kind; returns the number of rows. `more` kinds are asked first; `rig`: of
    the station's own CSV, whose columns it may declare. `told` hears None while the file is read, then what share of
    the recording is written.

    Raises LogError, for an unknown suffix naming those known.
    """
    rows = (*more, *(point.load() for point in entry_points(group=GROUP)), *IMPORTERS)
    suffix = path.suffix.lower()
    fitting = [row for row in rows if row.suffix == suffix]
    if not fitting:
        known = tuple(dict.fromkeys(row.suffix for row in rows))
        raise LogError(f"{path}: cannot import {suffix or 'a file without a suffix'}; known: {', '.join(known)}")
    if not path.is_file():
        raise LogError(f"{path}: no such file")
    if out.exists():
        raise LogError(f"{out}: exists already, and a recording is never overwritten")

    def read() -> Record:
        row: Importer = next((row for row in fitting if row.is_it(path)), fitting[-1])
        if rig is None:
            return row.read(path, aircraft)
        if row.read is not read_csv:
            raise LogError(
                f"{path}: read as {row.sentence}, whose columns are its own: --rig is for a CSV whose header names "
                "signals and units"
            )
        return read_csv(path, aircraft, rig)

    return write_record(out, confined(path, read, waiting=lambda: told(None)), told)
