"""Who is there: ports are listened to for a few seconds, so that a rig can be proposed from what is heard.

Nothing is sent. A serial port is tried at the usual speeds until its bytes are recognised; a CAN interface is listened
to for DroneCAN; MAVLink on UDP for the first vehicle's messages.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from drivers import serial_port
from drivers.codec import Codec, Port, Reading
from drivers.protocols import protocol_named
from drivers.signatures import SIGNATURES, recognised, shown_as_text
from station.clock import Clock
from station.profile import DronecanDevice, MavlinkDevice
from station.rows import DeviceError

BAUDS: Final = (115_200, 921_600, 460_800, 57_600, 38_400, 9_600, 230_400)
"""The usual ones, likeliest first."""
TRIED_S: Final = 0.8
"""A speed is listened to for so long; what is then silent is so at any speed."""
_READ_S: Final = 0.05
_BY_ID: Final = Path("/dev/serial/by-id")


@dataclass(slots=True)
class Message:
    """What was heard of one message: how often, and each field's lowest, highest and last value."""

    count: int = 0
    fields: dict[str, tuple[float, float, float]] = field(default_factory=dict)

    def hear(self, reading: Reading) -> None:
        self.count += 1
        for name, value in reading.fields.items():
            low, high, _ = self.fields.get(name, (value, value, value))
            self.fields[name] = (min(low, value), max(high, value), value)


@dataclass(slots=True)
class Heard:
    """A device as a rig would name it, and what it said in `seconds`; no messages: why nothing can be read of it."""

    link: str
    address: str
    protocol: str = ""
    baud: int | None = None
    what: str = ""
    seconds: float = 0.0
    messages: dict[str | int, Message] = field(default_factory=dict)

    def rate(self, message: str | int) -> float:
        """Of a message, Hz."""
        return self.messages[message].count / self.seconds


def by_id(port: str) -> str:
    """The name under /dev/serial/by-id of a port; empty without one."""
    there = _BY_ID.iterdir() if _BY_ID.is_dir() else ()
    return next((link.name for link in there if link.resolve() == Path(port).resolve()), "")


def serial_device(port: str, seconds: float, clock: Clock, baud: int | None = None) -> Heard:
    """Who speaks on a serial port, at one of BAUDS or the one given. Raises DeviceError for one that cannot be had."""
    text = ""
    for rate in (baud,) if baud else BAUDS:
        opened = serial_port.open_port(port, rate)
        try:
            data = b"".join(_blocks(opened, TRIED_S, clock))
            if not data:
                return Heard("serial", port, what="silent")
            name = recognised(data)
            if name and SIGNATURES[name].protocol:
                codec = protocol_named(name).codec()
                found = Heard("serial", port, name, rate, SIGNATURES[name].words)
                _hear(found, codec, opened, seconds, clock)
                return found
            if name:
                return Heard("serial", port, name, rate, SIGNATURES[name].words)
            text = text or shown_as_text(data)
        finally:
            opened.close()
    said = f"text that is no list of numbers: {text!r}" if text else "bytes of no protocol that the station knows"
    return Heard("serial", port, what=said)


def mavlink_device(url: str, seconds: float, clock: Clock) -> Heard:
    """The first vehicle on a MAVLink url. Raises DeviceError for one that cannot be opened."""
    from drivers import mavlink_port
    from drivers.mavlink import MavlinkCodec

    device = MavlinkDevice.model_validate(
        {"name": "n", "link": "mavlink", "url": url, "streams": [_stream("HEARTBEAT")]}
    )
    codec = MavlinkCodec(device)
    found = Heard("mavlink", url, "mavlink")
    port = mavlink_port.open_port(device, url, codec, clock)
    try:
        _hear(found, codec, port, seconds, clock)
    finally:
        port.close()
    found.messages.pop("HEARTBEAT", None)
    others = f"; passed over: {', '.join(codec.foreign)}" if codec.foreign else ""
    found.what = f"{codec.speaker or 'no vehicle heard'}{others}"
    return found


def dronecan_device(interface: str, channel: str, seconds: float, clock: Clock) -> Heard:
    """DroneCAN's usual messages on a CAN interface, and how many other frames. Raises DeviceError."""
    from drivers import can_port
    from drivers.can_dronecan import USUAL, DronecanCodec

    told = {"name": "n", "link": "dronecan", "interface": interface, "channel": channel}
    device = DronecanDevice.model_validate({**told, "streams": [_stream(name) for name in USUAL]})
    found = Heard("dronecan", f"{interface}:{channel}", "dronecan")
    port = can_port.open_port(device, channel)
    lines = 0

    def counted(block: bytes) -> None:
        nonlocal lines
        lines += block.count(b"\r")

    try:
        _hear(found, DronecanCodec(device), port, seconds, clock, counted)
    finally:
        port.close()
    found.what = (
        "DroneCAN" if found.messages else f"{lines} frames, none of DroneCAN's usual ones" if lines else "silent"
    )
    return found


def _stream(message: str) -> dict[str, object]:
    return {"name": message, "message": message, "rate": "1 Hz", "signals": {}}


def _hear(
    found: Heard, codec: Codec, port: Port, seconds: float, clock: Clock, also: Callable[[bytes], None] | None = None
) -> None:
    """Read for so long. Rates count from the first message: a vehicle's come after its first heartbeat."""
    first_ns = None
    try:
        for block in _blocks(port, seconds, clock):
            for reading in codec.feed(block):
                if isinstance(reading, Reading):
                    first_ns = first_ns or clock.now_ns()
                    found.messages.setdefault(reading.message, Message()).hear(reading)
            if also is not None:
                also(block)
    except OSError as error:
        raise DeviceError(f"{found.address}: lost while listening: {error}") from error
    found.seconds = max(TRIED_S, (clock.now_ns() - (first_ns or 0)) * 1e-9)


def _blocks(port: Port, seconds: float, clock: Clock) -> Iterator[bytes]:
    end_ns = clock.now_ns() + round(seconds * 1e9)
    while clock.now_ns() < end_ns:
        if block := port.read(_READ_S):
            yield block


def lasting_name(port: str) -> str:
    """What a rig best calls a port: its adapter's serial number, which stays when the path does not, or its path."""
    return serial_port.usb_name(port) or port
