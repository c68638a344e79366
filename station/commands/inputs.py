"""station inputs: what a card asks to be flown, as a table for an autopilot."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from station.commands.common import CardName, finite
from station.console import DONE, check_json, say, write_json
from station.profile import Card, Manoeuvre, load_card
from station.rows import LogError, UsageError

HIGH_PEAK_FACTOR = 1.15
"""Morelli's bound on a multisine's relative peak factor: more peak than that for its power can be had for less."""
CORRELATED = 0.1
"""Above which surfaces that move together are told."""


def inputs(
    card: CardName = "multisine",
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="CSV", help="write time and surfaces, added to trim")
    ] = None,
    rate: Annotated[float, typer.Option(help="rows a second of the CSV", min=1.0, max=1000.0, callback=finite)] = 50.0,
    as_json: Annotated[str | None, typer.Option("--json", metavar="PATH|-", help="harmonics with phases")] = None,
    step: Annotated[int | None, typer.Option(metavar="N", help="of the card's steps, from 1", min=1)] = None,
) -> int:
    """Show what a card, or a step of it, asks to be flown, and write it for an autopilot."""
    from station.simulation.input_table import input_table

    check_json(as_json)
    profile = load_card(card).card
    manoeuvres, name = _asked(profile, step)
    made = input_table(manoeuvres, rate)
    if out is not None:
        say(f"{out}: {_write(out, made, name)} rows, {rate:g} a second")
    if as_json is not None:
        of = {} if step is None else {"step": step, "name": profile.steps[step - 1].name}
        write_json(_json(profile.name, manoeuvres, made) | of, as_json)
    if as_json != "-":
        for line in _listing(manoeuvres, made):
            print(line)
    return DONE


def _asked(card: Card, number: int | None) -> tuple[tuple[Manoeuvre, ...], str]:
    """What the card flies unasked, or its step of that number; and of what it is. Raises UsageError."""
    steps = card.steps
    if number is None and card.manoeuvres:
        return card.manoeuvres, f"card {card.name}"
    moving = "; ".join(f"{k} {s.name}" for k, s in enumerate(steps, 1) if s.inputs)
    listed = f"\n--step N, of {moving}" if moving else ""
    if number is None and listed:
        raise UsageError(f"card {card.name}: its inputs are those of its steps: say of which{listed}")
    if number is None:
        raise UsageError(
            f"card {card.name}: it has no manoeuvres, nor a step with inputs\n"
            "add [[manoeuvres]], as in profiles/cards/bench.toml, or [[steps]], as in guided.toml"
        )
    if number > len(steps):
        raise UsageError(f"card {card.name}: no step {number}: it has {len(steps)}{listed}")
    found = steps[number - 1]
    if not found.inputs:
        raise UsageError(f"card {card.name}: step {number}, {found.name}, is steady: nothing moves in it{listed}")
    return found.inputs, f"card {card.name}, step {number}: {found.name}"


def _words(m: Manoeuvre) -> str:
    match m.kind:
        case "doublet":
            return f"doublet, {m.width:g} s halves"
        case "3-2-1-1":
            return f"3-2-1-1, {m.unit:g} s units"
        case "pulse":
            return f"pulse, {m.width:g} s"
        case _:
            return f"{m.kind}, {m.duration:g} s, {m.low:g} to {m.high:g} Hz"


def _listing(manoeuvres: Sequence[Manoeuvre], made: Any) -> Iterator[str]:
    from station.simulation.manoeuvres import duration

    yield f"{'from s':>7}{'to s':>8}{'every s':>9}  {'surface':<9}{'peak deg':>8}  input"
    for m, wave in zip(manoeuvres, made.waves, strict=True):
        every = f"{m.repeat:g}" if m.repeat else "-"
        lines = f": {len(wave.harmonics)} harmonics" if wave else ""
        ends = f"{m.start:>7g}{m.start + duration(m):>8g}{every:>9}"
        yield f"{ends}  {m.surface:<9}{math.degrees(m.amplitude):>+8.3g}  {_words(m)}{lines}"
    names = list(made.surfaces)
    waved = [m.surface for m, wave in zip(manoeuvres, made.waves, strict=True) if wave]
    for name, factor in made.relative_peak_factors.items():
        if name in waved and waved.count(name) == [m.surface for m in manoeuvres].count(name):
            more = f", above {HIGH_PEAK_FACTOR:g}: a longer one peaks less" if factor > HIGH_PEAK_FACTOR else ""
            yield f"{name}: relative peak factor {factor:.3f}{more}"
    for i, one in enumerate(names):
        for j in range(i):
            found = float(made.correlation[i, j])
            more = ": they do not tell their effects apart" if abs(found) > CORRELATED else ""
            yield f"{names[j]} with {one}: correlation {found:.1e}{more}"


def _write(out: Path, made: Any, of: str) -> int:
    """The CSV, as `station import` would read it; the number of rows. Raises LogError."""
    names = list(made.surfaces)
    lines = [",".join(["time [s]", *(f"{n} [rad]" for n in names)]), f"# {of}: added to each surface's trim"]
    for t, *row in zip(made.t_s.tolist(), *(x.tolist() for x in made.surfaces.values()), strict=True):
        lines.append(",".join([f"{t:.10g}", *(f"{x:.12g}" for x in row)]))
    try:
        with out.open("x", encoding="utf-8") as file:
            file.write("\n".join(lines) + "\n")
    except FileExistsError as error:
        raise LogError(f"{out}: exists already, and is not overwritten") from error
    except OSError as error:
        raise LogError(f"{out}: cannot be written: {error.strerror}") from error
    return len(made.t_s)


def _json(card: str, manoeuvres: Sequence[Manoeuvre], made: Any) -> dict[str, Any]:
    from station.simulation.manoeuvres import duration

    rows = []
    for m, wave in zip(manoeuvres, made.waves, strict=True):
        row: dict[str, Any] = {
            "surface": m.surface,
            "kind": m.kind,
            "start_s": m.start,
            "duration_s": duration(m),
            "repeat_s": m.repeat,
            "amplitude_rad": m.amplitude,
        }
        if wave:
            each = m.amplitude / wave.peak
            pairs = zip(wave.harmonics, wave.phases, strict=True)
            row["relative_peak_factor"] = wave.relative_peak_factor
            row["harmonics"] = [
                {"frequency_hz": k / duration(m), "amplitude_rad": each, "phase_rad": phase} for k, phase in pairs
            ]
        rows.append(row)
    names = list(made.surfaces)
    found = made.correlation.tolist()
    both = ((i, j) for i in range(len(names)) for j in range(i))
    return {
        "schema": "station.inputs/1",
        "card": card,
        "inputs": rows,
        "correlation": [
            {"surfaces": [names[j], names[i]], "value": found[i][j] if math.isfinite(found[i][j]) else None}
            for i, j in both
        ],
    }
