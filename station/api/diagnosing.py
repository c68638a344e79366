"""What is wrong with recordings, as `station diagnose` finds it, in a result that tabulates and plots itself."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from station.api.flown_recording import Recording
from station.api.page_printing import check_printable, print_page
from station.api.words_as_html import Picture, heading, lines
from station.convert.jsbsim_aircraft import SUFFIX, write_jsbsim
from station.diagnosis.checks import Checked, checked
from station.diagnosis.diagnosis_result import Gain, Result, summary
from station.diagnosis.side_by_side import meanwhile
from station.identification.instrument_table import InstrumentTable, of_recording
from station.identification.instrument_table import as_json as lags_json
from station.log import Table, metadata, points, table, verdict
from station.profile import Aircraft, load_aircraft
from station.profile.profile_text import write_profile as write_aircraft
from station.rows import LogError, UsageError

if TYPE_CHECKING:
    import pandas as pd

    from station.diagnosis.detectable import Detectable
    from station.diagnosis.kinematic_diagnosis import KinematicDiagnosis
    from station.diagnosis.procedure import Diagnosis
    from station.diagnosis.readings import Readings

Log = Recording | Path | str
Progress = Callable[[str], None]
Marked = tuple[Checked, list[tuple[float, float]]]

HELD_OUT_SHARE: Final = 3
"""Without recordings to hold out, the last of every so many manoeuvres is held out."""


def _silent(words: str) -> None:
    pass


@dataclass(frozen=True, slots=True)
class Diagnosed:
    """What differs between recordings and the simulation. `found` has all of it, of which this shows a part."""

    found: Result
    instruments: Mapping[str, InstrumentTable | str]
    """What the instruments of each recording say of each other, or why nothing."""
    complete: bool
    """Whether all of the recordings was there."""
    logs: tuple[str, ...]
    whole: _Whole | None
    """None of the kinematic part, which does not simulate."""
    kinematic: KinematicDiagnosis | None

    @property
    def verdict(self) -> str:
        """no_effect, effect_found, confounded or unexplained."""
        return self.found.verdict

    @property
    def gain(self) -> Gain | None:
        """Error of what was held out before and after; None without any."""
        return self.found.gain

    @property
    def extended(self) -> Aircraft:
        """The aircraft with the effects in it."""
        return self.found.extended

    @property
    def summary(self) -> list[str]:
        """The diagnosis in a few lines."""
        return summary(self.found)

    @property
    def effects(self) -> pd.DataFrame:
        """The effects named, by id: `value` with its 95 % interval `low` to `high`, `unit`, `sentence`,
        `confounded_with` and whether it is `suspect`."""
        import pandas as pd

        rows = [
            (e.term.id, e.value, *e.ci95, e.term.unit, e.sentence, ", ".join(e.alternatives), e.suspect)
            for e in self.found.named
        ]
        names = ["effect", "value", "low", "high", "unit", "sentence", "confounded_with", "suspect"]
        return pd.DataFrame(rows, columns=names).set_index("effect")

    def json(self) -> dict[str, Any]:
        """As `diagnose --json` writes it."""
        from station.diagnosis.diagnosis_json import as_json, kinematic_json

        if self.whole is not None:
            made = as_json(self.whole.found, self.whole.sizes) | self.whole.readings.as_json()
        else:
            assert self.kinematic is not None
            made = kinematic_json(self.kinematic)
        rows = [{"log": name, **row} for name, t in self.instruments.items() for row in lags_json(t)["lags"]]
        return made | {"lags": rows}

    def plot(self) -> Picture:
        """Measured and predicted, before and after, of the manoeuvre that changes most. Raises UsageError where nothing
        was simulated."""
        from station.diagnosis.pictures import compared, measured_and_predicted

        if self.whole is None:
            raise UsageError("the kinematic part simulates nothing: its pictures are in its report")
        return Picture(measured_and_predicted(compared(self.whole.found)))

    def report(self, folder: Path | str, *, pdf: bool = False) -> Path:
        """Write the page with pictures, as `--report` does without its Rerun recording, and with `pdf` print it beside;
        returns the page's path. Raises LogError, and UsageError where nothing prints."""
        if pdf:
            check_printable()
        page = self._write_page(Path(folder))
        if pdf:
            print_page(page)
        return page

    def _write_page(self, folder: Path) -> Path:
        from station.diagnosis.diagnosis_report import write_kinematic_report, write_report
        from station.diagnosis.pictures import compared

        if self.whole is None:
            assert self.kinematic is not None
            return write_kinematic_report(self.kinematic, folder, self.pages())
        found, readings = self.whole.found, self.whole.readings
        return write_report(found, compared(found), self.whole.sizes, folder, readings.page(), self.pages())

    def pages(self) -> list[str]:
        """The report's section on the instruments of each recording."""
        from station.identification.instrument_lag_page import lag_page  # and with it matplotlib

        several = len(self.instruments) > 1
        return [part for name, made in self.instruments.items() for part in lag_page(made, name if several else "")]

    def write_profile(self, path: Path | str) -> Path:
        """Write the extended aircraft as a profile, or with the suffix .xml as an aircraft of JSBSim, into a new file.
        Raises UsageError where it is there already."""
        path = Path(path)
        if path.exists():
            raise UsageError(f"{path}: is there already: a written profile never replaces a file; name another")
        words = "\n".join(e.sentence for e in self.found.named) or "No effect was found: the same aircraft."
        told = f"Extended by station diagnose ({self.verdict}) from {', '.join(self.logs)}.\n{words}"
        write = write_jsbsim if path.suffix == SUFFIX else write_aircraft
        write(self.extended.model_copy(update={"name": path.stem}), path, told)
        return path

    def __repr__(self) -> str:
        return f"<{'; '.join(line.strip() for line in self.summary)}>"

    def _repr_html_(self) -> str:
        from station.diagnosis.diagnosis_report import effects_table

        first, *rest = self.summary
        more = [] if self.complete else ["a recording is not complete: station info tells what is missing"]
        return heading(first) + effects_table(self.found.named) + lines([w.strip() for w in rest] + more)


@dataclass(frozen=True, slots=True)
class _Whole:
    """A diagnosis against the simulation, the sizes it would have found, and what is read in it."""

    found: Diagnosis
    sizes: Sequence[Detectable]
    readings: Readings


def diagnose(
    logs: Log | Sequence[Log],
    hold_out: Log | Sequence[Log] = (),
    *,
    aircraft: Aircraft | str | None = None,
    progress: Progress = _silent,
) -> Diagnosed:
    """Compare recordings with the simulation: what is wrong, its cause, the extended model and what it gains.

    `hold_out`: recordings for the gain only; without, the last third of the manoeuvres. `aircraft`: a profile, or its
    name or path, instead of the first recording's. `progress` is told in words what is done. Raises LogError,
    UsageError and ProfileError.
    """
    from station.diagnosis.measured_record import why_not_flown

    fitting, holding = _paths(logs), _paths(hold_out)
    if not fitting:
        raise UsageError("no recording to diagnose: name one")
    progress(f"reading {len(fitting) + len(holding)} recordings")
    known = load_aircraft(aircraft) if isinstance(aircraft, str) else aircraft
    subject = known or metadata(fitting[0]).about.aircraft
    flown = {path: table(path) for path in (*fitting, *holding)}
    # Judged beside the simulation, which leaves the interpreter idle for half of the time.
    reader = ThreadPoolExecutor(1)
    complete = reader.submit(lambda: all(verdict(path) == "complete" for path in flown))
    reader.shutdown(wait=False)
    fitted = [_checked(path, flown[path], subject) for path in fitting]
    kept = [_checked(path, flown[path], subject) for path in holding]
    tables = meanwhile(of_recording, [(x.table, subject, x.imu_position, x.noise) for x, _ in fitted])
    names = tuple(path.name for path in fitting)
    lacking = why_not_flown(subject)
    if lacking or not all("elevator" in x.columns for x in flown.values()):
        progress(f"{lacking or 'a record has no elevator'}: the kinematic part only")
        made = _kinematics(fitted, kept, subject)
        return Diagnosed(made, dict(zip(names, tables(), strict=True)), complete.result(), names, None, made)
    whole = _simulated(fitted, kept, subject, progress)
    return Diagnosed(whole.found, dict(zip(names, tables(), strict=True)), complete.result(), names, whole, None)


def _paths(logs: Log | Sequence[Log]) -> list[Path]:
    several = [logs] if isinstance(logs, Recording | Path | str) else list(logs)
    found = [x.path if isinstance(x, Recording) else Path(x) for x in several]
    for path in found:
        if not path.is_file():
            raise LogError(f"{path}: no such file")
    return found


def _checked(path: Path, flown: Table, subject: Aircraft) -> Marked:
    """A recording made ready with what its rig says, and the spans of its test points (s)."""
    about = metadata(path).about
    ready = checked(path.name, flown, subject, about.noise_si(flown.aligned), about.imu_position)
    return ready, [(p.start_s, p.end_s) for p in points(path)]


def _simulated(fitted: Sequence[Marked], kept: Sequence[Marked], subject: Aircraft, progress: Progress) -> _Whole:
    """Against the simulation; without records to hold out, the last of the manoeuvres are."""
    from station.diagnosis.detectable import detectable_sizes
    from station.diagnosis.procedure import diagnose as solve
    from station.diagnosis.readings import readings_of

    records, held = ([r for ready, spans in some for r in ready.records(subject, spans)] for some in (fitted, kept))
    if not held and len(records) > 1:
        count = max(1, len(records) // HELD_OUT_SHARE)
        records, held = records[:-count], records[-count:]
    found = solve(records, held, subject, progress=progress)
    progress("sizes that would have been found")
    sizes = []
    for of_axis in (found, found.lateral):
        if of_axis is not None:
            accepted = of_axis.found.accepted
            slopes = of_axis.found.slopes if of_axis.found.terms and not accepted.state.values else None
            sizes += detectable_sizes(of_axis.problem, accepted, slopes)
    return _Whole(found, sizes, readings_of(found))


def _kinematics(fitted: Sequence[Marked], kept: Sequence[Marked], subject: Aircraft) -> KinematicDiagnosis:
    """What instruments say of each other."""
    from station.diagnosis.kinematic_diagnosis import Judged, diagnose_kinematics, judge

    def judged(some: Sequence[Marked]) -> list[Judged]:
        made = []
        for ready, spans in some:
            many = len(spans) > 1
            for k, span in enumerate(spans or [(-math.inf, math.inf)]):
                made.append(judge(f"{ready.name} #{k + 1}" if many else ready.name, ready, subject, span))
        return made

    return diagnose_kinematics(judged(fitted), judged(kept), subject)
