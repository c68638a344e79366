"""A serial port of the operating system as a Port."""

from __future__ import annotations

import errno

import serial

from station.rows import DeviceError


class SerialPort:
    """An open, exclusively held serial port. Errors are OSError (pyserial's own are)."""

    def __init__(self, port: serial.Serial) -> None:
        self._port = port

    def read(self, timeout_s: float) -> bytes:
        if self._port.timeout != timeout_s:
            self._port.timeout = timeout_s
        block: bytes = self._port.read(1)
        if block and (waiting := self._port.in_waiting):
            block += self._port.read(waiting)
        return block

    def write(self, data: bytes) -> None:
        self._port.write(data)

    def close(self) -> None:
        self._port.close()


def open_port(path: str, baud: int) -> SerialPort:
    """The port at `path`. Raises DeviceError saying why not and what to do."""
    try:
        return SerialPort(serial.Serial(path, baud, timeout=0.0, write_timeout=0.5, exclusive=True))
    except (OSError, ValueError) as error:
        raise DeviceError(f"cannot open {path}: {_why(error)}") from error


def _why(error: Exception) -> str:
    number = getattr(error, "errno", None)
    if number == errno.ENOENT:
        return "no such port; is the device plugged in?"
    if number == errno.EACCES:
        return "permission denied; is this user in the group that owns the port (dialout)?"
    if number in (errno.EBUSY, errno.EAGAIN) or "lock" in str(error):
        return "busy: another program has it open; close that"
    return str(error)
