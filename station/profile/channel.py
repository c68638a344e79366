"""How a field on the wire becomes a signal."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from station.conventions import UNIT_ALIASES, UNITS, unit_named
from station.profile.quantity import Frozen, nearest


class Channel(Frozen):
    """How a field on the wire becomes a signal: unit-value = slope (field - zero), or a table of (field, value)."""

    field: str
    """The field's name in the message."""
    unit: str
    """Of the value that slope and zero, or the table, give: any unit that fits the signal."""
    slope: float = 1.0
    """Units per count of the field."""
    zero: float = 0.0
    """The field's count where the value is 0."""
    table: tuple[tuple[float, float], ...] | None = None
    """Points (field, value) in place of slope and zero; linear between them and beyond its ends."""
    noise: float = Field(default=0.0, ge=0)
    """Standard deviation, in `unit`: what the emulated device adds and what the estimator expects."""
    drift: float = Field(default=0.0, ge=0)
    """How far the emulated device's zero wanders in a minute (standard deviation of a random walk), in `unit`."""

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, raw: Any) -> Any:
        if isinstance(raw, dict) and isinstance(raw.get("table"), list):
            raw = {**raw, "table": tuple(tuple(float(x) for x in row) for row in raw["table"])}
        return raw

    @model_validator(mode="after")
    def _sound(self) -> Self:
        if unit_named(self.unit) is None:
            raise PydanticCustomError(
                "unit",
                "unknown unit {unit}{near}",
                {"unit": repr(self.unit), "near": nearest(self.unit, tuple(UNITS))},
            )
        if self.slope == 0:
            raise PydanticCustomError("slope", "slope must not be 0")
        if self.table is not None:
            x = [row[0] for row in self.table]
            if len(x) < 2 or any(b <= a for a, b in itertools.pairwise(x)):
                raise PydanticCustomError("table", "table needs at least 2 points with the field's value increasing")
        return self

    def to_si(self, raw: float) -> float:
        """The signal's value in SI; beyond a table's ends its last slope goes on."""
        return self.converter()(raw)

    def converter(self) -> Callable[[float], float]:
        """`to_si` for many values."""
        unit, slope, zero, table = UNITS[UNIT_ALIASES.get(self.unit, self.unit)], self.slope, self.zero, self.table
        factor, offset = unit.factor, unit.offset
        if table is None:
            return lambda raw: slope * (raw - zero) * factor + offset
        return lambda raw: _interpolate(table, raw) * factor + offset

    def from_si(self, value: float) -> float:
        """The field's value for a signal's value in SI (the inverse of to_si), before rounding to the wire."""
        u = UNITS[UNIT_ALIASES.get(self.unit, self.unit)]
        physical = (value - u.offset) / u.factor
        if self.table is None:
            return physical / self.slope + self.zero
        inverse = sorted((y, x) for x, y in self.table)
        return _interpolate(tuple(inverse), physical)

    def noise_si(self) -> float:
        """The noise's standard deviation in SI."""
        return self.noise * UNITS[UNIT_ALIASES.get(self.unit, self.unit)].factor

    def drift_si(self) -> float:
        """The random walk's standard deviation after a second, SI."""
        return self.drift * UNITS[UNIT_ALIASES.get(self.unit, self.unit)].factor / math.sqrt(60.0)


def _interpolate(table: tuple[tuple[float, float], ...], x: float) -> float:
    i = 1
    while i < len(table) - 1 and x > table[i][0]:
        i += 1
    (x0, y0), (x1, y1) = table[i - 1], table[i]
    return y0 + (x - x0) * (y1 - y0) / (x1 - x0)
