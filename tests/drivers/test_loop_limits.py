"""What no aircraft can fly, asked for from outside: told, not flown; and an error in the loop's process is told."""

from __future__ import annotations

import math
from multiprocessing import Pipe
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from drivers import closed_loop, emulated_device
from drivers.closed_loop import fly_closed, flyable, travel_of
from station.profile import JsonLoop, MavlinkLoop, Propeller, ThrustTable, load_card
from station.rows import Code, DeviceError
from station.simulation.outside import Outside
from tests.drivers.px4_like import Px4Like
from tests.drivers.test_closed_loop import events, flying, until
from tests.drivers.test_mavlink_hil import PROFILES, Calling, free_port, loop

AIRCRAFT = PROFILES.aircraft
WEIGHT = 340 * 14.5939 * 9.80665
"""N, of the profile's 340 slug."""


def most(rig_loop: MavlinkLoop | JsonLoop, **keys: Any) -> float:
    return travel_of(AIRCRAFT.model_copy(update=keys), rig_loop, ("thrust", "elevator"))["thrust"]


def test_the_most_thrust_is_the_rig_s_full_output_or_the_engine_s_or_two_weights() -> None:
    assert most(loop()) == pytest.approx(16_000.0)
    servo = load_card("ardupilot_sitl").rig.loop
    assert isinstance(servo, JsonLoop)
    assert most(servo) == pytest.approx(16_000.0)  # 2000 us at 16 N/us from 1000
    channel = loop().commands["thrust"].model_copy(update={"slope": -1e9})
    absurd = loop(commands={"thrust": channel})
    assert most(absurd) == pytest.approx(2 * WEIGHT, rel=1e-4)
    propeller = Propeller.model_validate({"kind": "propeller", "efficiency": [0.8], "static_thrust": "12000 N"})
    assert most(absurd, engine=propeller) == 12_000.0
    flat = {"settings": [0.5, 1.0], "speeds": ["40 m/s", "80 m/s"], "altitudes": ["0 m"]}
    thrust = [[[1.0, 2.0]], [[9e3, 7e3]]]
    table = ThrustTable.model_validate({"kind": "table", "signal": "engine_speed", "thrust": thrust, **flat})
    assert most(absurd, engine=table) == 9_000.0


@pytest.mark.parametrize("asked", [24_000.0, -24_000.0, 1.6e10, math.nan])
def test_a_thrust_that_the_aircraft_cannot_have_is_told_and_not_flown(asked: float) -> None:
    o = Outside({"thrust": 4000.0}, hold=0.5, fade=2.0, travel=travel_of(AIRCRAFT, loop(), ("thrust",)))
    o.take(0.0, "thrust", 16_000.0)
    o.take(0.1, "thrust", asked)
    assert o.at(0.1) == {"thrust": 16_000.0}
    heard, (code, words) = o.told()
    assert (heard[0], code) == (Code.HEARD, Code.RANGE)
    assert words.endswith("from outside, and the engines give 16000 N: not flown")
    assert "deg" not in words


class Throttled(Px4Like):
    """Asks for a million times full throttle."""

    def answer(self, data: bytes) -> bytes:
        sent = super().answer(data)
        if "HIL_SENSOR" not in self.heard or not sent:
            return sent
        outputs = [0.0, 0.0, 1e6] + 13 * [0.0]
        asked = common.MAVLink_hil_actuator_controls_message(self.heard["HIL_SENSOR"].time_usec, outputs, 129, 1)
        return bytes(asked.pack(self._mav))


def test_a_million_times_full_throttle_leaves_the_flight_flying() -> None:
    port = free_port()
    boom, imu, _ = PROFILES.rig.devices
    rig = PROFILES.rig.model_copy(update={"devices": (boom, imu), "loop": loop(url=f"tcpin:127.0.0.1:{port}")})
    with flying(PROFILES.model_copy(update={"rig": rig})) as (said, heard, _):
        calling = Calling(port, Throttled())
        until(lambda: events(said, "RANGE"))
        flies_on = len(heard)
        until(lambda: len(heard) > flies_on + 1000)
        calling.hang_up()
    assert not [s for s in said if "error" in s]


def test_numbers_of_no_flight_end_it_in_words() -> None:
    row = np.array([math.nan, 56.0, 1e5])  # no second vane
    assert flyable(row, 1) is row
    for bad in ([1.0, math.nan], [1.0, math.inf], [-1e12, 56.0]):
        with pytest.raises(DeviceError, match="the simulated aircraft's motion has run away"):
            flyable(np.array(bad), 1)


class Failing:
    """Someone in the loop at whom the first answer raises."""

    moved, measured, holds, waits = ("elevator",), False, False, False

    def __init__(self, error: Exception) -> None:
        self._error = error

    def descriptors(self) -> list[int]:
        return []

    def answer(self, *_: Any) -> None:
        raise self._error

    def close(self) -> None:
        """Nothing."""


@pytest.mark.parametrize("error", [OverflowError("too large to pack"), OSError(5, "Input/output error")])
def test_whatever_raises_in_the_loop_is_told_in_a_line(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(closed_loop, "input_of", lambda *_: Failing(error))
    for own in ("heed_signals", "claim_real_time"):
        monkeypatch.setattr(closed_loop, own, lambda: None)
    monkeypatch.setattr(closed_loop.gc, "disable", lambda: None)
    monkeypatch.setattr(closed_loop.gc, "freeze", lambda: None)
    ours, theirs = Pipe()
    with ours, theirs:
        ours.send(0)
        fly_closed(PROFILES, None, theirs, ())
        assert ours.recv() == ("ready", None)
        word, told = ours.recv()
    assert word == "error"
    assert str(told) == f"the loop has ended: {type(error).__name__}: {error}"


def test_whatever_raises_in_a_device_is_told_in_a_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(emulated_device, "heed_signals", lambda: None)
    port = SimpleNamespace(plug=lambda: math.exp(1e9), close=lambda: None)
    monkeypatch.setattr(emulated_device, "wire_of", lambda *_: emulated_device.Wire(port, bytes))  # type: ignore[arg-type]
    ours, theirs = Pipe()
    with ours, theirs:
        emulated_device.serve_device(0, PROFILES, str(tmp_path / "links"), (), theirs, theirs)
        word, told = ours.recv()
    assert (word, str(told)) == ("error", "the device has ended: OverflowError: math range error")
