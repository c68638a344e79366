"""The verb diagnose: recordings against the simulation; what is wrong, its cause, the extended model, the gain."""

from __future__ import annotations

import math
import pickle
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from station.commands.common import there
from station.console import DEGRADED, DONE, check_json, say, write_json
from station.convert.jsbsim_aircraft import SUFFIX, write_jsbsim
from station.diagnosis.checks import Checked, checked
from station.diagnosis.diagnosis_result import Result, partly_judged, summary
from station.identification.instrument_table import InstrumentTable, of_recording, print_table
from station.identification.instrument_table import as_json as lags_json
from station.identification.listing import WIDTH
from station.log import Table, metadata, points, table, verdict
from station.profile import Aircraft, load_aircraft
from station.profile.profile_text import write_profile as write_aircraft
from station.rows import LogError, UsageError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from station.diagnosis.kinematic_diagnosis import KinematicDiagnosis
    from station.diagnosis.procedure import Diagnosis

Marked = tuple[Checked, list[tuple[float, float]]]

HELD_OUT_SHARE = 3
"""Without --hold-out, the last of every so many manoeuvres is held out."""

Logs = Annotated[list[Path], typer.Argument(metavar="LOG...", help="recordings (.mcap) to find effects in")]


def diagnose(
    logs: Logs,
    hold_out: Annotated[
        list[Path] | None, typer.Option("--hold-out", metavar="LOG", help="recording for the gain only; repeatable")
    ] = None,
    aircraft: Annotated[str | None, typer.Option(metavar="NAME", help="instead of the recording's aircraft")] = None,
    as_json: Annotated[str | None, typer.Option("--json", metavar="PATH|-", help="write the result as JSON")] = None,
    report: Annotated[Path | None, typer.Option(metavar="DIR", help="write a page with pictures")] = None,
    write_profile: Annotated[
        Path | None,
        typer.Option(
            "--write-profile", metavar="PATH", help="write the extended aircraft, a new file; .xml: for JSBSim"
        ),
    ] = None,
) -> int:
    """Compare recordings with the simulation: what is wrong, its cause, the extended model and what it gains."""
    from station.diagnosis.measured_record import why_not_flown

    for path in (*logs, *(hold_out or [])):
        there(path)
    check_json(as_json)
    if write_profile is not None and write_profile.exists():
        raise UsageError(f"{write_profile}: is there already: a written profile never replaces a file; name another")
    say(f"  reading {len(logs) + len(hold_out or [])} recordings")
    subject = load_aircraft(aircraft) if aircraft else metadata(logs[0]).about.aircraft
    flown = {path: table(path) for path in (*logs, *(hold_out or []))}
    # Judged beside the simulation, which leaves the interpreter idle for half of the time.
    reader = ThreadPoolExecutor(1)
    complete = reader.submit(lambda: all(verdict(path) == "complete" for path in flown))
    reader.shutdown(wait=False)
    fitted = [_checked(path, flown[path], subject) for path in logs]
    kept = [_checked(path, flown[path], subject) for path in hold_out or []]
    tables = {x.name: of_recording(x.table, subject, x.imu_position, x.noise) for x, _ in fitted}
    if as_json != "-":
        for name, made in tables.items():
            print_table(made, Console(width=WIDTH), name)
    lacking = why_not_flown(subject)
    found: Result
    more: list[str] = []
    if lacking or not all("elevator" in x.columns for x in flown.values()):
        say(f"{lacking or 'a record has no elevator'}: the kinematic part only")
        found, written = _kinematics(fitted, kept, subject, tables, report)
    else:
        found, written, more = _whole(fitted, kept, subject, tables, report)
    written |= {"lags": [{"log": name, **row} for name, made in tables.items() for row in lags_json(made)["lags"]]}
    if write_profile is not None:
        _write(found, write_profile, logs)
    if as_json is not None:
        write_json(written, as_json)
    if as_json != "-":
        print("\n".join([*summary(found), *(f"  {line}" for line in more)]))
    if not complete.result():
        say("station: a recording is not complete: see station info")
    good = found.verdict in ("no_effect", "effect_found") and complete.result() and not partly_judged(found)
    return DONE if good else DEGRADED


def _checked(path: Path, flown: Table, subject: Aircraft) -> Marked:
    """A recording made ready with what its rig says, and the spans of its test points (s)."""
    about = metadata(path).about
    ready = checked(path.name, flown, subject, about.noise_si(flown.aligned), about.imu_position)
    return ready, [(p.start_s, p.end_s) for p in points(path)]


def _whole(
    fitted: Sequence[Marked],
    kept: Sequence[Marked],
    subject: Aircraft,
    tables: Mapping[str, InstrumentTable | str],
    report: Path | None,
) -> tuple[Diagnosis, dict[str, Any], list[str]]:
    """Against the simulation, the same as JSON, and what else is printed; without records to hold out, the last of the
    manoeuvres are."""
    from station.diagnosis.detectable import detectable_sizes
    from station.diagnosis.diagnosis_json import as_json
    from station.diagnosis.procedure import diagnose as solve
    from station.diagnosis.readings import readings_of

    records, held = ([r for ready, spans in some for r in ready.records(subject, spans)] for some in (fitted, kept))
    if not held and len(records) > 1:
        count = max(1, len(records) // HELD_OUT_SHARE)
        records, held = records[:-count], records[-count:]
    found = solve(records, held, subject, progress=lambda words: say(f"  {words}"))
    say("  sizes that would have been found")
    accepted = found.found.accepted
    sizes = detectable_sizes(found.problem, accepted, None if accepted.state.values else found.found.slopes)
    readings = readings_of(found)
    if report is not None:
        say("  drawing the report")
        from station.diagnosis.diagnosis_report import write_report  # and with it matplotlib
        from station.diagnosis.pictures import compared, series_in_time

        shown = compared(found)
        with _rrd_beside(found, series_in_time(shown, _PLOTS)[1], report):
            say(str(write_report(found, shown, sizes, report, readings.page(), _pages(tables))))
    return found, as_json(found, sizes) | readings.as_json(), readings.lines()


def _kinematics(
    fitted: Sequence[Marked],
    kept: Sequence[Marked],
    subject: Aircraft,
    tables: Mapping[str, InstrumentTable | str],
    report: Path | None,
) -> tuple[KinematicDiagnosis, dict[str, Any]]:
    """What instruments say of each other, and the same as JSON."""
    from station.diagnosis.diagnosis_json import kinematic_json
    from station.diagnosis.kinematic_diagnosis import Judged, diagnose_kinematics, judge, series_in_time

    def judged(some: Sequence[Marked]) -> list[Judged]:
        made = []
        for ready, spans in some:
            many = len(spans) > 1
            for k, span in enumerate(spans or [(-math.inf, math.inf)]):
                made.append(judge(f"{ready.name} #{k + 1}" if many else ready.name, ready, subject, span))
        return made

    found = diagnose_kinematics(judged(fitted), judged(kept), subject)
    if report is not None:
        from station.diagnosis.diagnosis_report import write_kinematic_report

        with _rrd_beside(found, series_in_time(found.fitted), report):
            say(str(write_kinematic_report(found, report, _pages(tables))))
    return found, kinematic_json(found)


def _pages(tables: Mapping[str, InstrumentTable | str]) -> list[str]:
    """The report's section on the instruments of each recording."""
    from station.identification.instrument_lag_page import lag_page  # and with it matplotlib

    return [part for name, made in tables.items() for part in lag_page(made, name if len(tables) > 1 else "")]


_PLOTS = 4
"""Series in the Rerun recording, those that change most."""
_WRITER = """
import pickle, sys
from station.screen.rerun_page import write_report_rrd
write_report_rrd(*pickle.load(sys.stdin.buffer))
"""


@contextmanager
def _rrd_beside(
    found: Result,
    series: Mapping[str, Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]]],
    folder: Path,
) -> Iterator[None]:
    """The report's verdict and series as a Rerun recording, written by another process while this one draws the page:
    either library takes a second to import."""
    first, *lines = summary(found)
    words = "\n".join([f"# {first}", *(f"- {line.strip()}" for line in lines)])
    path = folder / "diagnosis.rrd"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LogError(f"{folder}: cannot be written: {error.strerror}") from error
    given = pickle.dumps((words, series, path, first))
    with ThreadPoolExecutor(1) as pool:
        writer = pool.submit(subprocess.run, [sys.executable, "-c", _WRITER], input=given, capture_output=True)
        yield
        done = writer.result()
    if done.returncode:
        raise LogError(f"{path}: cannot be written: {done.stderr.decode(errors='replace').strip().splitlines()[-1]}")
    say(str(path))


def _write(found: Result, path: Path, logs: Sequence[Path]) -> None:
    """The extended aircraft as a profile, or as an aircraft of JSBSim."""
    words = "\n".join(e.sentence for e in found.named) or "No effect was found: the same aircraft."
    heading = f"Extended by station diagnose ({found.verdict}) from {', '.join(p.name for p in logs)}.\n{words}"
    write = write_jsbsim if path.suffix == SUFFIX else write_aircraft
    write(found.extended.model_copy(update={"name": path.stem}), path, heading)
    say(str(path))
