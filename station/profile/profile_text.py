"""An aircraft as a profile file, in SI, written beside the old one."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel

from station.conventions import from_si
from station.profile.aircraft import Aircraft, Instrument
from station.profile.files import read_text
from station.profile.quantity import unit_of
from station.rows import LogError, UsageError

_STILL: Final = Instrument()


def to_toml(aircraft: Aircraft, heading: str) -> str:
    """A profile's text, in SI; `heading` comes first, as comments."""
    lines = [f"# {line}" for line in heading.splitlines()]
    sections = []
    for name, field in Aircraft.model_fields.items():
        value = getattr(aircraft, name)
        if isinstance(value, BaseModel | dict):
            sections.append((name, value, unit_of(field)))
        elif not _is_empty(value):
            lines.append(f"{name} = {_text(value, unit_of(field))}")
    for name, content, unit in sections:
        table = _texts(content, unit, _STILL if name == "instruments" else None)
        if table:
            lines += ["", f"[{name}]", *(f"{key} = {text}" for key, text in table.items())]
    return "\n".join(lines) + "\n"


def _is_empty(value: Any) -> bool:
    return value is None or (isinstance(value, str | tuple | dict) and not value)


def _texts(content: BaseModel | dict[str, Any], unit: str, still: BaseModel | None = None) -> dict[str, str]:
    """What each key of a table is written as; `still`: what tables in it leave out."""
    if isinstance(content, BaseModel):
        fields = type(content).model_fields
        given = {key: (getattr(content, key), unit_of(field)) for key, field in fields.items()}
    else:
        given = {key: (value, unit) for key, value in content.items()}
    made = {}
    for key, (value, its) in given.items():
        if _is_empty(value):
            continue
        if still is not None and isinstance(value, type(still)):
            value = {k: v for k, v in value if v != getattr(still, k)}
            fields = type(still).model_fields
            table = {k: _text(v, unit_of(fields[k])) for k, v in value.items() if not _is_empty(v)}
            if table:
                made[key] = _inline(table)
        else:
            made[key] = _text(value, its)
    return made


def _inline(table: Mapping[str, str]) -> str:
    return "{ " + ", ".join(f"{key} = {text}" for key, text in table.items()) + " }"


def _text(value: Any, unit: str) -> str:
    if isinstance(value, BaseModel | dict):
        return _inline(_texts(value, unit))
    if isinstance(value, tuple | list):
        return "[" + ", ".join(_text(v, unit) for v in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if unit:
        return f'"{from_si(float(value), unit)!r} {unit}"'
    return repr(value) if isinstance(value, int) else repr(float(value))


def write_profile(aircraft: Aircraft, path: Path, heading: str) -> None:
    """Write a profile that reads back the same. Raises UsageError where a file is already, ProfileError where it
    would not read back, LogError where writing fails."""
    if path.exists():
        raise UsageError(f"{path}: is there already: a written profile never replaces a file; name another")
    text = to_toml(aircraft, heading)
    read_text(Aircraft, path, text)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error}") from error
