"""Shapes of test inputs, what a surface does about its trim; of legs, and of gusts."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from station.profile.quantity import Frozen, Hertz, Metres, MetresPerSecond, Positive, Radians, Seconds


class _Input(Frozen):
    start: Seconds
    """Seconds of flight."""
    surface: Literal["elevator", "aileron", "rudder"] = "elevator"
    """Which surface moves."""
    amplitude: Radians
    """Of each half, or of each sine's sum; negative starts the other way."""
    repeat: Annotated[Seconds, Positive] | None = None
    """Fly it again each so many seconds, for as long as the flight lasts."""


class Doublet(_Input):
    kind: Literal["doublet"]
    """The shape."""
    width: Annotated[Seconds, Positive]
    """Of each half."""


class ThreeTwoOneOne(_Input):
    kind: Literal["3-2-1-1"]
    """The shape."""
    unit: Annotated[Seconds, Positive]
    """Width of a 1."""


class Multisine(_Input):
    kind: Literal["multisine"]
    """The shape."""
    duration: Annotated[Seconds, Positive]
    """How long it lasts."""
    low: Annotated[Hertz, Positive] = 0.1
    """Lowest frequency."""
    high: Annotated[Hertz, Positive] = 2.0
    """Highest frequency."""


class Sweep(_Input):
    kind: Literal["sweep"]
    """The shape."""
    duration: Annotated[Seconds, Positive]
    """How long it lasts."""
    low: Annotated[Hertz, Positive] = 0.1
    """Lowest frequency."""
    high: Annotated[Hertz, Positive] = 2.0
    """Highest frequency."""


class Pulse(_Input):
    kind: Literal["pulse"]
    """The shape."""
    width: Annotated[Seconds, Positive]
    """How long it lasts."""


class Leg(Frozen):
    """Where an emulated aircraft flies to from `start` on; what is left out stays."""

    start: Seconds
    """Seconds of flight."""
    speed: Annotated[MetresPerSecond, Positive] | None = None
    """True airspeed."""
    heading: Radians | None = None
    """Clockwise from north; turned to the shorter way."""
    bank: Radians | None = None
    """Turns with it, right wing down positive, until a leg with a heading."""


class DiscreteGust(Frozen):
    """Air that rises to `peak` and falls again, as 1 - cos of the way flown (MIL-F-8785C 3.7.1.3, CS 25.341)."""

    start: Annotated[Seconds, Field(ge=0)]
    """When the CG gets there, at the flight's speed."""
    component: Literal["up", "side", "along"] = "up"
    """Which way: an updraught, air from the right, a headwind, or against it where `peak` is negative."""
    peak: MetresPerSecond
    """At its strongest."""
    length: Annotated[Metres, Field(ge=1, le=2000)]
    """From its begin to its peak: as far again it ends."""
    half: Literal["both", "right", "left"] = "both"
    """Of the span that meets it; one half needs `field = "plane"`."""


Manoeuvre = Annotated[Doublet | ThreeTwoOneOne | Multisine | Sweep | Pulse, Field(discriminator="kind")]

Order = Manoeuvre | Leg
"""What an emulated aircraft may be asked to fly."""
