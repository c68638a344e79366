"""The aircraft that a card flies off its profile, `[flight.truth]`: what changes in flight, and when."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Final, Self, get_args, get_origin

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, TypeAdapter, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from station.conventions import SIGNALS
from station.profile.aircraft import DERIVATIVE_NAMES, Aircraft, Instrument
from station.profile.profile_changes import cg_aft, icing
from station.profile.quantity import SI_NUMBERS, Frozen, Metres, Seconds, nearest, nearest_or_all
from station.rows import ProfileError

Array = NDArray[np.float64]


class Change(Frozen):
    """How one number of the flown aircraft moves: straight from each time to the next, held before the first and after
    the last; `factor` or `value` says what it is then."""

    at: tuple[Seconds, ...]
    """Seconds of flight, increasing."""
    factor: tuple[float, ...] | None = None
    """The profile's number times this, at each of the times."""
    value: tuple[str | float, ...] | None = None
    """In place of the profile's number, with its unit."""

    @model_validator(mode="before")
    @classmethod
    def _lists(cls, raw: Any) -> Any:
        if not isinstance(raw, dict):
            raise PydanticCustomError("change", 'write { at = ["60 s", "360 s"], factor = [1.0, 0.9] }')
        made = {k: tuple(v) if isinstance(v, list) else v for k, v in raw.items()}
        if isinstance(made.get("factor"), tuple):
            made["factor"] = tuple(float(v) if isinstance(v, int) else v for v in made["factor"])
        return made

    @model_validator(mode="after")
    def _sound(self) -> Self:
        given = [v for v in (self.factor, self.value) if v is not None]
        if len(given) != 1:
            raise PydanticCustomError("change", "give either factor or value")
        if not self.at or len(given[0]) != len(self.at):
            raise PydanticCustomError("change", "at and factor or value need the same number of entries")
        if any(b <= a for a, b in zip(self.at, self.at[1:], strict=False)):
            raise PydanticCustomError("change", "at: the times must increase")
        return self


def flattened(raw: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """Changes by dotted key, from tables in tables as TOML reads `derivatives.CL_alpha = { at = ... }`."""
    found: dict[str, Any] = {}
    for key, inner in raw.items():
        name = f"{above}{key}"
        is_change = isinstance(inner, Mapping) and any(
            k in Change.model_fields and not isinstance(v, Mapping) for k, v in inner.items()
        )
        if isinstance(inner, Mapping) and inner and not is_change:
            found |= flattened(inner, f"{name}.")
        else:
            found[name] = inner
    return found


PATTERNS: Final[Mapping[str, Callable[[Aircraft, float], Aircraft]]] = {"cg_aft": cg_aft, "icing": icing}
"""Changes of many keys by one number that is no key: how far the CG moves aft, m, and ice on the whole aircraft, 1 as
in the reference icing condition of the Twin Otter."""
_PATTERN_UNITS: Final[Mapping[str, Any]] = {"cg_aft": Metres, "icing": float}
_NOT_FLOWN: Final = ("uncertainty", "kinematics_only", "rate_reference", "reference_speed", "name", "description")
_OF_INSTRUMENTS: Final = ("gain", "bias", "cubic")
"""Errors of instruments that may change in flight; the others carry a history."""


class AlteredAircraft:
    """An aircraft and what changes about it in flight."""

    def __init__(self, profile: Aircraft, truth: Mapping[str, Change] = {}) -> None:
        """Raises ProfileError for a key that the profile has not, or that cannot change in flight."""
        self.profile = profile
        self._dump = profile.model_dump(exclude_none=True)
        self._lines = {key: (np.array(c.at), self._numbers(key, c)) for key, c in truth.items()}
        self.until_s = max((float(at[-1]) for at, _ in self._lines.values()), default=0.0)
        """When the last change is over, s of flight."""
        for time in self.times:
            self.at(time)

    @property
    def keys(self) -> tuple[str, ...]:
        """What changes."""
        return tuple(self._lines)

    @property
    def times(self) -> tuple[float, ...]:
        """Of flight at which a change begins, turns or ends, s."""
        return tuple(sorted({0.0, *(float(t) for at, _ in self._lines.values() for t in at if t >= 0)}))

    def number(self, key: str, time: Array | float) -> Array:
        """What a key that changes is at times of flight (s), SI."""
        at, values = self._lines[key]
        return np.asarray(np.interp(time, at, values))

    def at(self, time: float) -> Aircraft:
        """The aircraft as it is at a time of flight (s). Raises ProfileError where it can be none."""
        if not self._lines:
            return self.profile
        raw = dict(self._dump)
        for key in self._lines:
            if key not in PATTERNS:
                raw = _with(raw, _path(key), float(self.number(key, time)))
        try:
            made = Aircraft.model_validate(raw, context=SI_NUMBERS)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            key = ".".join(str(p) for p in first["loc"])
            raise ProfileError(f"flight.truth: {key} at {time:g} s of flight: {first['msg']}") from None
        for key, pattern in PATTERNS.items():
            if key in self._lines:
                made = pattern(made, float(self.number(key, time)))
        return made

    def _numbers(self, key: str, change: Change) -> Array:
        """What the key is at the change's times, SI."""
        path = key if key in PATTERNS else _path(key)
        kind = _PATTERN_UNITS[key] if key in PATTERNS else _kind(key, _path(key))
        if change.value is not None:
            return np.array([_read(key, kind, v) for v in change.value])
        own = None if isinstance(path, str) else _own(self._dump, path)
        if own is None:
            _misspelt(key, path)
            raise ProfileError(f"flight.truth.{key}: the profile has no such number to multiply: write value")
        return own * np.array(change.factor)


def _misspelt(key: str, path: str | tuple[str, ...]) -> None:
    """Raises ProfileError for a derivative or a signal that there is none of, as the profile does itself."""
    tables = (("derivatives", "derivative", DERIVATIVE_NAMES), ("instruments", "signal", tuple(SIGNALS)))
    for table, what, known in tables:
        if path[0] == table and len(path) > 1 and path[1] not in known:
            raise ProfileError(f"flight.truth.{key}: unknown {what} {path[1]}{nearest(path[1], known)}")


def _path(key: str) -> tuple[str, ...]:
    parts = tuple(key.split("."))
    return (*parts, "value") if parts[0] == "derivatives" and len(parts) == len(("derivatives", "name")) else parts


def _kind(key: str, path: tuple[str, ...]) -> Any:
    """The type of the number at a path. Raises ProfileError where there is none, or none that changes in flight."""
    if path[0] in _NOT_FLOWN or path[-1] == "sd":
        raise ProfileError(f"flight.truth.{key}: it is not flown: nothing would change")
    if path[0] == "instruments" and path[-1] not in _OF_INSTRUMENTS:
        known = ", ".join(_OF_INSTRUMENTS)
        raise ProfileError(f"flight.truth.{key}: of an instrument, these change in flight: {known}")
    model: type[BaseModel] = Aircraft
    parts = list(path)
    while parts:
        part = parts.pop(0)
        field = model.model_fields.get(part)
        if field is None:
            keys = [*model.model_fields, *(PATTERNS if model is Aircraft else ())]
            raise ProfileError(f"flight.truth.{key}: no such key in an aircraft's profile{nearest_or_all(part, keys)}")
        tables = [a for a in (field.annotation, *get_args(field.annotation)) if _is_table(a)]
        if not tables and not parts:
            return Annotated[(field.annotation, *field.metadata)] if field.metadata else field.annotation
        if not tables:
            break
        model = tables[0]
        if get_origin(field.annotation) is dict and parts:
            parts.pop(0)  # a derivative's or a signal's name, which the profile judges itself
    raise ProfileError(f"flight.truth.{key}: not a number; name one of its table's, as in drag.zero_lift")


def _is_table(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _read(key: str, kind: Any, given: str | float) -> float:
    """A number as the profile has it there, SI."""
    try:
        made = TypeAdapter(kind).validate_python(given, strict=True)
    except ValidationError as error:
        message = error.errors(include_url=False)[0]["msg"]
        raise ProfileError(f"flight.truth.{key}: {message[:1].lower()}{message[1:]} (it is {given!r})") from None
    if isinstance(made, bool) or not isinstance(made, float):
        raise ProfileError(f"flight.truth.{key}: only numbers change in flight")
    return made


def _own(dump: Mapping[str, Any], path: tuple[str, ...]) -> float | None:
    """The profile's number at a path, SI; None where it has none."""
    at: Any = dump
    for part in path:
        at = at.get(part) if isinstance(at, Mapping) else None
    if at is None and path[0] == "instruments":
        at = getattr(Instrument(), path[-1])
    return at if isinstance(at, float) else None


def _with(dump: Mapping[str, Any], path: tuple[str, ...], number: float) -> dict[str, Any]:
    """The profile with that number at a path."""
    first, *rest = path
    below = dump.get(first)
    inner = _with(below if isinstance(below, Mapping) else {}, tuple(rest), number) if rest else number
    return {**dump, first: inner}
