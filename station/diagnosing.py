"""The verb diagnose: recordings against the simulation; what is wrong, its cause, the extended model, the gain."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from station.discrepancy.record import Record, manoeuvres
from station.log import metadata, points, summarise, table
from station.postflight import DEGRADED, DONE, say
from station.profile import Aircraft, load_aircraft
from station.rows import LogError, UsageError

app = typer.Typer()

HELD_OUT_SHARE = 3
"""Without --hold-out, the last of every so many manoeuvres is held out."""

Logs = Annotated[list[Path], typer.Argument(metavar="LOG...", help="recordings (.mcap) to find effects in")]


@app.command()
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
    from station.discrepancy.diagnosis import as_json as to_json
    from station.discrepancy.diagnosis import diagnose as solve
    from station.discrepancy.extension import write_profile as write

    subject = load_aircraft(aircraft) if aircraft else None
    if write_profile is not None and write_profile.exists():
        raise UsageError(f"{write_profile}: is there already: an extended profile never replaces a file; name another")
    fitted: list[Record] = []
    kept: list[Record] = []
    complete = True
    for group, paths in ((fitted, logs), (kept, hold_out or [])):
        for path in paths:
            own, whole, pieces = _read(path, subject)
            subject = subject or own
            complete &= whole
            group += pieces
    assert subject is not None
    if not kept and len(fitted) > 1:
        count = max(1, len(fitted) // HELD_OUT_SHARE)
        fitted, kept = fitted[:-count], fitted[-count:]
    found = solve(fitted, kept, subject, progress=lambda words: say(f"  {words}"))
    result = _finite(to_json(found))
    if report is not None:
        from station.discrepancy.report import write_report  # and with it matplotlib

        say(str(write_report(found, result, report)))
    if write_profile is not None:
        words = "\n".join(e.term.words(e.value) for e in found.effects) or "No effect was found: the same aircraft."
        heading = f"Extended by station diagnose ({found.verdict}) from {', '.join(p.name for p in logs)}.\n{words}"
        named = found.extended.model_copy(update={"name": write_profile.stem})
        write(named, write_profile, heading)
        say(str(write_profile))
    if as_json == "-":
        print(json.dumps(result, allow_nan=False))
    else:
        if as_json is not None:
            try:
                Path(as_json).write_text(json.dumps(result, indent=1, allow_nan=False), encoding="utf-8")
            except OSError as error:
                raise LogError(f"{as_json}: cannot be written: {error}") from error
        print("\n".join(summary(result)))
    if not complete:
        say("station: a recording is not complete: see station info")
    good = found.verdict in ("no_effect", "effect_found") and complete
    return DONE if good else DEGRADED


def _read(path: Path, subject: Aircraft | None) -> tuple[Aircraft, bool, list[Record]]:
    """The aircraft, whether the recording is complete, and its manoeuvres."""
    if not path.is_file():
        raise LogError(f"{path}: no such file")
    flown = table(path)
    about = metadata(path).about
    found = manoeuvres(
        path.name,
        flown.t_s,
        {**flown.extra, **flown.columns},
        subject or flown.aircraft,
        [(p.start_s, p.end_s) for p in points(path)],
    )
    if about.rig is not None:
        noise = about.rig.noise_si() if about.imported else about.rig.frame_noise_si()
        found = [replace(r, imu=about.rig.imu_position, stated=noise) for r in found]
    return flown.aircraft, summarise(path).verdict == "complete", found


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
    lines = [f"{result['aircraft']}: {names[result['verdict']]}"]
    for e in result["effects"]:
        low, high = e["ci95"]
        lines.append(f"  {e['id']}: {e['sentence']} (95 %: {low:.4g} to {high:.4g} {e['unit']})")
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
