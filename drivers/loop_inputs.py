"""Who is in the loop, as the loop sees them: what has come, what goes back, and whether to wait."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from typing import Any, Protocol

from drivers.adapter import Adapter, open_devices
from drivers.ardupilot_json import ArdupilotJson
from drivers.joystick import JoystickInput
from drivers.loop_links import Link, listening_socket, open_link
from drivers.mavlink_frame import SILENT_NS
from drivers.mavlink_hil import MavlinkHil
from drivers.surface_tap import SurfaceTap
from station.clock import Clock, SystemClock
from station.profile import JoystickLoop, JsonLoop, MavlinkLoop, Profiles
from station.rows import Code, Event, Rows

Take = Callable[[int, str, float], None]
"""Station time, ns, what moves, and where to."""


class LoopInput(Protocol):
    """One hand or autopilot."""

    @property
    def moved(self) -> Collection[str]:
        """What it moves."""
        ...

    @property
    def measured(self) -> bool:
        """Whether that is where surfaces are, or a command."""
        ...

    def descriptors(self) -> list[int]: ...

    def receive(self, descriptor: int, now_ns: int, take: Take) -> None:
        """Read what has come and hand on what is to be flown."""
        ...

    @property
    def waits(self) -> bool:
        """Whether the next step is to wait for it."""
        ...

    @property
    def holds(self) -> bool:
        """Whether what it said last still holds: it is there, and tells changes alone."""
        ...

    def give_up(self) -> None:
        """It has not answered in time."""
        ...

    def answer(self, step: int, row: Mapping[str, float], now_ns: int) -> None:
        """A step has been made."""
        ...

    def told(self) -> list[tuple[str, Code, str]]:
        """Source, code and words of what has happened since this was last asked."""
        ...

    def close(self) -> None: ...


class MeasuredInput:
    """A hand on the bench, through whoever reads the devices: the station with a `tap`, or else adapters of its own."""

    measured = True
    waits = False
    holds = False

    def __init__(self, profiles: Profiles, tap: SurfaceTap | None) -> None:
        measured = profiles.rig.measured_surfaces
        self.moved = frozenset(name for names in measured.values() for name in names)
        self._noted: list[Event] = []
        self._adapters: list[Adapter] = []
        self._tap = tap or SurfaceTap(profiles.rig)
        if tap is None:
            names = {stream.partition(".")[0] for stream in measured}
            own = tuple(d for d in profiles.rig.devices if d.name in names)
            rig = profiles.rig.model_copy(update={"devices": own})
            self._adapters = open_devices(rig, {}, profiles.rig_dir, SystemClock(), self._tap.putting(self._note))
            for adapter in self._adapters:
                adapter.start()

    def _note(self, row: Rows) -> None:
        if isinstance(row, Event):
            self._noted.append(row)

    def descriptors(self) -> list[int]:
        return [self._tap.fileno()]

    def receive(self, descriptor: int, now_ns: int, take: Take) -> None:  # noqa: ARG002 - there is one; they are stamped
        for t_ns, name, value in self._tap.take():
            take(t_ns, name, value)

    def give_up(self) -> None:
        """Nothing: nobody waits for a hand."""

    def answer(self, step: int, row: Mapping[str, float], now_ns: int) -> None:
        """Nothing: a hand sees the instruments."""

    def told(self) -> list[tuple[str, Code, str]]:
        said = []
        while self._noted:
            event = self._noted.pop(0)
            said.append((event.source, event.code, event.detail))
        return said

    def close(self) -> None:
        for adapter in self._adapters:
            adapter.stop()


class MavlinkInput:
    """An autopilot on a stream of bytes."""

    measured = False
    holds = False

    def __init__(self, loop: MavlinkLoop, link: Link, seed: int) -> None:
        self.moved = frozenset(loop.commands)
        self._link, self._session = link, MavlinkHil(loop, seed)

    def descriptors(self) -> list[int]:
        return self._link.descriptors()

    def receive(self, descriptor: int, now_ns: int, take: Take) -> None:
        for name, value in self._session.feed(self._link.receive(descriptor), now_ns):
            take(now_ns, name, value)

    @property
    def waits(self) -> bool:
        return self._session.waits

    def give_up(self) -> None:
        self._session.give_up()

    def answer(self, step: int, row: Mapping[str, float], now_ns: int) -> None:
        self._link.send(self._session.outgoing(step, row, now_ns))

    def told(self) -> list[tuple[str, Code, str]]:
        said = []
        for code, words in self._link.told():
            if code in (Code.CONNECT, Code.DISCONNECT):
                self._session.begin()
            said.append(("autopilot in the loop", code, words))
        return said + [("autopilot in the loop", code, words) for code, words in self._session.told()]

    def close(self) -> None:
        self._link.close()


class JsonInput:
    """An ArduPilot on datagrams: whoever sends the first servo packet, until it has been silent for SILENT_NS."""

    measured = False
    holds = False

    def __init__(self, loop: JsonLoop) -> None:
        """Raises DeviceError."""
        self.moved = frozenset(loop.commands)
        self._session = ArdupilotJson(loop)
        self._socket = listening_socket(loop.address)
        self._peer: tuple[str, int] | None = None
        self._heard_ns = 0
        self._is_other_told = False
        self._told: list[tuple[Code, str]] = []

    def descriptors(self) -> list[int]:
        return [self._socket.fileno()]

    def receive(self, descriptor: int, now_ns: int, take: Take) -> None:  # noqa: ARG002 - there is one
        try:
            data, sender = self._socket.recvfrom(2048)
        except OSError:
            return
        if sender != self._peer and not self._takes(sender, data, now_ns):
            return
        self._heard_ns = now_ns
        for name, value in self._session.feed(data, now_ns):
            take(now_ns, name, value)

    def _takes(self, sender: tuple[str, int], data: bytes, now_ns: int) -> bool:
        if not self._session.is_servo_packet(data, now_ns):
            return False
        if self._peer is not None and now_ns - self._heard_ns <= SILENT_NS:
            if not self._is_other_told:
                self._is_other_told = True
                (host, port), (other, its) = sender, self._peer
                words = f"{host}:{port} sends servo packets too: not flown while {other}:{its} is in the loop"
                self._told.append((Code.FOREIGN, words))
            return False
        if self._peer is not None:
            self._session.begin()
        self._peer, self._is_other_told = sender, False
        self._told.append((Code.CONNECT, f"{sender[0]}:{sender[1]}"))
        return True

    @property
    def waits(self) -> bool:
        return self._session.waits

    def give_up(self) -> None:
        self._session.give_up()

    def answer(self, step: int, row: Mapping[str, float], now_ns: int) -> None:  # noqa: ARG002 - it has its own time
        data = self._session.outgoing(step, row)
        if data and self._peer is not None:
            with suppress(OSError):
                self._socket.sendto(data, self._peer)

    def told(self) -> list[tuple[str, Code, str]]:
        said, self._told = self._told + self._session.told(), []
        return [("autopilot in the loop", code, words) for code, words in said]

    def close(self) -> None:
        self._socket.close()


def input_of(profiles: Profiles, tap: SurfaceTap | None, clock: Clock) -> LoopInput:
    """Who is in the rig's loop. Raises StationError for a link that cannot be opened."""
    loop: Any = profiles.rig.loop
    match loop:
        case MavlinkLoop():
            return MavlinkInput(loop, open_link(loop.url, loop.baud, clock), profiles.card.flight.seed)
        case JsonLoop():
            return JsonInput(loop)
        case JoystickLoop():
            return JoystickInput(loop, clock)
    return MeasuredInput(profiles, tap)
