"""A recording's aligned rows one after the other: an hour of flight needs no more memory than a row."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from station.log import metadata, read_rows, table
from station.rows import Event, Frame


def aligned_rows(path: Path) -> Iterator[tuple[int, Sequence[float]] | Event]:
    """Station time (ns) and the values in the order of the recording's signals, NaN where missing: frames of a flight,
    else the samples of an import on one time axis; and the events among them, in time. Raises LogError."""
    if next(read_rows(path, (Frame,)), None) is not None:
        for row in read_rows(path, (Frame, Event)):
            if isinstance(row, Frame):
                yield row.t_ns, row.values
            elif isinstance(row, Event):
                yield row
        return
    flown = table(path)
    events = [e for e in read_rows(path, (Event,)) if isinstance(e, Event)]
    columns = [flown.columns[n].tolist() if n in flown.columns else None for n in metadata(path).about.signals]
    for i, t_s in enumerate(flown.t_s.tolist()):
        t_ns = flown.t0_ns + round(t_s * 1e9)
        while events and events[0].t_ns <= t_ns:
            yield events.pop(0)
        yield t_ns, [math.nan if c is None else c[i] for c in columns]
    yield from events
