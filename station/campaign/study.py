"""What a study says, to be held against what is found: claims, comparisons and printed tables of a specification."""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from station.profile import Frozen

PARAMETERS: Final = 6
"""Of both equations, in the order of Campaign.parameters."""
Six = Annotated[tuple[float, ...], Field(min_length=PARAMETERS, max_length=PARAMETERS)]


def _as_tuples(raw: Any) -> Any:
    return {k: _number(v) for k, v in raw.items()}


def _number(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(map(_number, value))
    return float(value) if isinstance(value, int) else value


class Claim(Frozen):
    """Something that a study found, to be looked for in the results."""

    figure: str
    """Where the study says so."""
    parameter: str
    """Of which derivative."""
    finds: Literal[
        "less scatter",
        "more scatter",
        "more bias",
        "feasible",
        "not feasible",
        "bias",
        "scatter",
        "exceedances",
        "coverage",
    ]
    """With rising turbulence; or whether few enough flights (`limit`) leave the tolerance; or a number, `value`: bias
    or scatter in per cent, exceedances of 200 flights, coverage of two standard deviations in per cent."""
    value: float | None = None
    """What the study has for a number; it is held against what is found in every case `where` says."""
    within: Annotated[float, Field(ge=0)] = 0.0
    """How far from `value` still agrees, beyond two standard errors of what is found here: binomial for counts."""
    method: str = ""
    """By which method; the first if left out."""
    limit: int = 20
    """Exceedances of 200 flights that are still feasible."""
    where: dict[str, Any] = Field(default={})
    """Only cases with these levels."""
    except_calm: bool = False
    """Not looked for in calm air."""

    @property
    def is_number(self) -> bool:
        return self.finds in ("bias", "scatter", "exceedances", "coverage")

    @model_validator(mode="after")
    def _has_its_number(self) -> Self:
        if self.is_number != (self.value is not None):
            raise PydanticCustomError("signal", "value: for bias, scatter, exceedances and coverage, and only for them")
        return self


class Comparison(Frozen):
    """Two methods side by side: for each level of turbulence, which errs less."""

    method: str
    """One method."""
    against: str
    """The other."""
    says: str
    """What the study says of it, or what is asked."""


class PrintedRow(Frozen):
    """One method's row of a table."""

    printed_as: str
    """What the study calls the method."""
    method: str
    """Which method that is here."""
    estimate: Six
    """As printed, per rad."""
    bound: Six
    """Printed 95 % bounds, per rad."""
    factor: Six = (1.0,) * PARAMETERS
    """What the estimates found here are multiplied by, for what the study did besides."""
    says: str = ""
    """What is known of the row: why it differs from what is found here."""

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, raw: Any) -> Any:
        return _as_tuples(raw) if isinstance(raw, dict) else raw


class Baseline(Frozen):
    """What the change in per cent is from."""

    where: dict[str, Any]
    """Levels of its case."""
    method: str
    """Estimated by."""
    estimate: Six
    """As printed, per rad."""
    points: tuple[Six, ...] = ()
    """The points that it is the mean of, as printed: they scatter by what differs between flights beside gusts."""

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, raw: Any) -> Any:
        return _as_tuples(raw) if isinstance(raw, dict) else raw

    @property
    def methods(self) -> tuple[str, ...]:
        return (self.method,)


class PrintedTable(Frozen):
    """A test point's table."""

    title: str
    """Of the study, and what it was flown in."""
    where: dict[str, Any]
    """Levels of its case."""
    rows: tuple[PrintedRow, ...]
    beside: tuple[str, ...] = ()
    """Further methods, which the study has not."""
    says: str = ""
    """What is known of the table: why it differs from what is found here."""

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, raw: Any) -> Any:
        return {k: tuple(v) if isinstance(v, list) else v for k, v in raw.items()} if isinstance(raw, dict) else raw

    @property
    def methods(self) -> tuple[str, ...]:
        return (*(row.method for row in self.rows), *self.beside)
