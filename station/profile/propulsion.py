"""What tells the thrust where it is not measured: a propeller's power, or a table over an engine's setting."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from station.profile.quantity import Frozen, Metres, MetresPerSecond, Newtons, Positive


def _tuples(value: Any) -> Any:
    return tuple(_tuples(v) for v in value) if isinstance(value, list) else value


class _Engine(Frozen):
    uncertainty: float = Field(default=0.05, gt=0, lt=1)
    """Standard deviation of the thrust that it gives, over its value, all the flight long."""

    @model_validator(mode="before")
    @classmethod
    def _lists(cls, raw: Any) -> Any:
        return {k: _tuples(v) for k, v in raw.items()} if isinstance(raw, dict) else raw


class Propeller(_Engine):
    """Thrust = efficiency x shaft_power / airspeed, of all engines together, and no more than the static thrust."""

    kind: Literal["propeller"]
    """What tells the thrust."""
    efficiency: tuple[Annotated[float, Field(gt=0, le=1)], ...]
    """Of the propeller: one number, or one at each of `speeds`."""
    speeds: tuple[Annotated[MetresPerSecond, Positive], ...] = ()
    """True airspeeds of the efficiencies, increasing."""
    static_thrust: Annotated[Newtons, Positive] | None = None
    """Most that the propellers give."""

    @property
    def most_thrust(self) -> float | None:
        """N; None where the profile does not say."""
        return self.static_thrust

    @model_validator(mode="after")
    def _sound(self) -> Self:
        if len(self.efficiency) != max(len(self.speeds), 1):
            raise PydanticCustomError("engine", "efficiency: one number, or one at each of speeds")
        _increasing("speeds", self.speeds)
        return self


class ThrustTable(_Engine):
    """Thrust by setting, altitude and true airspeed, linear between, of all engines together."""

    kind: Literal["table"]
    """What tells the thrust."""
    signal: Literal["engine_speed", "fuel_flow", "shaft_power"]
    """The recorded setting."""
    settings: tuple[float, ...]
    """Of the signal, in SI, increasing: N1 as a share (0.9 is 90 %), kg/s, or W."""
    speeds: tuple[MetresPerSecond, ...]
    """True airspeeds, increasing."""
    altitudes: tuple[Metres, ...]
    """Pressure altitudes, increasing; one, where the thrust does not depend on it."""
    thrust: tuple[tuple[tuple[float, ...], ...], ...]
    """N: for each setting, for each altitude, one at each speed."""

    @model_validator(mode="after")
    def _sound(self) -> Self:
        for name in ("settings", "speeds", "altitudes"):
            _increasing(name, getattr(self, name))
        if len(self.settings) < 2 or len(self.speeds) < 2 or not self.altitudes:  # noqa: PLR2004
            raise PydanticCustomError("engine", "give two settings and two speeds at least, and an altitude")
        shape = {(len(plane), len(row)) for plane in self.thrust for row in plane}
        if len(self.thrust) != len(self.settings) or shape != {(len(self.altitudes), len(self.speeds))}:
            raise PydanticCustomError(
                "engine",
                "thrust: it must have {wanted} numbers: settings x altitudes x speeds",
                {"wanted": f"{len(self.settings)} x {len(self.altitudes)} x {len(self.speeds)}"},
            )
        return self

    @property
    def most_thrust(self) -> float:
        """N, of the whole table."""
        return max(n for plane in self.thrust for row in plane for n in row)


Engine = Annotated[Propeller | ThrustTable, Field(discriminator="kind")]


def _increasing(name: str, values: tuple[float, ...]) -> None:
    if any(b <= a for a, b in pairwise(values)):
        raise PydanticCustomError("engine", "{name}: they must increase", {"name": name})
