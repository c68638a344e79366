"""A recording as analysts open it: points and events as pandas tables, signals as xarray with units; and new ones, of
files from elsewhere and of the simulation."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from station.api.simulated_rows import Simulated, write_simulated
from station.api.words_as_html import facts
from station.log import LogInfo, Table, metadata, points, read_rows, row_times, table, verdict
from station.log.messages import ESTIMATE_UNITS
from station.profile import Aircraft, Rig, load_aircraft, load_rig
from station.rows import AlphaEstimate, Event, Frame, LogError, MethodEstimate, Sample, UsageError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


class Recording:
    """A recording (.mcap), of which only the start has been read.

    `path`; `aircraft` as the recording has it; `verdict` complete, truncated or damaged.
    """

    def __init__(self, path: Path | str) -> None:
        """Raises LogError. Warns where not all of the recording is there."""
        self.path = Path(path)
        if not self.path.is_file():
            raise LogError(f"{path}: no such file")
        self.info: LogInfo = metadata(self.path)
        self.verdict = verdict(self.path)
        if self.verdict != "complete":
            said = f"{self.path} is {self.verdict}: what can be read of it is here; station info tells what is missing"
            warnings.warn(said, stacklevel=3)

    @property
    def aircraft(self) -> Aircraft:
        return self.info.aircraft

    @cached_property
    def points(self) -> pd.DataFrame:
        """The test points marked, by their number: `start_s`, `end_s`, `note`."""
        import pandas as pd

        rows = [(p.n, p.start_s, p.end_s, p.note) for p in points(self.path)]
        return pd.DataFrame(rows, columns=["number", "start_s", "end_s", "note"]).set_index("number")

    @cached_property
    def events(self) -> pd.DataFrame:
        """What happened, in time: `time_s`, `level`, `source`, `code`, `count`, `detail`."""
        import pandas as pd

        found = [e for e in read_rows(self.path, (Event,)) if isinstance(e, Event)]
        rows = [
            (self._since(e.t_ns), e.level.name.lower(), e.source, str(e.code), e.count, e.detail)
            for e in sorted(found, key=lambda e: e.t_ns)
        ]
        return pd.DataFrame(rows, columns=["time_s", "level", "source", "code", "count", "detail"])

    @cached_property
    def signals(self) -> xr.Dataset:
        """All signals over `time` (s since the first frame), aligned at 50 Hz in flight; of an import, as recorded.

        Each has the attributes `units` and `positive`. Of a flight a minute is read when any of it is looked at:
        `signals.sel(time=slice(60, 70))` reads no more.
        """
        from station.api.signal_arrays import BLOCK, Blocks, dataset

        times = row_times(self.path, Frame) if self.verdict == "complete" else np.zeros(0, dtype=np.int64)
        if len(times) <= BLOCK:
            return self._dataset(self._table.columns)
        zero = int(times[0])
        known, further = self.info.about.signals, self.info.about.further
        given = {n for s in self.info.streams for n in s.signals} | {d.signal.name for d in further.derived}
        names = [n for n in known if n in given]

        def read(first: int, last: int) -> Mapping[str, np.ndarray[Any, np.dtype[np.float64]]]:
            span = int(times[first]), int(times[last - 1])
            values = np.array([f.values for f in read_rows(self.path, (Frame,), span) if isinstance(f, Frame)])
            return {n: values[:, i].copy() for i, n in enumerate(known) if n in names}

        about = {"aircraft": self.aircraft.name, "recording": str(self.path)}
        return dataset((times - zero) / 1e9, Blocks(len(times), read), {n: self._attributes(n) for n in names}, about)

    @cached_property
    def truth(self) -> xr.Dataset:
        """What the simulation knows, at the times of the signals; empty of a flight."""
        return self._dataset(self._table.truth)

    @cached_property
    def alpha(self) -> xr.Dataset:
        """The angle of attack and its corrections as they were estimated in flight; empty without estimates."""
        rows = [r for r in read_rows(self.path, (AlphaEstimate,)) if isinstance(r, AlphaEstimate)]
        columns = {n: np.array([getattr(r, n) for r in rows]) for n in ESTIMATE_UNITS}
        made = self._over(np.array([r.t_ns for r in rows], dtype=np.int64), columns, ESTIMATE_UNITS)
        return made.assign(valid=("time", np.array([r.valid for r in rows], dtype=bool)))

    def derivatives(self, method: str) -> xr.Dataset:
        """One method's derivatives as they were estimated in flight, 1/rad, and their standard errors, `NAME_sd`.
        Raises LogError for a method that the recording does not have."""
        rows = [r for r in read_rows(self.path, (MethodEstimate,)) if isinstance(r, MethodEstimate)]
        mine = [r for r in rows if r.method == method and r.parameters]
        if not mine:
            known = ", ".join(dict.fromkeys(r.method for r in rows)) or "none"
            raise LogError(f"{self.path}: no estimates by {method}\nmethods in it: {known}")
        names = [p.name for p in max(mine, key=lambda r: len(r.parameters)).parameters]
        values = np.full((len(mine), len(names), 2), np.nan)
        for i, row in enumerate(mine):
            for p in row.parameters:
                values[i, names.index(p.name)] = p.value, p.sd
        columns = {n: values[:, j, 0] for j, n in enumerate(names)}
        columns |= {f"{n}_sd": values[:, j, 1] for j, n in enumerate(names)}
        return self._over(np.array([r.t_ns for r in mine], dtype=np.int64), columns, dict.fromkeys(columns, "1/rad"))

    def stream(self, name: str, start: float | None = None, end: float | None = None) -> xr.Dataset:
        """The samples of one stream as they came, at its own rate, from and to these seconds. Raises LogError for a
        stream that the recording does not have."""
        known = {s.name: s for s in self.info.streams}
        if name not in known:
            raise LogError(f"{self.path}: no stream {name}\nstreams in it: {', '.join(known)}")
        span = (
            self._zero if start is None else self._zero + round(start * 1e9),
            2**62 if end is None else self._zero + round(end * 1e9),
        )
        signals = known[name].signals
        rows = [
            r
            for r in read_rows(self.path, (Sample,), span)
            if isinstance(r, Sample) and r.stream == name and len(r.values) == len(signals)
        ]
        values = np.array([r.values for r in rows]).reshape(-1, len(signals))
        columns = {n: values[:, i] for i, n in enumerate(signals)}
        return self._over(np.array([r.t_ns for r in rows], dtype=np.int64), columns, {})

    @cached_property
    def _table(self) -> Table:
        return table(self.path)

    @cached_property
    def _zero(self) -> int:
        """Station time of time 0, ns."""
        first = next(read_rows(self.path, (Frame,)), None)
        return first.t_ns if first is not None else self._table.t0_ns

    def _since(self, t_ns: int) -> float:
        return (t_ns - self._zero) * 1e-9

    def _dataset(self, columns: Mapping[str, Any]) -> xr.Dataset:
        return self._over(None, columns, {})

    def _over(self, t_ns: Any, columns: Mapping[str, Any], units: Mapping[str, str]) -> xr.Dataset:
        import xarray as xr

        t_s = self._table.t_s if t_ns is None else (t_ns - self._zero) * 1e-9
        known = self.info.about.signals
        variables = {
            n: ("time", c, self._attributes(n) if n in known else {"units": units.get(n, "")})
            for n, c in columns.items()
        }
        time = ("time", t_s, {"units": "s", "long_name": "time since the first frame"})
        return xr.Dataset(variables, {"time": time}, {"aircraft": self.aircraft.name, "recording": str(self.path)})

    def _attributes(self, name: str) -> dict[str, str]:
        signal = self.info.about.signals[name]
        return {"units": signal.unit, "positive": signal.positive}

    def __repr__(self) -> str:
        return f"<recording {self.path}: {self.info.about.source} of {self.aircraft.name}, {self.verdict}>"

    def _repr_html_(self) -> str:
        about = self.info.about
        rows = {
            "recording": str(self.path),
            "state": self.verdict if self.verdict == "complete" else f"{self.verdict}: not all of it is here",
            "of": f"{about.source} of {self.aircraft.name}" + (f", card {about.card.name}" if about.card else ""),
            "streams": ", ".join(f"{s.name} ({' '.join(s.signals)})" for s in self.info.streams),
            "test points": str(len(self.points)),
        }
        return facts(rows)


def open(path: Path | str) -> Recording:
    """Open a recording. Raises LogError where it is none; warns where not all of it is there."""
    return Recording(path)


def import_file(
    path: Path | str,
    out: Path | str,
    aircraft: Aircraft | str,
    signals: Mapping[str, str] | None = None,
    rig: Rig | str | None = None,
) -> Recording:
    """Make a recording of a record from elsewhere (`station import`): `aircraft` is a profile or its name or path;
    `signals`: of a Chapter 10 file, measurements by signal; `rig`: likewise, which declares further columns of a CSV.
    What is left out stands in `info.about.notes`.

    Raises LogError, ProfileError and UsageError, which say where in the file and how to mend it.
    """
    profile = load_aircraft(aircraft) if isinstance(aircraft, str) else aircraft
    declaring = load_rig(rig) if isinstance(rig, str) else rig
    write_import(Path(path), Path(out), profile, signals or {}, declaring)
    return Recording(out)


def write_import(
    path: Path,
    out: Path,
    aircraft: Aircraft,
    signals: Mapping[str, str],
    rig: Rig | None = None,
    told: Callable[[float | None], None] = lambda _: None,
) -> int:
    """The recording of a file from elsewhere; returns its rows. `rig`: which declares further columns of a CSV. `told`
    hears None while the file is read, then the share that is written."""
    from drivers.dataflash import left_out, read_dataflash
    from station.convert import CH10, Importer, ch10_rows, reader_of
    from station.convert import import_file as write

    if signals and path.suffix.lower() not in CH10:
        raise UsageError(f"{path}: --signal names measurements of a Chapter 10 file ({', '.join(CH10)})")
    dataflash = Importer(".bin", "ArduPilot's DataFlash", reader_of("dataflash", read_dataflash, left_out))
    return write(path, out, aircraft, (dataflash, *ch10_rows(signals)), rig, told)


def simulate(
    scenario: str,
    out: Path | str,
    settings: Mapping[str, Any] | None = None,
    *,
    seed: int | None = None,
    duration: float | None = None,
) -> Recording:
    """Fly the simulation with the rig's sensors into a recording (`station simulate`), its truth beside.

    `scenario`: a card's name or path; `settings`: values that replace the card's, such as {"flight.gust_sigma":
    "5 ft/s"}. Raises ProfileError and LogError; warns where the aircraft went beyond what derivatives describe.
    """
    made: Simulated = write_simulated(scenario, Path(out), settings or {}, seed, duration)
    for words in made.remarks:
        warnings.warn(words, stacklevel=2)
    return Recording(out)
