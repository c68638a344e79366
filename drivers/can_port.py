"""A CAN bus through any of python-can's interfaces, as a Port. Importing python-can takes seconds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, Final

import can

from drivers import serial_port
from drivers.can_frames import REFUSED_LINE, encode_slcan
from station.profile import CanBus
from station.rows import DeviceError

LISTENING: Final[Mapping[str, Mapping[str, Any]]] = {
    "cantact": {"monitor": True},
    "kvaser": {"driver_mode": False},  # canlib.DRIVER_MODE_SILENT
    "nixnet": {"listen_only": True},
    "pcan": {"state": can.BusState.PASSIVE},
    "seeedstudio": {"operation_mode": "silent"},
    "slcan": {"listen_only": True},  # Lawicel's command L in place of O
    "systec": {"state": can.BusState.PASSIVE},
    "vector": {"listen_only": True},
}
"""What keeps each of python-can's interfaces from acknowledging (can/interfaces of python-can 4.6); the others have no
such option. Of socketcan the system decides: ip link set can0 type can listen-only on."""
_WITHOUT_A_BUS: Final = ("virtual", "udp_multicast")


class CanPort:
    """An open python-can bus as a port: each read is at most one frame, as its slcan line."""

    def __init__(self, bus: can.BusABC, errors: tuple[type[Exception], ...]) -> None:
        self._bus = bus
        self._errors = errors

    def read(self, timeout_s: float) -> bytes:
        try:
            message = self._bus.recv(timeout_s)
        except (ValueError, IndexError, KeyError):
            return self._refuse_line()
        except self._errors as error:
            if isinstance(error.__cause__, ValueError):
                return self._refuse_line()
            raise OSError(str(error)) from error
        if message is None or message.is_remote_frame or message.is_error_frame:
            return b""
        if message.is_fd or message.dlc != len(message.data):
            return REFUSED_LINE
        return encode_slcan(message.arbitration_id, message.is_extended_id, bytes(message.data))

    def _refuse_line(self) -> bytes:
        """python-can's slcan raises a bare ValueError for a corrupt line, or wraps it if the line is not ASCII.

        Such a line it also leaves in its buffer, where it would spoil every line to come.
        """
        unread = getattr(self._bus, "_buffer", None)
        if isinstance(unread, bytearray):
            unread.clear()
        return REFUSED_LINE

    def write(self, data: bytes) -> None:  # noqa: ARG002 - the station only listens here
        raise OSError("the station does not send on CAN")

    def close(self) -> None:
        try:
            self._bus.shutdown()
        except self._errors:
            # With its adapter gone, python-can cannot send the closing command and leaves the port open.
            handle = getattr(self._bus, "serialPortOrig", None)
            if handle is not None:
                handle.close()


class BlockReader:
    """A serial port, read in blocks and handed out byte by byte.

    python-can's slcan asks for single bytes, each a wait in the operating system that gives the interpreter away: a
    frame would take as many turns as it has letters whenever another thread is busy.
    """

    def __init__(self, port: Any) -> None:
        self._port = port
        self._block = b""
        self._next = 0

    @property
    def in_waiting(self) -> int:
        return len(self._block) - self._next or int(self._port.in_waiting)

    def read(self, size: int) -> bytes:
        if self._next == len(self._block):
            self._block, self._next = self._port.read(1), 0
            if self._block and (waiting := self._port.in_waiting):
                self._block += self._port.read(waiting)
        taken = self._block[self._next : self._next + size]
        self._next += len(taken)
        return taken

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)


class MulticastPort:
    """An emulated device's end of a bus of UDP multicasts: takes slcan lines, as the adapters do."""

    def __init__(self, channel: str) -> None:
        self.endpoint = channel
        self._bus: can.BusABC | None = None

    def plug(self) -> None:
        """Raises DeviceError."""
        if self._bus is None:
            try:
                self._bus = can.Bus(interface="udp_multicast", channel=self.endpoint, ignore_config=True)
            except (can.CanError, OSError, ValueError, ImportError) as error:
                raise DeviceError(f"cannot open CAN udp_multicast {self.endpoint}: {error}") from error

    def unplug(self) -> None:
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = None

    def send(self, messages: Sequence[bytes]) -> None:
        if self._bus is None:
            return
        for line in (line for message in messages for line in message.split(b"\r") if line):
            is_extended = line[:1] == b"T"
            digits = 8 if is_extended else 3
            number, data = int(line[1 : 1 + digits], 16), bytes.fromhex(line[2 + digits :].strip().decode("ascii"))
            message = can.Message(arbitration_id=number, is_extended_id=is_extended, data=data)
            with suppress(can.CanError, OSError):
                self._bus.send(message)

    def descriptors(self) -> list[int]:
        return []

    def receive(self, descriptor: int) -> bytes:  # noqa: ARG002 - nobody answers
        return b""

    def close(self) -> None:
        self.unplug()


def part_in_bus(device: CanBus) -> str:
    """What the station does on a bus besides listening, in words."""
    if device.interface in _WITHOUT_A_BUS:
        return "nothing"
    if device.interface == "socketcan":
        return "nothing; acknowledges frames unless the system is told: ip link set CAN type can listen-only on"
    if device.listen_only and device.interface in LISTENING:
        return "nothing, not even acknowledgements"
    why = "" if device.interface in LISTENING else f" (python-can cannot make {device.interface} listen only)"
    return f"nothing, but acknowledges frames{why}"


def open_port(device: CanBus, channel: str, is_emulated: bool = False) -> CanPort:
    """The bus, opened. Raises DeviceError saying why not."""
    options: dict[str, Any] = {"bitrate": device.bitrate}
    if device.listen_only:
        options |= LISTENING.get(device.interface, {})
    if device.interface == "slcan":
        # A read waits in the operating system, not in a polling loop. Real adapters may restart when opened, and the
        # library's default gives them two seconds.
        options["timeout"] = 0.02
        if is_emulated:
            options["sleep_after_open"] = 0.0
        if channel.startswith(serial_port.USB):
            channel = serial_port.path_of(channel)
        if "://" not in channel:
            # Says why a port cannot be had, and keeps python-can from writing into another program's adapter.
            serial_port.open_port(channel.partition("@")[0], baud=115_200).close()
    try:
        bus = can.Bus(interface=device.interface, channel=channel, ignore_config=True, **options)
    except (can.CanError, OSError, ValueError, ImportError, TypeError) as error:
        raise DeviceError(f"cannot open CAN {device.interface} {channel}: {error}") from error
    port = CanPort(bus, (can.CanError, OSError))
    handle = getattr(bus, "serialPortOrig", None)
    if handle is not None:
        try:
            handle.exclusive = True
        except OSError as error:
            port.close()
            raise DeviceError(f"{channel} is busy: another program has it open; close that") from error
        slcan: Any = bus
        slcan.serialPortOrig = BlockReader(handle)
    return port
