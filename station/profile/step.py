"""Steps of a test card: what is flown, in which condition, until what is known how well; and its limits."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, ValidationInfo, model_validator
from pydantic_core import PydanticCustomError

from station.conventions import LATERAL, LONGITUDINAL, from_si
from station.profile.quantity import (
    SI_NUMBERS,
    Frozen,
    Metres,
    MetresPerSecond,
    Positive,
    Radians,
    Seconds,
    nearest,
)
from station.profile.shapes import Leg, Manoeuvre

AIR = ("calm", "light", "moderate", "severe")


def _share(value: object) -> object:
    """ "3 %", or 0.03."""
    if isinstance(value, str):
        number, _, unit = value.strip().partition(" ")
        try:
            share = float(number.removesuffix("%")) / 100
        except ValueError:
            share = math.nan
        if not math.isfinite(share) or (unit != "%" and not (number.endswith("%") and not unit)):
            raise PydanticCustomError("quantity", '{text} is not a share: write "3 %" or 0.03', {"text": repr(value)})
        return share
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


Share = Annotated[float, BeforeValidator(_share), Field(gt=0, le=1)]


class Limits(Frozen):
    """What must not be exceeded, of whatever is flown: told at once. Attitudes are by default those of an
    upset (Airplane Upset Recovery Training Aid; ICAO Doc 10011; the upsets that 14 CFR 60 has simulators show)."""

    bank: Annotated[Radians, Positive] | None = math.radians(45.0)
    """Either way."""
    nose_up: Annotated[Radians, Positive] | None = math.radians(25.0)
    """Nose above the horizon."""
    nose_down: Annotated[Radians, Positive] | None = math.radians(10.0)
    """Nose below the horizon."""
    angle_of_attack: Annotated[Radians, Positive] | None = None
    """Highest, corrected; that of the vane where none is valid."""
    sideslip: Annotated[Radians, Positive] | None = None
    """Either way, as the vane shows it."""
    load_factor: Annotated[float, Field(gt=1)] | None = None
    """Highest."""
    least_load_factor: Annotated[float, Field(lt=1)] | None = None
    """Lowest."""
    speed: Annotated[MetresPerSecond, Positive] | None = None
    """Highest true airspeed."""
    least_speed: Annotated[MetresPerSecond, Positive] | None = None
    """Lowest true airspeed."""

    @model_validator(mode="after")
    def _leave_a_range(self, info: ValidationInfo) -> Self:
        if info.context == SI_NUMBERS:  # as a recording was flown, it is read
            return self
        if self.speed is not None and self.least_speed is not None and self.speed <= self.least_speed:
            given = {"speed": shown(self.speed, "kt"), "least": shown(self.least_speed, "kt")}
            raise PydanticCustomError(
                "limits", "speed: {speed} is not above least_speed, {least}: no speed is left to fly at", given
            )
        return self


def shown(value: float, unit: str) -> str:
    """As a card would have it."""
    return f"{from_si(value, unit):.4g} {unit}".removesuffix(" 1")


class Condition(Frozen):
    """In which the step is to be flown. What is left out does not matter."""

    speed: Annotated[MetresPerSecond, Positive] | None = None
    """True airspeed."""
    speed_tolerance: Annotated[MetresPerSecond, Positive] = 3.0
    """Either way."""
    altitude: Metres | None = None
    """Above mean sea level."""
    altitude_tolerance: Annotated[Metres, Positive] = 60.0
    """Either way."""
    heading: Radians | None = None
    """Clockwise from north."""
    heading_tolerance: Annotated[Radians, Positive] = math.radians(5.0)
    """Either way."""
    bank: Radians = 0.0
    """Of a turn, right wing down positive; 0: wings level."""
    bank_tolerance: Annotated[Radians, Positive] = math.radians(5.0)
    """Either way, before the input."""
    pitch_rate_tolerance: Annotated[float, Field(gt=0)] = 0.03
    """Of none, before the input, rad/s."""
    air: Literal["calm", "light", "moderate", "severe"] | None = None
    """The most turbulence that is wanted, during the input."""
    configuration: str = ""
    """What the crew sets: flaps, power, ice. Shown, and kept with the test point."""


class Step(Frozen):
    """One step of a card: fly the inputs in the condition, and again, until the derivatives are known."""

    name: str
    """What the crew calls it."""
    inputs: tuple[Manoeuvre, ...] = ()
    """What is flown; `start` counts from the end of the countdown."""
    steady: Annotated[Seconds, Positive] | None = None
    """In place of an input: the condition is held so long."""
    accept: dict[str, Share] = Field(default_factory=dict)
    """Enough: 2 sd below this share of the value, by derivative; without any, once flown is enough."""
    repeats: int = Field(default=3, ge=1)
    """How often it is flown at most."""
    condition: Condition = Condition()
    """In which it is flown."""

    def leg(self, start: float) -> Leg | None:
        """Where an emulated aircraft flies to for the step, from `start` on (s); None where it is flown anywhere."""
        c = self.condition
        if c.speed is None and c.heading is None and not c.bank:
            return None
        return Leg.model_construct(start=start, speed=c.speed, heading=c.heading, bank=c.bank or None)

    def beyond(self, limits: Limits) -> str:
        """Where its condition lies at or beyond a limit, which an alarm would then accompany; "" where nowhere."""
        c, at = self.condition, limits
        load = 1 / math.cos(c.bank)
        for key, value, name, limit, sign, unit in (
            ("speed", c.speed, "speed", at.speed, 1, "kt"),
            ("speed", c.speed, "least_speed", at.least_speed, -1, "kt"),
            ("bank", abs(c.bank), "bank", at.bank, 1, "deg"),
            ("bank", load, "load_factor", at.load_factor, 1, "1"),
        ):
            if value is not None and limit is not None and sign * (value - limit) >= 0:
                is_load = name == "load_factor"
                wanted = f"{shown(c.bank, 'deg')} takes a load factor of {load:.3g}" if is_load else shown(value, unit)
                side = "below" if sign > 0 else "above"
                return f"condition.{key} of {wanted}, not {side} limits.{name}, {shown(limit, unit)}"
        return ""

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, raw: Any) -> Any:
        if isinstance(raw, dict) and isinstance(raw.get("inputs"), list):
            raw = {**raw, "inputs": tuple(raw["inputs"])}
        return raw

    @model_validator(mode="after")
    def _sound(self) -> Self:
        if ";" in self.name or not self.name.strip():
            raise PydanticCustomError("step", "name: write one, without a semicolon")
        known = (*LONGITUDINAL, *LATERAL)
        for name in self.accept:
            if name not in known:
                words = {"name": name, "near": nearest(name, known)}
                raise PydanticCustomError("derivative", "accept: unknown derivative {name}{near}", words)
        if not self.inputs and self.steady is None:
            raise PydanticCustomError("step", "inputs: missing: what is to be flown? (or steady: how long to hold)")
        if self.inputs and self.steady is not None:
            raise PydanticCustomError("step", "steady: an input is flown: leave one of them out")
        if self.accept and self.steady is not None:
            raise PydanticCustomError("step", "accept: no derivative is known from a steady condition")
        if any(m.repeat is not None for m in self.inputs):
            raise PydanticCustomError("step", "inputs: repeat is for [[manoeuvres]]; a step has repeats")
        return self
