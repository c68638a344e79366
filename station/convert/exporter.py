"""A recording as CSV, Parquet, MATLAB, MDF4, ULog, MCAP and telemetry log files."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import islice, takewhile
from pathlib import Path
from typing import Any, Literal

import numpy as np

from station.clock import utc_instant
from station.convert.delimited import write_csv
from station.convert.fdata import write_fdata
from station.convert.foxglove import write_mcap
from station.convert.groups import ROWS, Gathered, Group, Told
from station.convert.new_file import new_file
from station.convert.tlog import Splitter, write_tlog
from station.convert.tracks import Column
from station.convert.ulog_writer import write_ulog
from station.log import Table, make_folder, metadata, read_rows, row_times, table
from station.profile import to_json
from station.rows import AlphaEstimate, Frame, LogError, Row

Format = Literal["csv", "parquet", "mat", "mdf4", "ulog", "tlog", "mcap"]


def export(
    path: Path,
    form: Format,
    out: Path,
    splitter: Callable[[], Splitter] | None = None,
    told: Told = lambda _: None,
) -> tuple[Path, ...]:
    """Write a recording's table, raw streams and estimates; returns the files made.

    `mat` is the table in SIDPAC's fdata layout, one file. `mdf4` is one file with a channel group for each time base.
    `csv` and `parquet` put the table in `out` and each stream of a flight, and the estimates, beside it as
    out-stem.STREAM.csv. `ulog` is PX4's, `mcap` for Foxglove, `tlog` raw MAVLink, its packets found by a `splitter`.
    Nothing is overwritten, and nothing half-written is left. `told` hears, in station time (ns), how far it has come.
    Raises LogError.
    """
    write: Mapping[Format, Callable[[], list[Path]]] = {
        "csv": lambda: _separate(path, out, told, lambda to, group: write_csv(to, group.columns, group.blocks())),
        "parquet": lambda: _separate(path, out, told, partial(_parquet, to_json(metadata(path).aircraft))),
        "mat": lambda: _mat(path, out, told),
        "mdf4": lambda: _mdf4(path, out, told),
        "ulog": lambda: _single(out, partial(write_ulog, path, told=told)),
        "tlog": lambda: _single(out, partial(write_tlog, path, splitter=splitter, told=told)),
        "mcap": lambda: _single(out, partial(write_mcap, path, told=told)),
    }
    try:
        make_folder(out.parent)
    except OSError as error:
        raise LogError(f"{out.parent}: cannot be written to: {error.strerror}") from error
    try:
        return tuple(write[form]())
    except FileExistsError as error:
        raise LogError(f"{error.filename}: exists already and is not overwritten") from None
    except OSError as error:
        raise LogError(f"{out}: cannot be written: {error.strerror or error}") from error


def _single(out: Path, write: Callable[[Path], object]) -> list[Path]:
    with new_file(out) as partial_path:
        write(partial_path)
    return [out]


def _separate(path: Path, out: Path, told: Told, write: Callable[[Path, Group], None]) -> list[Path]:
    made = []
    gathered = Gathered(path, told)
    try:
        for group in gathered.in_order():
            name = group.name.replace(" ", "_").replace("/", "_")
            target = out if group.name == "table" else out.with_name(f"{out.stem}.{name}{out.suffix}")
            with new_file(target) as partial_path:
                write(partial_path, group)
            made.append(target)
    finally:
        gathered.close()
    return made


def _parquet(aircraft: str, target: Path, group: Group) -> None:
    import pyarrow as pa  # slow to import, and wanted here only
    import pyarrow.parquet as pq

    fields = [pa.field("time", pa.float64(), metadata={"unit": "s"})]
    fields += [pa.field(n, pa.float64(), metadata={"unit": unit}) for n, unit in group.columns.items()]
    schema = pa.schema(fields, metadata={"group": group.name, "aircraft": aircraft})
    with target.open("xb") as file, pq.ParquetWriter(file, schema, compression="zstd") as writer:
        for t_s, columns in group.blocks():
            arrays = [pa.array(t_s), *(pa.array(c) for c in columns.values())]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))


def _mat(path: Path, out: Path, told: Told) -> list[Path]:
    zero = next(read_rows(path, (Frame,)), None)
    if zero is None:
        flown = table(path)
        times, alpha = flown.t_s, _alpha_cg(path, flown.t0_ns, flown.t_s)
        times = times if flown.record_ns is None else flown.record_ns / 1e9
        return _single(out, lambda to: write_fdata(to, flown.aircraft, times, [(flown, alpha)]))
    # Frames before the links have come up hold nothing, which SIDPAC's least squares would make nothing of too.
    empty = sum(1 for _ in takewhile(_is_empty, read_rows(path, (Frame,))))
    times = (row_times(path, Frame)[empty:] - zero.t_ns) / 1e9
    if not len(times):
        raise LogError(f"{path}: no frame has a value: the links never came up")
    alpha, aircraft = _alpha_cg(path, zero.t_ns, times), metadata(path).aircraft
    return _single(out, lambda to: write_fdata(to, aircraft, times, _blocks(path, times, alpha, told, empty)))


def _is_empty(row: Row) -> bool:
    return isinstance(row, Frame) and all(map(math.isnan, row.values))


def _alpha_cg(path: Path, zero_ns: int, times: Column) -> Column | None:
    """(n,) as estimated in flight, rad."""
    t_s, values = array("d"), array("d")
    for row in read_rows(path, (AlphaEstimate,)):
        if isinstance(row, AlphaEstimate):
            t_s.append((row.t_ns - zero_ns) / 1e9)
            values.append(row.alpha)
    if not t_s:
        return None
    return np.asarray(np.interp(times, t_s, values, np.nan, np.nan), dtype=np.float64)


def _blocks(
    path: Path, times: Column, alpha: Column | None, told: Told, empty: int
) -> Iterator[tuple[Table, Column | None]]:
    """The frames after the first `empty` ones, ROWS at a time."""
    info = metadata(path)
    rows = islice((r for r in read_rows(path, (Frame,)) if isinstance(r, Frame)), empty, None)
    done = 0
    while some := list(islice(rows, ROWS)):
        told(some[-1].t_ns)
        values = np.array([r.values for r in some], dtype=np.float64)
        here = slice(done, done + len(some))
        columns = {n: values[:, i] for i, n in enumerate(info.about.signals)}
        yield Table(times[here], columns, info.aircraft, some[0].t_ns), None if alpha is None else alpha[here]
        done += len(some)


def _mdf4(path: Path, out: Path, told: Told) -> list[Path]:
    from asammdf import MDF, Signal  # slow to import, and wanted here only

    gathered, info = Gathered(path, told), metadata(path)
    known = info.about.signals
    mdf: Any = MDF(version="4.10")
    # A machine without a date began before 1970, which MDF4 cannot say.
    mdf.start_time = utc_instant(max(info.utc_ns + gathered.zero_ns - info.station_ns, 0))
    try:
        for number, group in enumerate(gathered.in_order()):
            for k, (t_s, columns) in enumerate(group.blocks()):
                if k:
                    mdf.extend(number, [(t_s, None), *((c, None) for c in columns.values())])
                    continue
                signals = [
                    Signal(
                        samples=column,
                        timestamps=t_s,
                        name=name,
                        unit=group.columns[name],
                        comment=f"positive: {known[name].positive}" if name in known else "",
                    )
                    for name, column in columns.items()
                ]
                mdf.append(signals, acq_name=group.name, comment=group.name, common_timebase=True)
        # asammdf puts its own suffix in the place of any other: written so, then given the name that was asked for.
        with new_file(out) as partial_path:
            target = partial_path.with_name(f"{partial_path.name}.mf4")
            try:
                mdf.save(str(target), compression=1)
                target.rename(partial_path)
            finally:
                target.unlink(missing_ok=True)
    finally:
        mdf.close()
        gathered.close()
    return [out]
