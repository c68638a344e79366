"""Multi-hole and flush probes: flow angles and dynamic pressure from ratios of pressures, by the rig's calibration.

The ratios are those of A. L. Treaster and A. M. Yocum, The calibration and application of five-hole probes, ISA
Transactions 18(3), 1979, with the mean of the ring in place of the static pressure:

    reference   = centre - mean of up, down, left, right (those that there are)
    alpha ratio = (down - up) / reference
    beta ratio  = (right - left) / reference

A probe whose transducers measure differences gives these themselves.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal, NoReturn, Self

from pydantic import model_validator
from pydantic_core import PydanticCustomError

from station.conventions import MIN_SPEED, SEA_LEVEL_DENSITY, unit_named
from station.profile.channel import Channel
from station.profile.quantity import Frozen, Pascals, Positive, nearest_or_all

RING: Final = ("up", "down", "left", "right")
PROBE: Final = "probe."
"""What begins the name of a field that the probe makes."""
GIVES: Final[Mapping[str, str]] = {
    "probe.alpha": "rad",
    "probe.beta": "rad",
    "probe.dynamic_pressure": "Pa",
    "probe.airspeed": "m/s",
}
"""Fields that a probe makes, and their SI unit."""
Port = Literal["centre", "up", "down", "left", "right", "down_minus_up", "right_minus_left", "reference"]
PAIRS: Final[Mapping[str, tuple[str, str, str]]] = {
    "alpha": ("up", "down", "down_minus_up"),
    "beta": ("left", "right", "right_minus_left"),
}
"""Of each angle: the two ports whose pressures differ, and the port that is their difference."""
_LOOKED_AT: Final = 21
"""Points along each ratio where a calibration is looked at: between two of them a polynomial of the orders that probes
are fitted with (up to six) does not turn and turn back."""


def _refuse(words: str) -> NoReturn:
    raise PydanticCustomError("probe", "{words}", {"words": words})


class Curve(Frozen):
    """A calibration over the ratios, a polynomial or a table: of the angles, and of what the reference pressure is
    multiplied by for the dynamic pressure."""

    unit: str = "1"
    """Of its values: an angle's for alpha and beta; none for dynamic_pressure."""
    polynomial: tuple[tuple[float, int, int], ...] | None = None
    """Terms [c, i, j]: the sum of c (alpha ratio)^i (beta ratio)^j; needs alpha_ratio and beta_ratio."""
    table: tuple[tuple[float, float], ...] | None = None
    """Points [ratio, value], linear between them, over the angle's own ratio (dynamic_pressure's: alpha's)."""

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, raw: Any) -> Any:
        if not isinstance(raw, dict):
            return raw
        raw = dict(raw)
        for key in ("polynomial", "table"):
            if isinstance(raw.get(key), list):
                raw[key] = tuple(_row(row, key) for row in raw[key])
        return raw

    @model_validator(mode="after")
    def _sound(self) -> Self:
        if (self.polynomial is None) == (self.table is None):
            _refuse("give a polynomial or a table, one of them")
        if unit_named(self.unit) is None:
            _refuse(f"unknown unit {self.unit!r}")
        rows = self.polynomial or self.table or ()
        if not all(math.isfinite(x) for row in rows for x in row):
            _refuse("its numbers must be finite")
        if self.polynomial is not None and (not rows or any(row[1] < 0 or row[2] < 0 for row in self.polynomial)):
            _refuse("polynomial needs at least one term [c, i, j], its powers 0 or more")
        if self.table is not None:
            at = [row[0] for row in self.table]
            if not at[1:] or any(b <= a for a, b in itertools.pairwise(at)):
                _refuse("table needs at least 2 points with the ratio increasing")
        return self

    def at(self, own: float, a: float, b: float) -> float:
        """Its value, SI, at the ratios of alpha and beta, `own` among them; who asks knows the calibrated range: a
        table's last slope goes on."""
        unit = unit_named(self.unit)
        assert unit is not None
        if self.polynomial is not None:
            return sum(c * a**i * b**j for c, i, j in self.polynomial) * unit.factor
        table = self.table
        assert table is not None
        i = 1
        while i < len(table) - 1 and own > table[i][0]:
            i += 1
        (x0, y0), (x1, y1) = table[i - 1], table[i]
        return (y0 + (own - x0) * (y1 - y0) / (x1 - x0)) * unit.factor

    def over(self, own: str) -> frozenset[str]:
        """The ratios that it depends on, "alpha" and "beta"; `own` is a table's."""
        if self.polynomial is None:
            return frozenset((own,))
        powers = [name for _, i, j in self.polynomial for name, power in (("alpha", i), ("beta", j)) if power]
        return frozenset(powers)


def _row(row: Any, key: str) -> Any:
    names = ("c", "i", "j") if key == "polynomial" else ("ratio", "value")
    sound = isinstance(row, list | tuple) and all(isinstance(x, int | float) for x in row)
    if not sound or len(row) != len(names):
        _refuse(f"{key}: a row is [{', '.join(names)}], not {row!r}")
    if key == "table":
        return tuple(float(x) for x in row)
    if any(x != int(x) for x in row[1:] if math.isfinite(x)) or not all(map(math.isfinite, row[1:])):
        _refuse(f"polynomial: the powers of {row!r} are no whole numbers")
    return (float(row[0]), int(row[1]), int(row[2]))


class Probe(Frozen):
    """What the fields probe.alpha, probe.beta, probe.dynamic_pressure and probe.airspeed of the stream's signals are
    made of. [devices.streams.probe.ports] has a channel in a unit of pressure for each port: centre, up, down, left,
    right, or differences down_minus_up, right_minus_left, reference (such as pitot above static)."""

    ports: dict[Port, Channel]
    """Which field is the pressure of which port."""
    alpha: Curve | None = None
    """Angle of attack over the ratios."""
    beta: Curve | None = None
    """Sideslip over the ratios."""
    dynamic_pressure: Curve | None = None
    """Dynamic pressure over reference pressure."""
    alpha_ratio: tuple[float, float] | None = None
    """Lowest and highest calibrated; a table's ends if left out. Beyond, what depends on it is left out."""
    beta_ratio: tuple[float, float] | None = None
    """As alpha_ratio."""
    least: Annotated[Pascals, Positive] = 0.5 * SEA_LEVEL_DENSITY * MIN_SPEED**2
    """Reference pressure below which there are neither angles nor dynamic pressure: 8 m/s at sea level."""

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, raw: Any) -> Any:
        if not isinstance(raw, dict):
            return raw
        raw = dict(raw)
        for key in ("alpha_ratio", "beta_ratio"):
            if isinstance(raw.get(key), list):
                raw[key] = tuple(float(x) if isinstance(x, int) else x for x in raw[key])
        return raw

    @model_validator(mode="after")
    def _sound(self) -> Self:
        self._check_ports()
        if not self.curves:
            _refuse("no calibration: give [devices.streams.probe.alpha], .beta or .dynamic_pressure")
        for name, curve in self.curves.items():
            unit = unit_named(curve.unit)
            wanted = GIVES[PROBE + name] if name in PAIRS else "1"
            if unit is None or unit.si != wanted:
                example = "deg" if name in PAIRS else "1"
                _refuse(f"{name}: unit {curve.unit!r} does not fit: it is one of {example!r}'s kind")
            for ratio in (*curve.over(own_ratio(name)), *((name,) if name in PAIRS else ())):
                self._check_pair(name, ratio)
        self._check_ranges()
        self._check_shape()
        return self

    @property
    def curves(self) -> dict[str, Curve]:
        """Those that there are, by name."""
        every = {"alpha": self.alpha, "beta": self.beta, "dynamic_pressure": self.dynamic_pressure}
        return {name: curve for name, curve in every.items() if curve is not None}

    @property
    def ratios(self) -> dict[str, tuple[float, float]]:
        """The calibrated range of each ratio that a curve depends on."""
        found = {}
        for ratio, given in (("alpha", self.alpha_ratio), ("beta", self.beta_ratio)):
            using = [(n, c) for n, c in self.curves.items() if ratio in c.over(own_ratio(n))]
            ends = [(c.table[0][0], c.table[-1][0]) for _, c in using if c.table is not None]
            ends += [given] if given is not None else []
            if using and ends:
                found[ratio] = (max(low for low, _ in ends), min(high for _, high in ends))
        return found

    @property
    def ring(self) -> tuple[str, ...]:
        """Ports whose mean is taken off the centre's."""
        return tuple(p for p in RING if p in self.ports)

    def _check_ports(self) -> None:
        fields: dict[str, str] = {}
        for port, channel in self.ports.items():
            unit = unit_named(channel.unit)
            if unit is None or unit.si != "Pa":
                _refuse(f"ports: {port}: unit {channel.unit!r} is none of pressure")
            if (other := fields.setdefault(channel.field, port)) != port:
                _refuse(f"ports: {other} and {port} are both {channel.field}: their difference is always 0")
        if "reference" in self.ports:
            return
        if "centre" not in self.ports or not self.ring:
            _refuse("ports: no reference pressure: give centre with up and down, or left and right, or reference")
        for one, other, _ in PAIRS.values():
            if (one in self.ports) != (other in self.ports):
                lacking = other if one in self.ports else one
                _refuse(f"ports: {lacking} is missing: without it the ring's mean is not the probe's")

    def _check_pair(self, name: str, ratio: str) -> None:
        one, other, difference = PAIRS[ratio]
        if difference in self.ports:
            return
        if lacking := [p for p in (one, other) if p not in self.ports]:
            _refuse(f"ports: {' and '.join(lacking)} missing: {name} needs {one} and {other}, or {difference}")

    def _check_ranges(self) -> None:
        for name, curve in self.curves.items():
            for ratio in curve.over(own_ratio(name)):
                if curve.polynomial is not None and getattr(self, f"{ratio}_ratio") is None:
                    _refuse(f"{name}: give {ratio}_ratio = [lowest, highest]: how far its polynomial was calibrated")
        for ratio, (low, high) in self.ratios.items():
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                _refuse(f"{ratio}_ratio: nothing is calibrated from {low:g} to {high:g}")

    def _check_shape(self) -> None:
        """Angles that can be told from their ratios, and a dynamic pressure above 0."""
        ranges = self.ratios
        along = {name: _grid(*ranges.get(name, (0.0, 0.0))) for name in PAIRS}
        for name, curve in self.curves.items():
            own = own_ratio(name)
            for other in along["beta" if own == "alpha" else "alpha"]:
                pairs = [(x, other) if own == "alpha" else (other, x) for x in along[own]]
                found = [curve.at(x, a, b) for x, (a, b) in zip(along[own], pairs, strict=True)]
                if name not in PAIRS:
                    if min(found) <= 0:
                        at = along[own][found.index(min(found))]
                        _refuse(f"{name}: it is {min(found):.3g} at an alpha ratio of {at:.3g}: it must be above 0")
                    continue
                self._check_monotonic(name, curve, along[own], found)

    def _check_monotonic(self, name: str, curve: Curve, along: list[float], found: list[float]) -> None:
        points = list(zip(along, found, strict=True))
        if curve.table is not None:
            points = [(x, y) for x, y in curve.table if along[0] <= x <= along[-1]]
        if not points[1:] or points[-1][1] == points[0][1]:
            _refuse(f"{name}: the angle does not change with its ratio")
        sign = math.copysign(1.0, points[-1][1] - points[0][1])
        for (x0, y0), (x1, y1) in itertools.pairwise(points):
            if (y1 - y0) * sign <= 0:
                _refuse(
                    f"{name}: not monotonic: the angle turns back at a ratio of {x0:.3g} to {x1:.3g}; "
                    "shorten the calibrated range"
                )


def own_ratio(name: str) -> str:
    """The ratio that a curve's table is over, "alpha" or "beta"."""
    return "beta" if name == "beta" else "alpha"


def _grid(low: float, high: float) -> list[float]:
    return [low + (high - low) * i / (_LOOKED_AT - 1) for i in range(_LOOKED_AT if high > low else 1)]


def wrong_fields(signals: Mapping[str, Channel], probe: Probe | None) -> str | None:
    """What is wrong with how a stream's signals name what a probe makes, in words; None where nothing is."""
    made = {n: c for n, c in signals.items() if c.field.startswith(PROBE)}
    if probe is None:
        name = next(iter(made), "")
        return f"{name}: field {made[name].field!r} needs a [devices.streams.probe]" if made else None
    given = {PROBE + name for name in probe.curves}
    if "probe.dynamic_pressure" in given and {"static_pressure", "air_temperature"} <= signals.keys():
        given.add("probe.airspeed")
    if not made:
        return f'probe: no signal is made of it: write such as alpha_vane = {{ field = "{min(given)}", unit = "deg" }}'
    fields: dict[str, str] = {}
    for name, channel in made.items():
        unit = unit_named(channel.unit)
        if channel.field not in GIVES:
            return f"{name}: a probe gives no {channel.field}{nearest_or_all(channel.field, GIVES)}"
        if channel.field not in given:
            more = "dynamic_pressure, and static_pressure and air_temperature in the same stream"
            lacks = more if channel.field == "probe.airspeed" else "its calibration"
            return f"{name}: {channel.field} lacks {lacks}"
        if unit is None or unit.si != GIVES[channel.field]:
            return f"{name}: {channel.field} is in {GIVES[channel.field]}: unit {channel.unit!r} does not fit"
        if (other := fields.setdefault(channel.field, name)) != name:
            return f"{name}: {channel.field} is {other} already"
    return None
