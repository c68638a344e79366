"""A joystick in the loop: the kernel's input events through a pipe, as linux/input.h has them; found, lost and back."""

from __future__ import annotations

import errno
import math
import os
import struct
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.joystick import JoystickInput
from station.clock import SystemClock
from station.profile import JoystickLoop, Profiles, load_card, profiles_dir, read_profile
from station.profile.rig import Rig
from station.rows import Code, DeviceError, ProfileError
from station.simulation.outside import Outside
from tests.drivers.test_closed_loop import flying, until, values

ABS_X, ABS_Y, ABS_RZ, ABS_THROTTLE = 0, 1, 5, 6
EV_SYN, EV_ABS, SYN_REPORT, SYN_DROPPED = 0, 3, 0, 3


def event(kind: int, code: int, value: int) -> bytes:
    """struct input_event of a 64-bit machine: two longs, two unsigned shorts, an int."""
    return struct.pack("llHHi", 0, 0, kind, code, value)


def moved(code: int, value: int) -> bytes:
    return event(EV_ABS, code, value) + event(EV_SYN, SYN_REPORT, 0)


def rig_loop(**keys: Any) -> JoystickLoop:
    made = load_card("joystick").rig.loop
    assert isinstance(made, JoystickLoop)
    return made.model_copy(update=keys)


def read(come: JoystickInput) -> dict[str, float]:
    """What has come, rad and N."""
    taken: dict[str, float] = {}
    for descriptor in come.descriptors():
        come.receive(descriptor, 0, lambda _, name, value: taken.update({name: value}))
    return taken


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    path = tmp_path / "stick"
    os.mkfifo(path)
    return path


def test_axes_move_surfaces_by_the_rig_s_slopes(pipe: Path) -> None:
    come = JoystickInput(rig_loop(device=str(pipe)), SystemClock())
    with pipe.open("wb", buffering=0) as stick:
        stick.write(moved(ABS_Y, 32_767))
        assert read(come) == {"elevator": pytest.approx(math.radians(-8.0), rel=1e-4)}
        assert come.holds
        stick.write(moved(ABS_X, -32_768) + moved(ABS_RZ, 0))
        found = read(come)
        assert found["aileron"] == pytest.approx(math.radians(12.0))
        assert found["rudder"] == pytest.approx(0.0, abs=1e-5)
        # A button and a hat that nothing is asked of; then half an event, its rest later.
        stick.write(event(1, 288, 1) + event(EV_ABS, 16, 1) + moved(ABS_THROTTLE, 0)[:30])
        assert read(come)["thrust"] == pytest.approx(0.0, abs=0.1)
        stick.write(moved(ABS_THROTTLE, 0)[30:] + moved(ABS_THROTTLE, -32_768))
        assert read(come)["thrust"] == pytest.approx(3000.0)
    assert [code for _, code, _ in come.told()] == [Code.CONNECT]
    come.close()


def test_what_came_after_lost_events_is_passed_over(pipe: Path) -> None:
    """Until the next synchronisation, as the kernel documents SYN_DROPPED."""
    come = JoystickInput(rig_loop(device=str(pipe)), SystemClock())
    with pipe.open("wb", buffering=0) as stick:
        stick.write(event(EV_SYN, SYN_DROPPED, 0) + moved(ABS_Y, 32_767) + moved(ABS_X, 32_767))
        assert set(read(come)) == {"aileron"}
    come.close()


def test_a_still_stick_holds_and_one_that_is_gone_fades(pipe: Path) -> None:
    come = JoystickInput(rig_loop(device=str(pipe)), SystemClock())
    outside = Outside({"elevator": -0.02}, hold=0.5, fade=2.0)
    with pipe.open("wb", buffering=0) as stick:
        stick.write(moved(ABS_Y, 32_767))
        outside.take(0.0, "elevator", -0.02 + read(come)["elevator"])
        pulled = -0.02 - math.radians(8.0)
        for step in range(10):
            assert come.holds
            outside.still(float(step))
            assert outside.at(float(step))["elevator"] == pytest.approx(pulled, rel=1e-3)
    assert read(come) == {}
    assert not come.holds
    assert [code for _, code, _ in come.told()] == [Code.CONNECT, Code.DISCONNECT]
    assert outside.at(9.4)["elevator"] == pytest.approx(pulled, rel=1e-3)
    # Half a second held, then e^-1 of the way left after 2 s.
    assert outside.at(11.5)["elevator"] == pytest.approx(-0.02 + math.exp(-1) * (pulled + 0.02), rel=1e-3)
    come.close()


class FakeDevice:
    """As evdev.InputDevice: a name, a descriptor, axes with their ends."""

    def __init__(self, path: str) -> None:
        self.path, self.name = path, {"a": "Mouse", "b": "Extreme 3D"}[path]
        self.fd, self.writes = os.openpty()[::-1] if path == "b" else (os.open(os.devnull, os.O_RDONLY), -1)
        self.y = 600
        OPENED[path] = self

    def capabilities(self) -> dict[int, list[tuple[int, Any]]]:
        if self.path == "a":
            return {2: [(0, None)]}
        return {EV_ABS: [(code, self.absinfo(code)) for code in (ABS_X, ABS_Y, ABS_RZ, ABS_THROTTLE)]}

    def absinfo(self, code: int) -> Any:
        return types.SimpleNamespace(value=self.y if code == ABS_Y else 512, min=0, max=1023, flat=8)

    def close(self) -> None:
        os.close(self.fd)


OPENED: dict[str, FakeDevice] = {}


@pytest.fixture
def evdev(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[str]]:
    paths = {"there": ["b", "a"]}
    module = types.SimpleNamespace(list_devices=lambda: paths["there"], InputDevice=FakeDevice)
    monkeypatch.setitem(sys.modules, "evdev", module)
    return paths


def test_the_joystick_among_the_devices_is_found_and_its_ends_are_its_own(evdev: dict[str, list[str]]) -> None:
    come = JoystickInput(rig_loop(), SystemClock())
    assert come.holds
    assert come.told() == [("joystick", Code.CONNECT, "b")]
    os.close(OPENED["b"].writes)
    assert read(come) == {}  # unplugged: an error of the descriptor
    assert not come.holds
    ((_, code, _),) = come.told()
    assert code is Code.DISCONNECT
    come.close()


@pytest.mark.parametrize(("keys", "said"), [({"device": "Saitek"}, "none like 'Saitek'"), ({}, "no input device")])
def test_no_joystick_is_told(evdev: dict[str, list[str]], keys: dict[str, str], said: str) -> None:
    evdev["there"] = ["a"] if keys else []
    with pytest.raises(DeviceError, match=said):
        JoystickInput(rig_loop(**keys), SystemClock())


def test_without_the_library_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "evdev", None)
    with pytest.raises(DeviceError, match="uv sync --extra joystick"):
        JoystickInput(rig_loop(), SystemClock())


def test_no_pipe_is_told() -> None:
    with pytest.raises(DeviceError, match="mkfifo /nowhere/stick"):
        JoystickInput(rig_loop(device="/nowhere/stick"), SystemClock())


def test_no_permission_is_told(evdev: dict[str, list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(path: str) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", path)

    monkeypatch.setattr(sys.modules["evdev"], "InputDevice", refused)
    with pytest.raises(DeviceError, match=r"a: Permission denied: join the group input"):
        JoystickInput(rig_loop(), SystemClock())


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ('elevator = { field = "ABS_YY", unit = "deg" }', "no axis 'ABS_YY'; did you mean ABS_"),
        ('elevator = { field = "ABS_Y", unit = "m" }', "unit 'm' does not fit"),
        ('flap = { field = "ABS_Y", unit = "deg" }', "nothing from outside moves flap"),
    ],
)
def test_a_rig_that_asks_for_what_is_not_is_refused(tmp_path: Path, line: str, said: str) -> None:
    path = tmp_path / "mine.toml"
    text = (profiles_dir() / "rigs" / "joystick.toml").read_text()
    path.write_text(
        text.replace("[loop.commands]\n", f"[loop.commands]\n{line}\n").replace(
            '\nelevator = { field = "ABS_Y", unit = "deg", slope', "\n# "
        )
    )
    with pytest.raises(ProfileError, match=said.replace("'", ".")):
        read_profile(Rig, path)


def _bench(pipe: Path) -> Profiles:
    """The card joystick in calm air, boom and imu alone, its stick a pipe."""
    profiles = load_card("joystick")
    boom, imu, _ = profiles.rig.devices
    rig = profiles.rig.model_copy(update={"devices": (boom, imu), "loop": rig_loop(device=str(pipe))})
    flight = profiles.card.flight.model_copy(update={"gust_sigma": 0.0})
    return profiles.model_copy(update={"rig": rig, "card": profiles.card.model_copy(update={"flight": flight})})


@pytest.mark.slow
def test_a_pulled_stick_pitches_the_aircraft_up_and_unplugged_it_goes_back(pipe: Path) -> None:
    with flying(_bench(pipe)) as (said, heard, _):
        until(lambda: len(values(heard, "boom.vanes", 0, 200)) == 200)
        level = np.mean(values(heard, "boom.vanes", 0, 100))
        with pipe.open("wb", buffering=0) as stick:
            stick.write(moved(ABS_Y, 16_000))
            until(lambda: np.mean(values(heard, "boom.vanes", 0, 10)) > level + math.radians(2.0))
        until(lambda: any(s.get("event") == "DISCONNECT" and s["source"] == "joystick" for s in list(said)))
        until(lambda: any(s.get("event") == "STALE" for s in list(said)))
        until(lambda: np.mean(values(heard, "boom.vanes", 0, 10)) < level + math.radians(1.0))
