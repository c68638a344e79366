"""station rig new: a rig proposed from what is plugged in."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from station.clock import SystemClock
from station.console import DONE, say, say_wrapped
from station.profile import Rig, find, load_card, read_profile
from station.rows import DeviceError, ProfileError, UsageError

if TYPE_CHECKING:
    from drivers.listening import Heard

NOBODY_TO_ASK = """not a terminal: nobody can be asked
--yes takes all that is heard; --map v0=alpha_vane:deg:0.005 says what a box's field is"""
NOTHING_HEARD = """nothing was heard that a rig could read
is it plugged in and sending? station doctor lists ports and their permissions
an autopilot on the network: --mavlink udpin:0.0.0.0:14550"""

USUAL_MAVLINK = "udpin:127.0.0.1:14550"
NONE = "none"
MAP = "what a box's field is"
IMU = 'where the accelerometers are, from the centre of gravity: forward, right, down, like "0.1 m, 0 m, 0 m"'


class Action(StrEnum):
    new = "new"


def rig_(
    action: Annotated[Action, typer.Argument(help="new: listen to what is plugged in, write a rig and a card")],  # noqa: ARG001
    name: Annotated[str, typer.Argument(help="of the rig and the card: letters, digits, _")],
    folder: Annotated[Path, typer.Option(metavar="DIR", help="where rigs/ and cards/ are")] = Path(),
    port: Annotated[
        list[str] | None, typer.Option(metavar="PATH[@BAUD]", help="a serial port, not all; or none")
    ] = None,
    can: Annotated[
        list[str] | None, typer.Option(metavar="INTERFACE:CHANNEL", help="like socketcan:can0; or none")
    ] = None,
    mavlink: Annotated[str, typer.Option(metavar="URL", help="where an autopilot sends to, or none")] = USUAL_MAVLINK,
    field: Annotated[list[str] | None, typer.Option("--map", metavar="FIELD=SIGNAL:UNIT:SLOPE:ZERO", help=MAP)] = None,
    aircraft: Annotated[str, typer.Option(metavar="NAME", help="of the card; that of this name, or unknown")] = "",
    imu: Annotated[str, typer.Option("--imu-position", metavar="X,Y,Z", help=IMU)] = "",
    seconds: Annotated[float, typer.Option(min=1.0, max=60.0, help="how long each device is listened to")] = 3.0,
    yes: Annotated[bool, typer.Option("--yes", help="ask nothing, take all that is heard")] = False,
) -> int:
    """Listen to serial ports, CAN interfaces and MAVLink, propose signals, write a commented rig and a card for it."""
    from drivers.adapter import check_devices
    from station.commands.proposals import card_text, imu_place, propose, rig_text, unused

    rig_file, card_file = new_file(folder, "rigs", name), new_file(folder, "cards", name)
    if not (yes or sys.stdin.isatty()):
        raise UsageError(NOBODY_TO_ASK)
    ask = _nothing if yes else _ask
    heard: list[Heard] = []
    names: dict[str, str] = {}
    for place in _places(port, can, mavlink, seconds):
        found = _listen(place, ask)
        if found is not None:
            heard.append(found)
            names[found.address] = place.name or found.address
    if not heard:
        raise DeviceError(NOTHING_HEARD)
    made = propose(heard, ask, field or ())
    if not made.signals():
        raise UsageError(
            "no field of what was heard is a signal: say what they are, like --map v0=alpha_vane:deg:0.005"
        )
    for _, found, streams in made.devices:
        if not any(streams.values()):
            say(f"{found.address}: {unused(found)}")
    _write(rig_file, rig_text(name, made, names, imu_place(made, ask, imu)))
    _write(card_file, card_text(name, aircraft or _aircraft(folder, name), made))
    check_devices(read_profile(Rig, rig_file), rig_file)
    try:
        load_card(str(card_file))
    except ProfileError as error:
        say(f"the card cannot be flown yet: {error}")
    say(f"next: station check {card_file}")
    return DONE


@dataclass(frozen=True, slots=True)
class _Place:
    """Where to listen, and what a rig calls it where that is not its address."""

    listen: Callable[[], Heard]
    name: str = ""


def new_file(folder: Path, kind: str, name: str) -> Path:
    """Where a profile of this name is to be written. Raises UsageError where one is, or for a name that is none."""
    path = folder / kind / f"{name}.toml"
    if not name.isidentifier():
        raise UsageError(f"{name}: a name of letters, digits and _")
    if path.exists():
        raise UsageError(f"{path} is there already: another name, or remove it first")
    return path


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    say(f"written: {path}")


def _aircraft(folder: Path, name: str) -> str:
    """The aircraft of this name, or the one that nobody has described."""
    try:
        find("aircraft", name, folder / "cards" / "card.toml")
    except ProfileError:
        say(f"aircraft: unknown, no derivatives; describe yours (station aircraft new {name}) and name it in the card")
        return "unknown"
    return name


def _listen(place: _Place, ask: Callable[[str], str]) -> Heard | None:
    """What is there and is to be used."""
    from station.commands.proposals import describe

    try:
        found = place.listen()
    except DeviceError as error:
        say(f"  {error}")
        return None
    say_wrapped(f"  {describe(found)}")
    if not found.messages:
        return None
    is_declined = ask(f"  use it? [Y/n] ({found.address})").lower() in ("n", "no")
    return None if is_declined else found


def _places(ports: list[str] | None, cans: list[str] | None, mavlink: str, seconds: float) -> Iterator[_Place]:
    """Each place in turn: serial ports and CAN interfaces that are there, or are named, and MAVLink."""
    from drivers import listening
    from drivers.ports_there import PortThere, can_interfaces, serial_ports

    clock = SystemClock()

    def usable(there: Iterator[PortThere]) -> list[str]:
        found = list(there)
        for one in found or [PortThere("none", "", False)]:
            words = ", ".join(w for w in (one.what, listening.by_id(one.name), one.why_not) if w)
            say(f"  {one.name}{f': {words}' if words else ''}")
        return [one.name for one in found if one.usable]

    def serial(one: str) -> _Place:
        path, _, rate = one.partition("@")
        if rate and not rate.isdecimal():
            raise UsageError(f"--port {one}: PATH@BAUD, like /dev/ttyUSB0@115200")
        baud = int(rate) if rate else None
        return _Place(lambda: listening.serial_device(path, seconds, clock, baud), listening.lasting_name(path))

    def bus(one: str) -> _Place:
        interface, colon, channel = one.partition(":")
        if not colon:
            raise UsageError(f"--can {one}: INTERFACE:CHANNEL, like socketcan:can0")
        return _Place(lambda: listening.dronecan_device(interface, channel, seconds, clock))

    if ports != [NONE]:
        say("serial ports:")
        yield from map(serial, usable(serial_ports()) if ports is None else ports)
    if cans != [NONE]:
        say("CAN interfaces:")
        yield from map(bus, [f"socketcan:{n}" for n in usable(can_interfaces())] if cans is None else cans)
    if mavlink != NONE:
        say(f"MAVLink on {mavlink}:")
        yield _Place(lambda: listening.mavlink_device(mavlink, seconds, clock))


def _ask(question: str) -> str:
    say_wrapped(question)
    return input("> ").strip()


def _nothing(_: str) -> str:
    return ""
