"""A recording as CSV, Parquet, MATLAB, MDF4, ULog, MCAP and telemetry log files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from station.conventions import SIGNALS
from station.convert.delimited import write_csv
from station.convert.fdata import EXTRA_UNITS, write_fdata
from station.convert.foxglove import write_mcap
from station.convert.new_file import new_file
from station.convert.tlog import Splitter, write_tlog
from station.convert.tracks import Column
from station.convert.ulog_writer import write_ulog
from station.log import Table, make_folder, metadata, read_rows, table
from station.log.messages import ESTIMATE_UNITS
from station.profile import to_json
from station.rows import AlphaEstimate, LogError, MethodEstimate, Sample

Format = Literal["csv", "parquet", "mat", "mdf4", "ulog", "tlog", "mcap"]


@dataclass(frozen=True, slots=True)
class _Group:
    """Columns on one time base, SI."""

    name: str
    t_s: Column
    columns: Mapping[str, Column]
    units: Mapping[str, str]


def export(path: Path, form: Format, out: Path, splitter: Callable[[], Splitter] | None = None) -> tuple[Path, ...]:
    """Write a recording's table, raw streams and estimates; returns the files made.

    `mat` is the table in SIDPAC's fdata layout, one file. `mdf4` is one file with a channel group for each time base.
    `csv` and `parquet` put the table in `out` and each stream of a flight, and the estimates, beside it as
    out-stem.STREAM.csv. `ulog` is PX4's, `mcap` for Foxglove, `tlog` raw MAVLink, its packets found by a `splitter`.
    Nothing is overwritten, and nothing half-written is left. Raises LogError.
    """
    write: Mapping[Format, Callable[[], list[Path]]] = {
        "csv": lambda: _separate(path, table(path), out, _csv),
        "parquet": lambda: _separate(path, flown := table(path), out, partial(_parquet, to_json(flown.aircraft))),
        "mat": lambda: _mat(path, table(path), out),
        "mdf4": lambda: _mdf4(path, table(path), out),
        "ulog": lambda: _single(out, partial(write_ulog, path)),
        "tlog": lambda: _single(out, partial(write_tlog, path, splitter=splitter)),
        "mcap": lambda: _single(out, partial(write_mcap, path)),
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


def _time_s(flown: Table) -> Column:
    return flown.t_s if flown.record_ns is None else flown.record_ns / 1e9


def _table_group(flown: Table) -> _Group:
    return _Group("table", _time_s(flown), flown.columns, {n: SIGNALS[n].unit for n in flown.columns})


def _beside(path: Path, flown: Table) -> list[_Group]:
    """Everything that is not in the table: streams at their own rate, estimates, truth, an import's other columns.

    A single imported time base is the table already.
    """
    zero = flown.t0_ns
    samples: dict[str, list[Sample]] = {}
    alphas: list[AlphaEstimate] = []
    methods: dict[str, list[MethodEstimate]] = {}
    for row in read_rows(path, (Sample, AlphaEstimate, MethodEstimate)):
        if isinstance(row, Sample):
            samples.setdefault(row.stream, []).append(row)
        elif isinstance(row, AlphaEstimate):
            alphas.append(row)
        elif isinstance(row, MethodEstimate):
            methods.setdefault(row.method, []).append(row)
    groups: list[_Group] = []
    if flown.record_ns is None:
        for stream in metadata(path).streams:
            rows = [r for r in samples.get(stream.name, ()) if len(r.values) == len(stream.signals)]
            if rows:
                values = np.array([r.values for r in rows])
                columns = {n: values[:, i] for i, n in enumerate(stream.signals)}
                columns["time_device"] = np.array(
                    [np.nan if r.t_device_ns is None else r.t_device_ns / 1e9 for r in rows]
                )
                columns["quality"] = np.array([float(r.quality) for r in rows])
                units = {**{n: SIGNALS[n].unit for n in stream.signals}, "time_device": "s", "quality": "1"}
                groups.append(_Group(stream.name, _times([r.t_ns for r in rows], zero), columns, units))
    if alphas:
        columns = {n: np.array([getattr(a, n) for a in alphas]) for n in ESTIMATE_UNITS}
        columns["valid"] = np.array([float(a.valid) for a in alphas])
        units = {**ESTIMATE_UNITS, "valid": "1"}
        groups.append(_Group("alpha", _times([a.t_ns for a in alphas], zero), columns, units))
    for method, estimates in methods.items():
        columns = {}
        for i, parameter in enumerate(max(estimates, key=lambda e: len(e.parameters)).parameters):
            for what in ("value", "sd"):
                name = parameter.name if what == "value" else f"{parameter.name}_sd"
                columns[name] = np.array(
                    [getattr(e.parameters[i], what) if i < len(e.parameters) else np.nan for e in estimates]
                )
        units = dict.fromkeys(columns, "1/rad")
        groups.append(_Group(f"method {method}", _times([e.t_ns for e in estimates], zero), columns, units))
    if flown.truth:
        units = {n: SIGNALS[n].unit if n in SIGNALS else "" for n in flown.truth}
        groups.append(_Group("truth", flown.t_s, flown.truth, units))
    if flown.extra:
        units = {n: EXTRA_UNITS.get(n, "") for n in flown.extra}
        groups.append(_Group("extra", _time_s(flown), flown.extra, units))
    return groups


def _times(t_ns: list[int], zero: int) -> Column:
    return (np.array(t_ns, dtype=np.int64) - zero) / 1e9


def _separate(path: Path, flown: Table, out: Path, write: Callable[[Path, _Group], None]) -> list[Path]:
    made = []
    for group in (_table_group(flown), *_beside(path, flown)):
        name = group.name.replace(" ", "_").replace("/", "_")
        target = out if group.name == "table" else out.with_name(f"{out.stem}.{name}{out.suffix}")
        with new_file(target) as partial_path:
            write(partial_path, group)
        made.append(target)
    return made


def _csv(target: Path, group: _Group) -> None:
    write_csv(target, group.t_s, group.columns, group.units)


def _parquet(aircraft: str, target: Path, group: _Group) -> None:
    import pyarrow as pa  # slow to import, and wanted here only
    import pyarrow.parquet as pq

    fields = [pa.field("time", pa.float64(), metadata={"unit": "s"})]
    fields += [pa.field(n, pa.float64(), metadata={"unit": group.units[n]}) for n in group.columns]
    schema = pa.schema(fields, metadata={"group": group.name, "aircraft": aircraft})
    arrays = [pa.array(group.t_s), *(pa.array(c) for c in group.columns.values())]
    with target.open("xb") as file:
        pq.write_table(pa.Table.from_arrays(arrays, schema=schema), file, compression="zstd")


def _mat(path: Path, flown: Table, out: Path) -> list[Path]:
    alphas = list(read_rows(path, (AlphaEstimate,)))
    alpha_cg = None
    if alphas:
        t_ns = np.array([a.t_ns for a in alphas], dtype=np.int64)
        values = np.array([a.alpha for a in alphas if isinstance(a, AlphaEstimate)])
        at = np.round(flown.t_s * 1e9)
        alpha_cg = np.interp(at, (t_ns - flown.t0_ns).astype(np.float64), values, np.nan, np.nan)
    return _single(out, lambda partial_path: write_fdata(partial_path, flown, alpha_cg))


def _mdf4(path: Path, flown: Table, out: Path) -> list[Path]:
    from asammdf import MDF, Signal  # slow to import, and wanted here only

    mdf: Any = MDF(version="4.10")
    try:
        for group in (_table_group(flown), *_beside(path, flown)):
            signals = [
                Signal(
                    samples=np.ascontiguousarray(column),
                    timestamps=np.ascontiguousarray(group.t_s),
                    name=name,
                    unit=group.units[name],
                    comment=f"positive: {SIGNALS[name].positive}" if name in SIGNALS else "",
                )
                for name, column in group.columns.items()
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
    return [out]
