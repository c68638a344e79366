"""A rig's `[loop]`: who moves the surfaces of the simulated aircraft in place of a script."""

from __future__ import annotations

from typing import Annotated, Literal

from station.profile.quantity import Frozen, Positive, Radians, Seconds

LOOP_HZ = 400
"""Steps a second with something from outside in the loop: an autopilot's inner loop runs at 250 to 400 Hz."""


class _Loop(Frozen):
    hold: Annotated[Seconds, Positive] = 0.5
    """Who falls silent is flown as heard last for so long."""
    fade: Annotated[Seconds, Positive] = 2.0
    """Then surfaces and thrust go to trim with this time constant."""


class MeasuredLoop(_Loop):
    """A hand on the bench: surfaces are where the rig's devices that are not emulated measure them."""

    kind: Literal["measured"]
    """Who moves the surfaces."""
    jump: Annotated[Radians, Positive] = 0.17453292519943295
    """A surface that moves farther from one sample to the next is held until it has stayed there for 0.1 s."""

    def delay_s(self, rate_hz: float) -> float:
        """How much later a surface that is measured so often is flown than it is measured, on average: a value holds
        until the next one, and waits for the next step."""
        return 0.5 / rate_hz + 0.5 / LOOP_HZ


Loop = MeasuredLoop
