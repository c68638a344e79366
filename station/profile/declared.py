"""Signals that a rig declares beyond those of the station: measured by its devices, or derived by expressions.

The one place where further names enter: a Rig checks them, and `further` hands them on, with the recording's profile,
to frames, files, screens and analyses. They stand after SIGNALS, measured before derived, in the order of the rig; a
derived one after those it is made of.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Self

from pydantic import ValidationInfo, model_validator
from pydantic_core import PydanticCustomError

from station.conventions import SIGNALS, UNITS, Signal, unit_named
from station.profile.expression import CONSTANTS, FUNCTIONS, Formula, FormulaError
from station.profile.quantity import SI_NUMBERS, Frozen, Metres, nearest

RESERVED: Final = frozenset(
    ("time", "timestamp", "t_ns", "t_device_ns", "seq", "quality", "k", "age_s", "values", "time_device")
)
"""Names of other columns where signals stand in a table."""
_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")
_BOUNDS: Final = ("low", "high", "limit_low", "limit_high")


class _Quantity(Frozen):
    unit: str
    """Any known unit; it is shown in this one, and recorded in SI."""
    positive: str = ""
    """What positive means."""
    limit_low: float | None = None
    """Below it there is an alarm: a quantity such as "-2 g"."""
    limit_high: float | None = None
    """Above it there is an alarm."""

    @model_validator(mode="before")
    @classmethod
    def _in_si(cls, raw: Any, info: ValidationInfo) -> Any:
        """Bounds are quantities of the unit's kind."""
        if not isinstance(raw, dict) or not isinstance(raw.get("unit"), str):
            return raw
        known = unit_named(raw["unit"])
        if known is None:
            words = {"unit": repr(raw["unit"]), "near": nearest(raw["unit"], tuple(UNITS))}
            raise PydanticCustomError("unit", "unknown unit {unit}{near}", words)
        given = {n: _quantity(n, raw[n], known.si, info) for n in _BOUNDS if raw.get(n) is not None}
        return {**raw, **given}

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        for low, high in (_BOUNDS[2:], _BOUNDS[:2]):
            least, most = getattr(self, low, None), getattr(self, high, None)
            if least is not None and most is not None and least >= most:
                raise PydanticCustomError(
                    "signal", "{low} is not below {high}: they are reversed", {"low": low, "high": high}
                )
        return self

    @property
    def si(self) -> str:
        """The SI unit that it is recorded in."""
        known = unit_named(self.unit)
        assert known is not None
        return known.si


def _quantity(name: str, value: object, si: str, info: ValidationInfo) -> float:
    if info.context == SI_NUMBERS and isinstance(value, int | float):
        return float(value)
    number, _, unit = str(value).strip().partition(" ")
    known = unit_named(unit) if unit else None
    try:
        size = float(number)
    except ValueError:
        size = math.nan
    if not isinstance(value, str) or not math.isfinite(size) or known is None or known.si != si:
        fitting = ", ".join(f'"1 {u}"' for u in UNITS if UNITS[u].si == si)
        raise PydanticCustomError(
            "signal", "{name}: write a number and a unit that fits, one of {units}", {"name": name, "units": fitting}
        )
    return size * known.factor + known.offset


class DeclaredSignal(_Quantity):
    """A signal that the rig's devices measure; a known one may be declared to give it limits."""

    low: float | None = None
    """Below it a value cannot be true, and is left out."""
    high: float | None = None
    """Above it a value cannot be true."""
    measures: str | None = None
    """The known signal that it measures elsewhere, such as az of an accelerometer at the boom's tip."""
    position: tuple[Metres, Metres, Metres] | None = None
    """Where, from the CG, body axes (forward, right, down)."""
    emulated: str = "0"
    """What the emulated device shows before its noise, in `unit`: an expression over `time` (s) and what the simulation
    knows, SI."""

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, raw: Any) -> Any:
        if isinstance(raw, dict) and isinstance(raw.get("position"), list):
            raw = {**raw, "position": tuple(raw["position"])}
        if isinstance(raw, dict) and isinstance(raw.get("emulated"), int | float):
            raw = {**raw, "emulated": str(raw["emulated"])}
        return raw

    @model_validator(mode="after")
    def _sound(self) -> Self:
        _formula("emulated", self.emulated)
        if self.measures is not None:
            known = SIGNALS.get(self.measures)
            if known is None:
                near = nearest(self.measures, tuple(SIGNALS))
                raise PydanticCustomError(
                    "signal", "measures: unknown signal {name}{near}", {"name": self.measures, "near": near}
                )
            if known.unit != self.si:
                words = {"name": self.measures, "si": known.unit, "unit": repr(self.unit)}
                raise PydanticCustomError("signal", "measures: {name} is in {si}: unit {unit} does not fit", words)
        return self


class DerivedSignal(_Quantity):
    """A signal made of others, live and afterwards."""

    expression: str
    """Over signals, in SI; its value is in `unit`."""

    @model_validator(mode="after")
    def _sound(self) -> Self:
        if not _formula("expression", self.expression).names:
            raise PydanticCustomError("signal", "expression: names no signal")
        return self


def _formula(key: str, text: str) -> Formula:
    try:
        return Formula(text)
    except FormulaError as error:
        raise PydanticCustomError("signal", "{key}: {error}", {"key": key, "error": str(error)}) from None


@dataclass(frozen=True, slots=True)
class Derived:
    """A derived signal ready to be worked out: value_SI = formula * factor + offset."""

    signal: Signal
    formula: Formula
    factor: float
    offset: float


@dataclass(frozen=True)
class Further:
    """What a rig declares beyond SIGNALS; nothing by default."""

    measured: tuple[Signal, ...] = ()
    derived: tuple[Derived, ...] = ()
    shown_in: tuple[tuple[str, str], ...] = ()
    """Unit to show each in, by name."""

    @property
    def own(self) -> tuple[Signal, ...]:
        """Measured, then derived ones."""
        return (*self.measured, *(d.signal for d in self.derived))

    @cached_property
    def signals(self) -> Mapping[str, Signal]:
        """Every signal of a frame, in its order: SIGNALS, and what is declared."""
        return {**SIGNALS, **{s.name: s for s in self.own}}

    @cached_property
    def index(self) -> Mapping[str, int]:
        """Column of each signal in a frame."""
        return {name: i for i, name in enumerate(self.signals)}

    @cached_property
    def units(self) -> Mapping[str, str]:
        """The unit that each further signal is shown in."""
        return dict(self.shown_in)


NOTHING: Final = Further()


def further(declared: Mapping[str, DeclaredSignal], derived: Mapping[str, DerivedSignal]) -> Further:
    """Of a rig that has been checked."""
    own = {n: d for n, d in declared.items() if n not in SIGNALS}
    inf = math.inf
    measured = tuple(
        Signal(n, d.si, -inf if d.low is None else d.low, inf if d.high is None else d.high, d.positive)
        for n, d in own.items()
    )
    made = []
    for name in in_order({n: Formula(d.expression).names for n, d in derived.items()}):
        d, unit = derived[name], unit_named(derived[name].unit)
        assert unit is not None
        signal = Signal(name, d.si, -inf, inf, d.positive or f"{d.expression} in {d.unit}")
        made.append(Derived(signal, Formula(d.expression), unit.factor, unit.offset))
    shown = [(n, d.unit) for n, d in own.items()] + [(n, derived[n].unit) for n in (x.signal.name for x in made)]
    return Further(measured, tuple(made), tuple(shown))


def elsewhere(declared: Mapping[str, DeclaredSignal], signal: str) -> dict[str, tuple[float, float, float]]:
    """Where the declared signals are that measure `signal` elsewhere, m from the CG, body axes; those that say."""
    return {n: d.position for n, d in declared.items() if d.measures == signal and d.position is not None}


class CircleError(ValueError):
    """Expressions that are made of each other; the names in turn."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)


def in_order(made_of: Mapping[str, Iterable[str]]) -> list[str]:
    """Those of `made_of` so that each comes after what it is made of. Raises CircleError."""
    done: list[str] = []
    way: list[str] = []

    def visit(name: str) -> None:
        if name in done or name not in made_of:
            return
        if name in way:
            raise CircleError([*way[way.index(name) :], name])
        way.append(name)
        for other in made_of[name]:
            visit(other)
        way.pop()
        done.append(name)

    for name in made_of:
        visit(name)
    return done


def faults(
    declared: Mapping[str, DeclaredSignal], derived: Mapping[str, DerivedSignal], given: Iterable[str]
) -> tuple[tuple[str, ...], str] | None:
    """The first thing wrong with what a rig declares, as key and words; None where nothing is. `given`: signals that
    its streams have."""
    there = set(given)
    for table, entries in (("signals", declared), ("derived", derived)):
        for name, entry in entries.items():
            if why := _of_name(table, name, entry):
                return (table, name), why
    if both := next((n for n in derived if n in declared), ""):
        return ("derived", both), "is declared in [signals], too: give one of them another name"
    if lacking := next((n for n in declared if n not in there), ""):
        return ("signals", lacking), "no device gives it: name it in the signals of a stream"
    return _of_expressions(derived, (*(n for n in SIGNALS if n in there), *declared, *derived))


def _of_expressions(derived: Mapping[str, DerivedSignal], known: Sequence[str]) -> tuple[tuple[str, ...], str] | None:
    """What of the expressions names none of the signals `known`, or goes in a circle."""
    made_of = {n: Formula(d.expression).names for n, d in derived.items()}
    for name, others in made_of.items():
        if other := next((n for n in others if n not in known), ""):
            why = "no device of the rig gives it" if other in SIGNALS else f"it names nothing{nearest(other, known)}"
            return ("derived", name, "expression"), f"{other}: {why}"
    try:
        in_order(made_of)
    except CircleError as circle:
        turn = " of ".join(circle.names)
        return ("derived", circle.names[0], "expression"), f"is made of itself in a circle: {turn}"
    return None


def _of_name(table: str, name: str, entry: _Quantity) -> str:
    """What is wrong with a name; "" where nothing is."""
    if not _NAME.fullmatch(name):
        return "a name has letters, digits and _, begins with a letter, and has 40 of them at most"
    if name in RESERVED or name in CONSTANTS or name in FUNCTIONS:
        return "means something else already: choose another name"
    if name not in SIGNALS:
        return ""
    if table == "derived":
        return "is a signal of the station, and measured: choose another name"
    if SIGNALS[name].unit != entry.si:
        return (
            f"is a signal of the station in {SIGNALS[name].unit}: unit {entry.unit!r} does not fit; choose another name"
        )
    assert isinstance(entry, DeclaredSignal)
    if entry.low is not None or entry.high is not None or entry.measures is not None or entry.emulated != "0":
        return "is a signal of the station: only limit_low and limit_high can be given"
    return ""
