"""The verb diagnose: recordings against the simulation; what is wrong, its cause, the extended model, the gain."""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer
from rich.console import Console

from station.api.diagnosing import Diagnosed
from station.api.diagnosing import diagnose as solve
from station.commands.common import completing, there
from station.commands.long_work import steps
from station.commands.printing import Pdf, check_pdf, told
from station.console import DEGRADED, DONE, check_json, say, write_json
from station.diagnosis.diagnosis_result import partly_judged, summary
from station.identification.instrument_table import print_table
from station.identification.listing import WIDTH
from station.rows import LogError, UsageError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

STEPS: Final = {
    "fitting the aircraft": 0.43,
    "screening": 0.57,
    "pairs of effects": 0.7,
    "2 effects": 0.75,
    "settling": 0.83,
    "residual test": 0.87,
    "sizes": 0.92,
}
"""Share of the processor time that a diagnosis has taken when a step begins: of the bench card's two minutes with a
gyro that reads 4 % too much, pairs between their neighbours. Several effects take longer to settle."""

Logs = Annotated[list[Path], typer.Argument(metavar="LOG...", help="recordings (.mcap) to find effects in")]


def diagnose(
    logs: Logs,
    hold_out: Annotated[
        list[Path] | None, typer.Option("--hold-out", metavar="LOG", help="recording for the gain only; repeatable")
    ] = None,
    aircraft: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="instead of the recording's aircraft", autocompletion=completing("aircraft")),
    ] = None,
    as_json: Annotated[str | None, typer.Option("--json", metavar="PATH|-", help="write the result as JSON")] = None,
    report: Annotated[Path | None, typer.Option(metavar="DIR", help="write a page with pictures")] = None,
    pdf: Pdf = False,
    write_profile: Annotated[
        Path | None,
        typer.Option(
            "--write-profile", metavar="PATH", help="write the extended aircraft, a new file; .xml: for JSBSim"
        ),
    ] = None,
) -> int:
    """Compare recordings with the simulation: what is wrong, its cause, the extended model and what it gains."""
    for path in (*logs, *(hold_out or [])):
        there(path)
    check_json(as_json)
    check_pdf(pdf, report)
    if write_profile is not None and write_profile.exists():
        raise UsageError(f"{write_profile}: is there already: a written profile never replaces a file; name another")
    with steps(f"diagnosing {', '.join(path.name for path in logs)}", STEPS) as told_step:
        made = solve(logs, hold_out or [], aircraft=aircraft, progress=told_step)
    if as_json != "-":
        for name, instruments in made.instruments.items():
            print_table(instruments, Console(width=WIDTH), name)
    if report is not None:
        say("  drawing the report")
        with _rrd_beside(made, report):
            told(made.report(report), pdf)
    if write_profile is not None:
        say(str(made.write_profile(write_profile)))
    if as_json is not None:
        write_json(made.json(), as_json)
    if as_json != "-":
        more = made.whole.readings.lines() if made.whole is not None else []
        print("\n".join([*made.summary, *(f"  {line}" for line in more)]))
    if not made.complete:
        say("station: a recording is not complete: see station info")
    good = made.verdict in ("no_effect", "effect_found") and made.complete and not partly_judged(made.found)
    return DONE if good else DEGRADED


_PLOTS = 4
"""Series in the Rerun recording, those that change most."""
_WRITER = """
import pickle, sys
from station.screen.rerun_files import write_report_rrd
write_report_rrd(*pickle.load(sys.stdin.buffer))
"""


def _series(made: Diagnosed) -> Mapping[str, Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]]]:
    """What the Rerun recording shows over time."""
    if made.kinematic is not None:
        from station.diagnosis.kinematic_diagnosis import series_in_time as kinematic_series

        return kinematic_series(made.kinematic.fitted)
    from station.diagnosis.pictures import compared, series_in_time

    assert made.whole is not None
    return series_in_time(compared(made.whole.found), _PLOTS)[1]


@contextmanager
def _rrd_beside(made: Diagnosed, folder: Path) -> Iterator[None]:
    """The report's verdict and series as a Rerun recording, written by another process while this one draws the page:
    either library takes a second to import."""
    first, *lines = summary(made.found)
    words = "\n".join([f"# {first}", *(f"- {line.strip()}" for line in lines)])
    path = folder / "diagnosis.rrd"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LogError(f"{folder}: cannot be written: {error.strerror}") from error
    given = pickle.dumps((words, _series(made), path, first))
    with ThreadPoolExecutor(1) as pool:
        writer = pool.submit(subprocess.run, [sys.executable, "-c", _WRITER], input=given, capture_output=True)
        yield
        done = writer.result()
    if done.returncode:
        raise LogError(f"{path}: cannot be written: {done.stderr.decode(errors='replace').strip().splitlines()[-1]}")
    say(str(path))
