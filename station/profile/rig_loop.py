"""A rig's `[loop]`: who moves the surfaces of the simulated aircraft in place of a script."""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from station.conventions import SIGNALS, SURFACES, unit_named
from station.profile.channel import Channel
from station.profile.quantity import Frozen, Hertz, Metres, Positive, Radians, Seconds, nearest

LOOP_HZ = 400
"""Steps a second with something from outside in the loop: an autopilot's inner loop runs at 250 to 400 Hz."""
MOVED = (*SURFACES, "thrust")
"""What can be moved from outside, rad and N."""


class _Loop(Frozen):
    hold: Annotated[Seconds, Positive] = 0.5
    """Who falls silent is flown as heard last for so long."""
    fade: Annotated[Seconds, Positive] = 2.0
    """Then surfaces and thrust go to trim with this time constant."""

    @property
    def sent(self) -> str:
        """What goes out to who moves the surfaces, in words."""
        return "nothing"

    def delay_s(self, rate_hz: float) -> float:
        """How much later a surface that is measured so often is flown than it is measured, on average: a value holds
        until the next one, and waits for the next step."""
        return 0.5 / rate_hz + 0.5 / LOOP_HZ


class MeasuredLoop(_Loop):
    """A hand on the bench: surfaces are where the rig's devices that are not emulated measure them."""

    kind: Literal["measured"]
    """Who moves the surfaces."""
    jump: Annotated[Radians, Positive] = 0.17453292519943295
    """A surface that moves farther from one sample to the next is held until it has stayed there for 0.1 s."""


def _check_moved(commands: dict[str, Channel]) -> None:
    """Raises PydanticCustomError for what nothing moves, and for a unit that does not fit."""
    for name, channel in commands.items():
        if name not in MOVED:
            known = ", ".join(MOVED)
            raise PydanticCustomError(
                "signal", "nothing from outside moves {name}: only {known}", {"name": name, "known": known}
            )
        unit = unit_named(channel.unit)
        if unit is None or unit.si != SIGNALS[name].unit:
            raise PydanticCustomError(
                "unit",
                "{name} is in {si}: unit {unit} does not fit",
                {"name": name, "si": SIGNALS[name].unit, "unit": repr(channel.unit)},
            )


AXES: Final = {
    "ABS_X": 0, "ABS_Y": 1, "ABS_Z": 2, "ABS_RX": 3, "ABS_RY": 4, "ABS_RZ": 5, "ABS_THROTTLE": 6, "ABS_RUDDER": 7,
    "ABS_WHEEL": 8, "ABS_GAS": 9, "ABS_BRAKE": 10, "ABS_HAT0X": 16, "ABS_HAT0Y": 17,
}  # fmt: skip
"""A joystick's, by name, with Linux's numbers (linux/input-event-codes.h)."""


class JoystickLoop(_Loop):
    """A joystick flies: what its axes ask for is added to the trim, each behind the profile's actuator."""

    kind: Literal["joystick"]
    """Who moves the surfaces."""
    device: str = "any"
    """A word of the joystick's name, its path under /dev/input, "any" for the first that has all the axes, or the path
    of a pipe that input events come through, as `ssh bench cat /dev/input/event5 > pipe` sends them."""
    range: tuple[int, int] = (-32_768, 32_767)
    """Of the axes of a pipe: what its ends say."""
    commands: dict[str, Channel] = Field(min_length=1)
    """By `elevator`, `aileron`, `rudder` (an angle) or `thrust` (a force): which axis, -1 to 1, moves it from trim."""

    @model_validator(mode="before")
    @classmethod
    def _pair(cls, raw: Any) -> Any:
        if isinstance(raw, dict) and isinstance(raw.get("range"), list):
            raw = {**raw, "range": tuple(raw["range"])}
        return raw

    @model_validator(mode="after")
    def _known(self) -> Self:
        _check_moved(self.commands)
        for name, channel in self.commands.items():
            if channel.field not in AXES:
                raise PydanticCustomError(
                    "signal",
                    "{name}: no axis {field}{near}",
                    {"name": name, "field": repr(channel.field), "near": nearest(channel.field, AXES)},
                )
        if self.range[0] >= self.range[1]:
            raise PydanticCustomError("quantity", "range: its first end is to be below its last")
        return self


class CommandedLoop(_Loop):
    """An autopilot's outputs, each behind the profile's actuator."""

    commands: dict[str, Channel] = Field(min_length=1)
    """By `elevator`, `aileron`, `rudder` (an angle) or `thrust` (a force): which output moves it, and how."""
    rate: Annotated[Hertz, Positive] = 200.0
    """How often the autopilot is told of its sensors: 400 Hz, or a whole part of it."""
    lock_step: bool = False
    """Whether each step waits for the autopilot's answer to the one before, for `hold` at most."""

    @model_validator(mode="after")
    def _known(self) -> Self:
        _check_moved(self.commands)
        for name, channel in self.commands.items():
            number = channel.field.removeprefix(self.output_prefix())
            if not number.isdecimal() or not 1 <= int(number) <= self.outputs():
                raise PydanticCustomError(
                    "signal",
                    "{name}: no output {field}: {first} to {last}",
                    {
                        "name": name,
                        "field": repr(channel.field),
                        "first": f"{self.output_prefix()}1",
                        "last": f"{self.output_prefix()}{self.outputs()}",
                    },
                )
        if LOOP_HZ % self.rate != 0:
            raise PydanticCustomError("quantity", "rate: {hz} Hz is no whole part of 400 Hz", {"hz": f"{self.rate:g}"})
        return self

    @staticmethod
    def output_prefix() -> str:
        return "controls"

    @staticmethod
    def outputs() -> int:
        """How many there are."""
        return 16

    @staticmethod
    def ends() -> tuple[float, float]:
        """What an output says at its two ends: MAVLink's HIL_ACTUATOR_CONTROLS are -1 to 1."""
        return -1.0, 1.0

    def farthest(self, name: str) -> float:
        """What an output asks for at its end, either way, SI."""
        return max(abs(self.commands[name].to_si(end)) for end in self.ends())

    def moved_by(self, outputs: Any) -> dict[str, float]:
        """What these outputs, the first of them at 0, ask for, SI; one that is not there asks for nothing."""
        found = {}
        for name, channel in self.commands.items():
            at = int(channel.field.removeprefix(self.output_prefix())) - 1
            if at < len(outputs):
                found[name] = channel.to_si(float(outputs[at]))
        return found


class MavlinkLoop(CommandedLoop):
    """An autopilot over MAVLink: HIL_ACTUATOR_CONTROLS in; HIL_SENSOR, HIL_GPS and HIL_STATE_QUATERNION out."""

    kind: Literal["mavlink_hil"]
    """Who moves the surfaces."""
    url: str = "tcpin:127.0.0.1:4560"
    """tcpin:HOST:PORT, where PX4's simulator link calls; or a serial port's path, or usb:SERIAL, for hardware."""
    baud: int = Field(default=921_600, gt=0)
    """Bits per second, of a serial link."""
    simulator: bool = False
    """Whether this is a simulator's link, whose autopilot moves nothing real. Otherwise nothing is sent but to a system
    whose heartbeats say that it is in HIL."""

    @property
    def sent(self) -> str:
        """What goes out, in words."""
        to = "on a simulator's link" if self.simulator else "to a system whose heartbeats say HIL"
        return f"HIL_SENSOR, HIL_GPS and HIL_STATE_QUATERNION of the simulated aircraft, {to}"


class JsonLoop(CommandedLoop):
    """An ArduPilot in software over its JSON interface: servo packets in, JSON out."""

    kind: Literal["ardupilot_json"]
    """Who moves the surfaces."""
    address: str = "127.0.0.1:9002"
    """HOST:PORT where servo packets come in, over UDP."""
    ground: Metres = 0.0
    """Height of the autopilot's home above mean sea level, as it is started with."""

    @staticmethod
    def output_prefix() -> str:
        return "servo"

    @staticmethod
    def outputs() -> int:
        return 32

    @staticmethod
    def ends() -> tuple[float, float]:
        """Microseconds, a servo's full range."""
        return 1000.0, 2000.0

    @property
    def sent(self) -> str:
        """What goes out, in words."""
        return "the simulated aircraft's state as JSON, to whom servo packets come from"


Loop = Annotated[MeasuredLoop | JoystickLoop | MavlinkLoop | JsonLoop, Field(discriminator="kind")]
