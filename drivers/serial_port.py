"""A serial port of the operating system as a Port: by its path, or by its USB adapter's serial number.

    PATH               /dev/ttyUSB0, /dev/serial/by-id/..., COM3
    usb:SERIAL         the port of the adapter with this serial number, whatever its path is now
    usb:SERIAL:1.0     of an adapter with several ports the one of this USB interface

A path is given to whoever is plugged in next: an adapter that was away for a moment may come back under another.
"""

from __future__ import annotations

import errno
import os
import select
from typing import Final

import serial
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from drivers.ports_there import permission_lacking
from station.rows import DeviceError

USB: Final = "usb:"
MOST_NAMED: Final = 6
_MOST_AT_ONCE: Final = 65_536


class SerialPort:
    """An open, exclusively held serial port. Errors are OSError (pyserial's own are)."""

    def __init__(self, port: serial.Serial) -> None:
        self._port = port
        self._has_file = os.name == "posix"

    def read(self, timeout_s: float) -> bytes:
        if self._has_file:
            return self._read_file(timeout_s)
        if self._port.timeout != timeout_s:
            self._port.timeout = timeout_s
        block: bytes = self._port.read(1)
        if block and (waiting := self._port.in_waiting):
            block += self._port.read(waiting)
        return block

    def _read_file(self, timeout_s: float) -> bytes:
        """Two calls of the system where pyserial makes five, each of which gives the interpreter away."""
        file = self._port.fileno()
        if timeout_s > 0 and not select.select([file], [], [], timeout_s)[0]:
            return b""
        try:
            block = os.read(file, _MOST_AT_ONCE)
        except BlockingIOError:  # nothing after all
            return b""
        if not block and timeout_s > 0:
            raise OSError(errno.ENODEV, "the port is ready to read but gives nothing: has the device gone?")
        return block

    def write(self, data: bytes) -> None:
        self._port.write(data)

    def fileno(self) -> int:
        return int(self._port.fileno())

    def close(self) -> None:
        self._port.close()


def path_of(port: str) -> str:
    """Where a port is now. Raises DeviceError for an adapter that is not plugged in, naming those that are."""
    if not port.startswith(USB):
        return port
    found = [there for there in list_ports.comports() if port in _names(there)]
    if len(found) == 1:
        return str(found[0].device)
    if found:
        several = ", ".join(f"{_names(there)[-1]} ({there.device})" for there in sorted(found))
        raise DeviceError(f"cannot open {port}: several ports have this serial number; use one of {several}")
    raise DeviceError(f"cannot open {port}: no such adapter; is it plugged in?{_plugged_in()}")


def _names(there: ListPortInfo) -> list[str]:
    """What a port may be called in a rig, the most exact last; none without a serial number."""
    if not there.serial_number:
        return []
    name, (_, _, interface) = f"{USB}{there.serial_number}", str(there.location or "").partition(":")
    return [name, f"{name}:{interface}"] if interface else [name]


def usb_name(path: str) -> str:
    """The name by which a rig finds this port under any path: of an adapter of several ports the exact one; empty for a
    port without a serial number, or with one that others have too."""
    mine = next((_names(there) for there in list_ports.comports() if there.device == path), [])
    for name in mine:
        if sum(name in _names(there) for there in list_ports.comports()) == 1:
            return name
    return ""


def _plugged_in() -> str:
    """The USB ports that are there, as a rig may name them."""
    words = [f"{_names(there)[0]} ({there.device})" for there in sorted(list_ports.comports()) if _names(there)]
    return f"\nplugged in: {', '.join(words[:MOST_NAMED])}" if words else ""


def open_port(port: str, baud: int) -> SerialPort:
    """The port of this path or USB serial number. Raises DeviceError saying why not and what to do."""
    path = path_of(port)
    try:
        return SerialPort(serial.Serial(path, baud, timeout=0.0, write_timeout=0.5, exclusive=True))
    except (OSError, ValueError) as error:
        raise DeviceError(f"cannot open {path}: {_why(error, path)}") from error


def _why(error: Exception, path: str) -> str:
    number = getattr(error, "errno", None)
    if number == errno.ENOENT:
        return (
            "no such port; is the device plugged in?\n"
            f'port = "usb:SERIAL" in the rig finds it under another path too{_plugged_in()}'
        )
    if number == errno.EACCES:
        return permission_lacking(path)
    if number in (errno.EBUSY, errno.EAGAIN) or "lock" in str(error):
        return "busy: another program has it open; close that"
    return str(error)
