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

from station.console import DEGRADED, DONE, check_json, say, write_json
from station.conventions import from_si
from station.log import Table, metadata, points, table, verdict
from station.profile import Aircraft, load_aircraft
from station.rows import LogError, UsageError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from station.diagnosis.checks import Checked
    from station.diagnosis.kinematic_diagnosis import Judged
    from station.diagnosis.measured_record import Record

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
        Path | None, typer.Option("--write-profile", metavar="PATH", help="write the extended aircraft, a new file")
    ] = None,
) -> int:
    """Compare recordings with the simulation: what is wrong, its cause, the extended model and what it gains."""
    from station.diagnosis.diagnosis_json import as_json as to_json
    from station.diagnosis.measured_record import why_not_flown
    from station.diagnosis.procedure import diagnose as solve

    subject = load_aircraft(aircraft) if aircraft else None
    for path in (*logs, *(hold_out or [])):
        if not path.is_file():
            raise LogError(f"{path}: no such file")
    check_json(as_json)
    if write_profile is not None and write_profile.exists():
        raise UsageError(f"{write_profile}: is there already: an extended profile never replaces a file; name another")
    say(f"  reading {len(logs) + len(hold_out or [])} recordings")
    subject = subject or metadata(logs[0]).about.aircraft
    flown = {path: table(path) for path in (*logs, *(hold_out or []))}
    # Judged beside the simulation, which leaves the interpreter idle for half of the time.
    reader = ThreadPoolExecutor(1)
    complete = reader.submit(lambda: all(verdict(path) == "complete" for path in flown))
    reader.shutdown(wait=False)
    lacking = why_not_flown(subject)
    if lacking or not all("elevator" in x.columns for x in flown.values()):
        say(f"{lacking or 'a record has no elevator'}: the kinematic part only")
        from station.diagnosis.kinematic_diagnosis import series_in_time, write_kinematic_report

        result, extended, judged = _kinematics(flown, logs, hold_out or [], subject)
        result = _finite(result)
        if report is not None:
            with _rrd_beside(result, series_in_time(judged), report):
                say(str(write_kinematic_report(result, judged, report)))
        reported = [e["sentence"] for e in result["effects"]]
        return _finish(result, extended, reported, logs, complete.result(), as_json, write_profile)
    fitted: list[Record] = []
    kept: list[Record] = []
    for group, paths in ((fitted, logs), (kept, hold_out or [])):
        for path in paths:
            group += _checked(path, flown[path], subject).records(subject, _spans(path))
    if not kept and len(fitted) > 1:
        count = max(1, len(fitted) // HELD_OUT_SHARE)
        fitted, kept = fitted[:-count], fitted[-count:]
    found = solve(fitted, kept, subject, progress=lambda words: say(f"  {words}"))
    result = _finite(to_json(found))
    if report is not None:
        say("  drawing the report")
        from station.diagnosis.diagnosis_report import write_report  # and with it matplotlib
        from station.diagnosis.pictures import series_in_time as in_time

        with _rrd_beside(result, in_time(found, found.before, found.after, _PLOTS)[1], report):
            say(str(write_report(found, result, report)))
    reported = [e.term.words(e.value) for e in found.effects]
    return _finish(result, found.extended, reported, logs, complete.result(), as_json, write_profile)


def _kinematics(
    flown: Mapping[Path, Table], logs: Sequence[Path], hold_out: Sequence[Path], subject: Aircraft
) -> tuple[dict[str, Any], Aircraft, list[Judged]]:
    """What instruments say of each other: the result, the extended aircraft, and the records with their pictures."""
    from station.diagnosis.kinematic_diagnosis import diagnose_kinematics, judge

    def judged(path: Path) -> list[Judged]:
        whole, spans = _checked(path, flown[path], subject), _spans(path) or [(-math.inf, math.inf)]
        names = [path.name] if len(spans) == 1 else [f"{path.name} #{k + 1}" for k in range(len(spans))]
        return [judge(name, whole, subject, span) for name, span in zip(names, spans, strict=True)]

    fitted = [j for path in logs for j in judged(path)]
    result, extended = diagnose_kinematics(fitted, [j for path in hold_out for j in judged(path)], subject)
    return result, extended, fitted


_PLOTS = 4
"""Series in the Rerun recording, those that change most."""
_WRITER = """
import pickle, sys
from station.screen.rerun_page import write_report_rrd
write_report_rrd(*pickle.load(sys.stdin.buffer))
"""


@contextmanager
def _rrd_beside(
    result: Mapping[str, Any],
    series: Mapping[str, Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]]],
    folder: Path,
) -> Iterator[None]:
    """The report's verdict and series as a Rerun recording, written by another process while this one draws the page:
    either library takes a second to import."""
    first, *lines = summary(result)
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


def _finish(
    result: Mapping[str, Any],
    extended: Aircraft,
    reported: Sequence[str],
    logs: Sequence[Path],
    complete: bool,
    as_json: str | None,
    write_profile: Path | None,
) -> int:
    """Write the profile and the JSON, say the verdict; the exit code."""
    from station.diagnosis.extension import write_profile as write

    if write_profile is not None:
        words = "\n".join(reported) or "No effect was found: the same aircraft."
        heading = f"Extended by station diagnose ({result['verdict']}) from {', '.join(p.name for p in logs)}.\n{words}"
        write(extended.model_copy(update={"name": write_profile.stem}), write_profile, heading)
        say(str(write_profile))
    if as_json is not None:
        write_json(result, as_json)
    if as_json != "-":
        print("\n".join(summary(result)))
    if not complete:
        say("station: a recording is not complete: see station info")
    # Of the kinematic part alone, all must have been judged but what rests on aerodynamics.
    whole = len(result.get("not_judged", ())) <= 1
    good = result["verdict"] in ("no_effect", "effect_found") and complete and whole
    return DONE if good else DEGRADED


def _checked(path: Path, flown: Table, subject: Aircraft) -> Checked:
    """A recording made ready, with what its rig says."""
    from station.diagnosis.checks import checked

    about = metadata(path).about
    return checked(path.name, flown, subject, about.noise_si(flown.aligned), about.imu_position)


def _spans(path: Path) -> list[tuple[float, float]]:
    return [(p.start_s, p.end_s) for p in points(path)]


def _finite(value: Any) -> Any:
    """JSON has no NaN: null in its place."""
    if isinstance(value, Mapping):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value


def summary(result: Mapping[str, Any]) -> list[str]:
    """The diagnosis in a few lines."""
    names = {"no_effect": "no effect found", "effect_found": "found", "confounded": "found, but confounded",
             "unexplained": "UNEXPLAINED: the named effects are suspect"}  # fmt: skip
    partly = " in what could be judged" if len(result.get("not_judged", ())) > 1 else ""
    lines = [f"{result['aircraft']}: {names[result['verdict']]}{partly}"]
    if doubt := result.get("with_model_error"):
        missed = ", ".join(f"{100 * v:.0f} % of {n}" for n, v in doubt["missed"].items())
        lines.append(f"  the model of the aircraft does not suffice: freed, it still misses {missed}")
    for e in result["effects"]:
        low, high = e["ci95"]
        shown = e.get("shown", e["unit"])
        span = f"{from_si(low, shown):.3g} to {from_si(high, shown):.3g}{'' if shown == '1' else f' {shown}'}"
        lines.append(f"  {e['id']}: {e['sentence']} (95 %: {span})")
        if e["confounded_with"]:
            lines.append(f"    could also be {', '.join(e['confounded_with'])}; to separate: {e['separate_by']}")
    left = result["unexplained"]
    if left["present"]:
        low, high = left["band_hz"]
        lines.append(f"  left over: {', '.join(left['signals'])}, {low:.2f} to {high:.2f} Hz")
    gain = result["gain"]
    if gain is not None:
        low, high = gain["ci95"]
        lines.append(
            f"  held-out error {gain['before']:.3f} -> {gain['after']:.3f}: "
            f"{gain['reduction_percent']:.1f} % less (95 %: {low:.1f} to {high:.1f})"
        )
    lines += [f"  {remark}" for remark in result["remarks"]]
    return lines
