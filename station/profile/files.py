"""Profiles in files: found by name, read, checked against each other, explained when wrong."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

from pydantic import BaseModel, ValidationError

from station.profile.aircraft import Aircraft
from station.profile.altered import AlteredAircraft
from station.profile.card import Card
from station.profile.quantity import SI_NUMBERS, Frozen, nearest
from station.profile.rig import Rig
from station.rows import ProfileError

T = TypeVar("T", bound=BaseModel)


def profiles_dir() -> Path:
    """Where the shipped profiles are: the checkout's profiles/, or the copy inside an installed wheel."""
    package = Path(__file__).resolve().parents[1]
    checkout = package.parent / "profiles"
    return checkout if (checkout / "cards").is_dir() else package / "profiles"


LONGEST_NAME: Final = 200
"""Of a file, less than the 255 bytes that systems allow."""


Kind = Literal["aircraft", "rigs", "cards", "campaigns"]


def named(kind: Kind, *more: Path) -> tuple[str, ...]:
    """Names of the shipped profiles of a kind, and of those in `more` folders."""
    return tuple(sorted({p.stem for f in (*more, profiles_dir() / kind) for p in f.glob("*.toml")}))


def find(kind: Kind, name: str, beside: Path | None = None) -> Path:
    """The file of a profile given by name or path. Raises ProfileError listing the known names."""
    given = Path(name)
    if any(len(part) > LONGEST_NAME for part in given.parts):
        raise ProfileError(f"no {kind.rstrip('s')} has a name of more than {LONGEST_NAME} letters: {name[:40]}...")
    if given.suffix == ".toml" or "/" in name:
        places: list[Path] = [given, beside.parent / given] if beside else [given]
        for path in places:
            if path.is_file():
                return path
        raise ProfileError(f"no such file: {name}")
    there: tuple[Path, ...] = (beside.parent.parent / kind,) if beside else ()
    for folder in (*there, profiles_dir() / kind):
        if (folder / f"{name}.toml").is_file():
            return folder / f"{name}.toml"
    known = named(kind, *there)
    raise ProfileError(f"no {kind.rstrip('s')} named {name}{nearest(name, known)}\nknown: {', '.join(known)}")


def load_aircraft(name: str, beside: Path | None = None) -> Aircraft:
    """An aircraft by name or path. Raises ProfileError."""
    return read_profile(Aircraft, find("aircraft", name, beside))


def load_rig(name: str, beside: Path | None = None) -> Rig:
    """A rig by name or path. Raises ProfileError."""
    return read_profile(Rig, find("rigs", name, beside))


class Profiles(Frozen):
    """Everything a flight needs, and the text it was read from (kept in the recording)."""

    aircraft: Aircraft
    rig: Rig
    card: Card
    rig_file: Path = Path()
    """Where the rig was read from; of a recording, nowhere."""
    emulated: Aircraft | None = None
    """What the emulated aircraft is, where `aircraft` is not."""

    @property
    def flown(self) -> Aircraft:
        """The emulated aircraft."""
        return self.emulated or self.aircraft

    @property
    def emulated_words(self) -> str:
        """What is emulated, to be added to a sentence; nothing where it is what the station takes it for."""
        return "" if self.flown.name == self.aircraft.name else f", emulated as {self.flown.name}"

    @property
    def rig_dir(self) -> Path:
        """Where the rig's file lies: its DBC files are beside it."""
        return self.rig_file.parent


def load_card(name: str, overrides: Mapping[str, Any] | None = None) -> Profiles:
    """A card with its aircraft and rig, checked against each other. Raises ProfileError.

    `overrides` replace the card's values by dotted key, {"flight.gust_sigma": "5 ft/s"}.
    """
    path = find("cards", name)
    card = read_profile(Card, path, overrides)
    aircraft = load_aircraft(card.aircraft, path)
    emulated = load_aircraft(card.emulated_aircraft, path) if card.emulated_aircraft is not None else None
    try:
        AlteredAircraft(emulated or aircraft, card.flight.truth)
    except ProfileError as error:
        raise ProfileError(f"{path}: {error}") from None
    rig_path = find("rigs", card.rig, path)
    rig = read_profile(Rig, rig_path)
    given = {signal for stream in rig.streams() for signal in stream.signals} | rig.derived.keys()
    for signal in card.needs:
        if signal not in given:
            near = nearest(signal, tuple(given))
            raise ProfileError(f"{path}: needs: no device of rig {rig.name} gives {signal}{near}")
    devices = {d.name: d for d in rig.devices}
    for i, fault in enumerate(card.faults):
        if fault.device not in devices:
            raise ProfileError(
                f"{path}: faults[{i}].device: rig {rig.name} has no device {fault.device}"
                f"{nearest(fault.device, tuple(devices))}"
            )
        streams = tuple(s.name for s in devices[fault.device].streams)
        if fault.stream is not None and fault.stream not in streams:
            near = nearest(fault.stream, streams)
            raise ProfileError(f"{path}: faults[{i}].stream: {fault.device} has no stream {fault.stream}{near}")
        signals = tuple(n for s in devices[fault.device].streams if fault.stream in (None, s.name) for n in s.signals)
        if fault.signal is not None and fault.signal not in signals:
            near = nearest(fault.signal, signals)
            raise ProfileError(f"{path}: faults[{i}].signal: {fault.device} does not give {fault.signal} there{near}")
        if fault.kind == "wrong" and fault.signal is None:
            raise ProfileError(f"{path}: faults[{i}].signal: missing: which signal is to be wrong?")
    return Profiles(aircraft=aircraft, rig=rig, card=card, rig_file=rig_path, emulated=emulated)


def read_profile(kind: type[T], path: Path, overrides: Mapping[str, Any] | None = None) -> T:
    """A profile file of that kind, its values replaced by dotted key. Raises ProfileError."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ProfileError(f"{path}: cannot be read: {error}") from error
    return read_text(kind, path, text, overrides)


def read_text(kind: type[T], path: Path, text: str, overrides: Mapping[str, Any] | None = None) -> T:
    """The same of a file's text, whether it is written yet or not. Raises ProfileError."""
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ProfileError(f"{path}: not valid TOML: {error}") from error
    for key, value in (overrides or {}).items():
        _override(raw, key, value)
    try:
        return kind.model_validate(raw)
    except ValidationError as error:
        raise ProfileError(explain(path, kind, error)) from None


def to_json(profile: BaseModel) -> str:
    """A profile as JSON in SI, for keeping in a recording; `from_json` reads it back the same."""
    return profile.model_dump_json(exclude_none=True)


def from_json(kind: type[T], text: str) -> T:
    """A profile kept in a recording. Raises ProfileError."""
    try:
        found: T = _decoded(kind, text)
        return found
    except ValidationError as error:
        raise ProfileError(explain(Path("recording"), kind, error)) from None


@lru_cache(maxsize=8)
def _decoded(kind: type[BaseModel], text: str) -> Any:
    """Kept, as profiles are frozen and each file of a recording carries the same ones."""
    return kind.model_validate_json(text, context=SI_NUMBERS)


def _override(raw: dict[str, Any], key: str, value: Any) -> None:
    *folders, last = key.split(".")
    place: Any = raw
    try:
        for folder in folders:
            place = place[int(folder)] if isinstance(place, list) else place.setdefault(folder, {})
        place[int(last) if isinstance(place, list) else last] = value
    except (AttributeError, IndexError, TypeError, ValueError):
        raise ProfileError(f"no place for {key} in the card: write section.key or list.number.key") from None


def explain(path: Path, kind: type[BaseModel], error: ValidationError) -> str:
    """The first problem, with its key, what is wrong and the nearest valid key."""
    problems = sorted(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")  # misspelt first
    first = problems[0]
    key = "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in first["loc"]).lstrip(".")
    if first["type"] == "extra_forbidden":
        word = str(first["loc"][-1])
        message = f"unknown key{nearest(word, _keys(kind))}"
    elif first["type"] == "missing":
        message = "missing key"
    elif first["type"] == "literal_error":
        message = _unknown(first["input"], first["ctx"]["expected"])
    elif first["type"] == "union_tag_invalid":
        key += "." + first["ctx"]["discriminator"].strip("'")
        message = _unknown(first["ctx"]["tag"], first["ctx"]["expected_tags"])
    elif first["type"] == "union_tag_not_found":
        key += "." + first["ctx"]["discriminator"].strip("'")
        message = "missing key"
    elif first["type"] == "model_type":
        given = f"{first['input']!r:.60}"
        is_derivative = first["ctx"]["class_name"] == "Derivative"
        message = f"it is {given}, and a table of keys is wanted"
        message += f": write {{ value = {given} }}" if is_derivative else ""
    else:
        message = first["msg"][:1].lower() + first["msg"][1:]
        if first["type"] not in ("quantity", "derivative", "signal", "unit", "claimed", "probe", "limits", "steps"):
            message += f" (it is {first['input']!r:.60})"
    more = f"\nand {len(problems) - 1} more" if len(problems) > 1 else ""
    return f"{path}: {key or kind.__name__}: {message}{more}"


def _unknown(word: object, quoted: str) -> str:
    """Of a word that is none of those between single quotes."""
    known = re.findall(r"'([^']*)'", quoted)
    return f"unknown: {word}{nearest(str(word), known)}\nknown: {', '.join(known)}"


@cache
def _keys(kind: type[BaseModel]) -> tuple[str, ...]:
    """Every key that may occur anywhere below a profile type."""
    names: set[str] = set()

    def walk(schema: Any) -> None:
        if isinstance(schema, dict):
            names.update(schema.get("properties", {}))
            for value in schema.values():
                walk(value)
        elif isinstance(schema, list):
            for value in schema:
                walk(value)

    walk(json.loads(json.dumps(kind.model_json_schema())))
    return tuple(sorted(names))
