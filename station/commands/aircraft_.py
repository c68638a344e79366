"""station aircraft new: an aircraft described in a new profile."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, get_args

import typer

from station.commands.rig_ import new_file
from station.console import DONE, say, say_wrapped
from station.profile import Aircraft, read_profile
from station.rows import ProfileError, UsageError

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo


class Action(StrEnum):
    new = "new"


_LEAST_CHORD: Final = 0.8
_MOST_CHORD: Final = 1.6
"""Of span x chord over wing area: beyond the planforms that there are, short of a foot taken for a metre (0.3, 3.3)."""


@dataclass(frozen=True, slots=True)
class Question:
    """One number of a profile: where it stands, what it is, and what is lost without it; needed where that is empty."""

    table: str
    key: str
    words: str
    example: str
    without: str = ""


QUESTIONS: Final = (
    Question("geometry", "wing_area", "reference area of the wing", "0.55 m2"),
    Question("geometry", "span", "wing span", "2.1 m"),
    Question("geometry", "chord", "mean aerodynamic chord", "0.27 m"),
    Question("inertia", "mass", "all-up mass", "4.2 kg"),
    Question("inertia", "iyy", "pitch inertia", "0.35 kg m2", "no pitching moment derivatives (Cm)"),
    Question("inertia", "ixx", "roll inertia", "0.40 kg m2", "no lateral moment derivatives (Cl, Cn)"),
    Question("inertia", "izz", "yaw inertia", "0.70 kg m2", "no lateral moment derivatives (Cl, Cn)"),
    Question("boom", "vane_x", "vane ahead of the centre of gravity", "0.45 m", "the vane is not corrected for rates"),
    Question("boom", "vane_frequency", "natural frequency of the vane", "9 Hz", "9 Hz is taken"),
    Question("boom", "vane_damping", "damping ratio of the vane", "0.35", "0.35 is taken"),
    Question("boom", "upwash_body", "share by which the vane reads too much: upwash", "0.1", "10 % in all errors"),
    Question("unsteady", "tail_arm", "tail behind the centre of gravity", "0.75 m", "few derivatives in turbulence"),
    Question("drag", "zero_lift", "drag coefficient at zero lift", "0.035", "thrust is not told by drag"),
    Question("drag", "induced", "drag per square of the lift coefficient", "0.05", "the same"),
)
"""In the order in which they are asked."""


def aircraft_(
    action: Annotated[Action, typer.Argument(help="new: ask what the aircraft is and write its profile")],  # noqa: ARG001
    name: Annotated[str, typer.Argument(help="of the aircraft: letters, digits, _")],
    folder: Annotated[Path, typer.Option(metavar="DIR", help="where aircraft/ is")] = Path(),
    given: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help='like span="2.1 m"')] = None,
) -> int:
    """Ask for geometry, mass and boom, say what is lost without each, and write a commented aircraft profile."""
    path = new_file(folder, "aircraft", name)
    values = dict(_given(text) for text in given or ())
    if sys.stdin.isatty():
        _ask(values)
    lacking = [q for q in QUESTIONS if not q.without and q.key not in values]
    if lacking:
        sets = " ".join(f'--set {q.key}="{q.example}"' for q in lacking)
        raise UsageError(f"needed: {', '.join(q.key for q in lacking)}\nlike: station aircraft new {name} {sets}")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text_of(name, values), encoding="utf-8")
    try:
        read_profile(Aircraft, path)
    except ProfileError:
        path.unlink()
        raise
    if words := doubt(path):
        say(words)
    say(f'written: {path}\nnext: station rig new {name}, or aircraft = "{name}" in a card beside it (cards/)')
    return DONE


def _given(text: str) -> tuple[str, str]:
    key, is_given, value = text.partition("=")
    known = [q.key for q in QUESTIONS]
    if not is_given or key not in known:
        raise UsageError(f"--set {text}: KEY=VALUE, KEY one of {', '.join(known)}")
    return key, value.strip().strip('"')


def _ask(values: dict[str, str]) -> None:
    """What is not given yet; an empty answer leaves out what may be."""
    for q in QUESTIONS:
        while q.key not in values:
            say_wrapped(f"{q.words}, like {q.example}{f' (empty: {q.without})' if q.without else ''}")
            answer = input(f"{q.key} > ").strip()
            why = refused(q, answer) if answer else ""
            if why:
                say(f"  {answer}: {why}")
            elif answer:
                values[q.key] = answer
            elif q.without:
                break


def refused(question: Question, answer: str) -> str:
    """Why the profile would not take an answer; "" where it does."""
    from pydantic import TypeAdapter, ValidationError

    table = Aircraft.model_fields[question.table].annotation
    model = next(m for m in (table, *get_args(table)) if hasattr(m, "model_fields"))
    field: FieldInfo = model.model_fields[question.key]
    value = float(answer) if _is_number(answer) else answer
    kind: Any = Annotated[(field.annotation, *field.metadata)] if field.metadata else field.annotation
    try:
        TypeAdapter[Any](kind).validate_python(value, strict=True)
    except ValidationError as error:
        return str(error.errors()[0]["msg"])
    return ""


def doubt(path: Path) -> str:
    """Where area, span and chord do not belong together: a mean aerodynamic chord is area over span for a rectangular
    wing, and 4/3 of that for a pointed one."""
    g = read_profile(Aircraft, path).geometry
    ratio = g.span * g.chord / g.wing_area
    if _LEAST_CHORD <= ratio <= _MOST_CHORD:
        return ""
    return f"span x chord is {ratio:.2g} times the wing area, where 1 to 1.33 is usual: is one of the units wrong?"


def text_of(name: str, values: dict[str, str]) -> str:
    """The profile's TOML: what is known, and as comments what is not."""
    lines = [
        "# Described by station aircraft new. Keys: profiles/README.md.",
        f'name = "{name}"',
        '# sources = ["where the numbers are from"]',
    ]
    # A table that is not needed is left out whole where its first key, without which it says nothing, is not known.
    first = {q.table: q for q in reversed(QUESTIONS)}
    for table in dict.fromkeys(q.table for q in QUESTIONS):
        is_there = first[table].key in values
        lines += ["", f"{'' if is_there else '# '}[{table}]"]
        for q in (q for q in QUESTIONS if q.table == table):
            value = values.get(q.key, q.example) if is_there else q.example
            quoted = value if _is_number(value) else f'"{value}"'
            is_known = is_there and q.key in values
            note = q.words if is_known else f"{q.words}: without it {q.without}"
            lines.append(f"{'' if is_known else '# '}{q.key} = {quoted} # {note}")
        if table == "unsteady" and is_there:
            lines.append("memory = false # quasi-steady lift; true with the indicial responses that physical needs")
    if "vane_x" in values and "upwash_body" not in values:
        lines += _UPWASH_UNKNOWN
    return "\n".join([*lines, *_DERIVATIVES]) + "\n"


_UPWASH_UNKNOWN: Final = (
    "",
    "[uncertainty]",
    "vane_scale = 0.1 # as long as the upwash is not known: station calibrate and station planform tell it",
)
_DERIVATIVES: Final = (
    "",
    "# Derivatives are estimated without priors. Known ones serve simulation and diagnosis (per rad, q c/2V):",
    "# [derivatives]",
    '# CL_alpha = { value = 5.0, sd = 0.5, source = "vortex lattice" }',
    '# Cm_alpha = { value = -0.9, sd = 0.2, source = "vortex lattice" }',
)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
