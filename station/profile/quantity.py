"""A quantity is a string with its unit, `"340 slug"`, converted to SI here and nowhere else."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from station.conventions import UNITS, unit_named

_LISTED = 12
"""Names that a message lists at most."""
SI_NUMBERS = "si"
"""Validation context for profiles that come from a recording: numbers are SI already."""


@dataclass(frozen=True, slots=True)
class InUnit(BeforeValidator):
    """Reads a number and a unit of one kind as a number in its SI unit."""

    si: str = ""


def quantity(si: str) -> InUnit:
    def parse(value: object, info: ValidationInfo) -> object:
        if info.context == SI_NUMBERS and isinstance(value, (int, float)):
            return value
        if isinstance(value, bool) or not isinstance(value, (str, int, float)):
            raise PydanticCustomError("quantity", "write a number and its unit, for example {eg}", {"eg": f'"1 {si}"'})
        if not isinstance(value, str):
            raise PydanticCustomError("quantity", "missing unit: write {eg}", {"eg": f'"{value} {_common_units(si)}"'})
        number, _, unit = value.strip().partition(" ")
        known = unit_named(unit) if unit else None
        try:
            magnitude = float(number)
            if not math.isfinite(magnitude):
                raise ValueError
        except ValueError:
            raise PydanticCustomError("quantity", "{text} is not a number and a unit", {"text": repr(value)}) from None
        if not unit:
            raise PydanticCustomError("quantity", "missing unit: write {eg}", {"eg": f'"{number} {_common_units(si)}"'})
        if known is None or known.si != si:
            raise PydanticCustomError(
                "quantity",
                "unit {unit} does not fit here; use one of {units}",
                {"unit": repr(unit), "units": ", ".join(u for u in UNITS if UNITS[u].si == si)},
            )
        return magnitude * known.factor + known.offset

    return InUnit(parse, si=si)


def unit_of(field: FieldInfo) -> str:
    """The unit that a key of a profile is written in; "" for a plain number, a word or a table."""
    si = next(_found((*field.metadata, field.annotation)), "")
    return si if not si or si in UNITS else _common_units(si)


def _found(annotations: Iterable[Any]) -> Iterator[str]:
    for part in annotations:
        if isinstance(part, InUnit):
            yield part.si
        else:
            yield from _found((*getattr(part, "__metadata__", ()), *get_args(part)))


def _common_units(si: str) -> str:
    return next(u for u in UNITS if UNITS[u].si == si)


Metres = Annotated[float, quantity("m")]
SquareMetres = Annotated[float, quantity("m2")]
MetresPerSecond = Annotated[float, quantity("m/s")]
MetresPerSecond2 = Annotated[float, quantity("m/s2")]
Seconds = Annotated[float, quantity("s")]
Hertz = Annotated[float, quantity("Hz")]
Radians = Annotated[float, quantity("rad")]
RadiansPerSecond = Annotated[float, quantity("rad/s")]
RadiansPerMetre = Annotated[float, quantity("rad/m")]
RadiansPerSpeed = Annotated[float, quantity("rad/(m/s)")]
Kilograms = Annotated[float, quantity("kg")]
KilogramMetres2 = Annotated[float, quantity("kg m2")]
Newtons = Annotated[float, quantity("N")]
Pascals = Annotated[float, quantity("Pa")]
Bytes = Annotated[float, quantity("byte")]
Positive = Field(gt=0)


class Frozen(BaseModel):
    """A table of a profile: no key that is not known, no value changed later."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


def nearest(word: str, known: Iterable[str]) -> str:
    """Words that suggest the known one most like `word`; "" if none is."""
    close = difflib.get_close_matches(word, list(known), n=1, cutoff=0.5)
    return f"; did you mean {close[0]}?" if close else ""


def nearest_or_all(word: str, known: Iterable[str]) -> str:
    """Words that suggest the known one most like `word`; where none is, what there is."""
    names = list(known)
    more = ", ..." if len(names) > _LISTED else ""
    return nearest(word, names) or f"; it has {', '.join(names[:_LISTED]) or 'none'}{more}"
