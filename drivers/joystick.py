"""A joystick in the loop of the simulated aircraft: Linux's input events, of a device or through a pipe.

Devices are found, and the ends of their axes asked for, by the package evdev; a pipe needs none.
"""

from __future__ import annotations

import errno
import importlib
import os
import stat
from collections.abc import Callable, Mapping
from typing import Any, Final

from drivers.input_events import ABS, EVENT, SYN, Event, InputEvents
from station.clock import Clock
from station.profile import AXES, JoystickLoop
from station.rows import Code, DeviceError

_DROPPED: Final = 3
"""The code of the synchronisation that says that events were lost."""
_AGAIN_NS: Final = 1_000_000_000
_FOLDER: Final = "/dev/input/"
_READ: Final = 64 * EVENT.size

Take = Callable[[int, str, float], None]
Axis = tuple[int, int, int, int]
"""What it says now, at its two ends, and how far from the middle it still says nothing."""


class _Stick:
    """An open joystick: its descriptor, and its axes by number."""

    def __init__(self, path: str, descriptor: int, axes: Mapping[int, Axis], device: Any = None) -> None:
        self.path, self.descriptor, self._device = path, descriptor, device
        self.axes = dict(axes)

    @property
    def is_pipe(self) -> bool:
        return self._device is None

    def deflection(self, code: int, value: int) -> float:
        """-1 to 1."""
        _, low, high, flat = self.axes[code]
        middle, half = (low + high) / 2, (high - low) / 2
        away = value - middle
        return 0.0 if abs(away) <= flat else max(-1.0, min(1.0, away / half))

    def standing(self) -> dict[int, int]:
        """What its axes say, asked anew; of a pipe, nothing."""
        if self._device is None:
            return {}
        return {code: self._device.absinfo(code).value for code in self.axes}

    def close(self) -> None:
        if self._device is not None:
            self._device.close()
        else:
            os.close(self.descriptor)


class JoystickInput:
    """The joystick that the rig names, opened anew when it comes back."""

    measured = False
    waits = False

    def __init__(self, loop: JoystickLoop, clock: Clock) -> None:
        """Raises DeviceError where it is not there, or evdev is not."""
        self.moved = frozenset(loop.commands)
        self._loop, self._clock = loop, clock
        self._told: list[tuple[Code, str]] = []
        self._asked: dict[int, int] = {}
        self._events = InputEvents()
        self._skips = self._is_strange_told = self._has_come = False
        self._next_ns = 0
        self._stick: _Stick | None = None
        self._is_heard = False
        self._begin(_open(loop))

    def _begin(self, stick: _Stick) -> None:
        self._stick = stick
        self._events = InputEvents()
        self._is_heard = self._has_come = not stick.is_pipe
        self._skips = self._is_strange_told = False
        self._asked = stick.standing()
        if not stick.is_pipe:
            self._told.append((Code.CONNECT, stick.path))

    @property
    def holds(self) -> bool:
        return self._stick is not None and self._is_heard

    def descriptors(self) -> list[int]:
        if self._stick is None and self._clock.now_ns() >= self._next_ns:
            self._next_ns = self._clock.now_ns() + _AGAIN_NS
            self._reopen()
        return [self._stick.descriptor] if self._stick is not None else []

    def _reopen(self) -> None:
        try:
            self._begin(_open(self._loop))
        except DeviceError:
            return

    def receive(self, descriptor: int, now_ns: int, take: Take) -> None:  # noqa: ARG002 - there is one
        if self._stick is None:
            return
        try:
            data = os.read(self._stick.descriptor, _READ)
        except BlockingIOError:
            return
        except OSError as error:
            self._gone(error.strerror or "it is gone")
            return
        if not data:
            if self._has_come:
                self._gone("who wrote into the pipe has gone")
            return
        self._has_come = True
        events = self._events.feed(data)
        if self._events.passed_over and not self._is_strange_told:
            self._is_strange_told = True
            self._told.append((Code.FOREIGN, self._events.passed_over))
        if not events:
            return
        if not self._is_heard:
            self._is_heard = True
            self._told.append((Code.CONNECT, self._stick.path))
        for code, value in {**self._asked, **self._newest(events)}.items():
            self._move(code, value, now_ns, take)
        self._asked = {}

    def _gone(self, why: str) -> None:
        assert self._stick is not None
        self._stick.close()
        self._stick = None
        self._next_ns = self._clock.now_ns() + _AGAIN_NS
        self._told.append((Code.DISCONNECT, f"joystick: {why}"))

    def _newest(self, events: list[Event]) -> dict[int, int]:
        """By axis, what it says last. After events were lost, all are asked for and what comes until the next
        synchronisation is passed over, as the kernel's documentation has it (input/event-codes.rst)."""
        assert self._stick is not None
        newest: dict[int, int] = {}
        for kind, code, value in events:
            if kind == SYN:
                if self._skips:
                    newest.update(self._stick.standing())
                self._skips = code == _DROPPED
            elif kind == ABS and code in self._stick.axes and not self._skips:
                newest[code] = value
        return newest

    def _move(self, code: int, value: int, now_ns: int, take: Take) -> None:
        assert self._stick is not None
        for name, channel in self._loop.commands.items():
            if AXES[channel.field] == code:
                take(now_ns, name, channel.to_si(self._stick.deflection(code, value)))

    def give_up(self) -> None:
        """Nothing: nobody waits for a hand."""

    def answer(self, step: int, row: Mapping[str, float], now_ns: int) -> None:
        """Nothing: a hand sees the instruments."""

    def told(self) -> list[tuple[str, Code, str]]:
        said, self._told = self._told, []
        return [("joystick", code, words) for code, words in said]

    def close(self) -> None:
        if self._stick is not None:
            self._stick.close()
            self._stick = None


def _open(loop: JoystickLoop) -> _Stick:
    """Raises DeviceError."""
    wanted = {AXES[channel.field] for channel in loop.commands.values()}
    try:
        is_pipe = stat.S_ISFIFO(os.stat(loop.device).st_mode)
    except OSError:
        is_pipe = False
    if is_pipe:
        low, high = loop.range
        # Not waiting for who writes, who may come later, and again.
        descriptor = os.open(loop.device, os.O_RDONLY | os.O_NONBLOCK)
        return _Stick(loop.device, descriptor, dict.fromkeys(wanted, (0, low, high, 0)))
    if "/" in loop.device and not loop.device.startswith(_FOLDER):
        raise DeviceError(f"joystick: {loop.device}: no pipe there: mkfifo {loop.device}, or name a device")
    return _open_device(loop.device, wanted)


def _open_device(name: str, wanted: set[int]) -> _Stick:
    try:
        evdev = importlib.import_module("evdev")
    except ImportError:
        raise DeviceError(
            "joystick: needs the package evdev: uv sync --extra joystick, or pip install evdev (Linux alone)"
        ) from None
    seen = []
    try:
        paths = [name] if name.startswith(_FOLDER) else sorted(evdev.list_devices())
        for path in paths:
            device = evdev.InputDevice(path)
            axes = {code: (i.value, i.min, i.max, i.flat) for code, i in device.capabilities().get(ABS, [])}
            is_named = name in (path, "any") or name.lower() in device.name.lower()
            if is_named and wanted <= set(axes):
                os.set_blocking(device.fd, False)
                return _Stick(path, device.fd, {c: axes[c] for c in wanted}, device)
            seen.append(device.name)
            device.close()
    except OSError as error:
        hint = ": join the group input" if error.errno == errno.EACCES else ""
        raise DeviceError(f"joystick: {error.filename or name}: {error.strerror}{hint}") from error
    axes_words = ", ".join(a for a, code in AXES.items() if code in wanted)
    raise DeviceError(
        f"joystick: none {'' if name == 'any' else f'like {name!r} '}with {axes_words}"
        f"\nthere is: {', '.join(seen) or 'no input device that may be read'}"
    )
