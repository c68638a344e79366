"""What an autopilot in the loop is connected to: a port that it calls over TCP, or a serial line. Nothing here blocks.

A link that goes is told and waited for; what the other side does not take in time is lost as a whole.
"""

from __future__ import annotations

import errno
import os
import socket
from typing import Final, Protocol

from drivers import serial_port
from drivers.serial_port import SerialPort
from station.clock import Clock
from station.rows import Code, DeviceError

_WAITING: Final = 65_536
"""Bytes of a client that does not read: then it is hung up on."""
_LAST_PORT: Final = 65_535
_AGAIN_NS: Final = 1_000_000_000


class Link(Protocol):
    """One autopilot at a time."""

    def descriptors(self) -> list[int]:
        """What to wait on."""
        ...

    def receive(self, descriptor: int) -> bytes:
        """What has come; empty if nothing to read."""
        ...

    def send(self, data: bytes) -> None: ...

    def told(self) -> list[tuple[Code, str]]:
        """What has happened to it since this was last asked."""
        ...

    def close(self) -> None: ...


class TcpServerLink:
    """Listens; one client at a time, others are hung up on."""

    def __init__(self, host: str, port: int) -> None:
        """Raises DeviceError."""
        try:
            self._listener = socket.create_server((host, port))
        except OSError as error:
            raise _cannot_listen(f"{host}:{port}", error) from error
        self._listener.setblocking(False)
        self._client: socket.socket | None = None
        self._rest = b""
        self._told: list[tuple[Code, str]] = []

    def descriptors(self) -> list[int]:
        return [s.fileno() for s in (self._listener, self._client) if s is not None]

    def receive(self, descriptor: int) -> bytes:
        if descriptor == self._listener.fileno():
            self._accept()
            return b""
        if self._client is None or descriptor != self._client.fileno():
            return b""
        try:
            data = self._client.recv(65_536)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._hang_up("the autopilot has closed the connection")
        return data

    def _accept(self) -> None:
        try:
            client, (host, port, *_) = self._listener.accept()
        except OSError:
            return
        if self._client is not None:
            client.close()
            self._told.append((Code.FOREIGN, f"{host}:{port} called while another autopilot is in the loop"))
            return
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._client, self._rest = client, b""
        self._told.append((Code.CONNECT, f"{host}:{port}"))

    def send(self, data: bytes) -> None:
        if self._client is None:
            return
        # Half a message is finished before the next begins.
        waiting = self._rest + data
        try:
            taken = self._client.send(waiting) if waiting else 0
        except BlockingIOError:
            taken = 0
        except OSError:
            self._hang_up("the autopilot has gone")
            return
        self._rest = waiting[taken:]
        if len(self._rest) > _WAITING:
            self._hang_up("the autopilot does not read what it is sent")

    def _hang_up(self, why: str) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None
            self._told.append((Code.DISCONNECT, why))

    def told(self) -> list[tuple[Code, str]]:
        said, self._told = self._told, []
        return said

    def close(self) -> None:
        self._hang_up("")
        self._listener.close()


class SerialLink:
    """A serial line to an autopilot's hardware; opened anew when it comes back."""

    def __init__(self, path: str, baud: int, clock: Clock) -> None:
        self._path, self._baud, self._clock = path, baud, clock
        self._port: SerialPort | None = None
        self._next_ns = 0
        self._told: list[tuple[Code, str]] = []
        self._missing = False
        self._open()

    def _open(self) -> None:
        self._next_ns = self._clock.now_ns() + _AGAIN_NS
        try:
            self._port = serial_port.open_port(self._path, self._baud)
        except DeviceError as error:
            if not self._missing:
                self._told.append((Code.DISCONNECT, str(error)))
            self._missing = True
            return
        self._missing = False
        os.set_blocking(self._port.fileno(), False)
        self._told.append((Code.CONNECT, self._path))

    def descriptors(self) -> list[int]:
        if self._port is None and self._clock.now_ns() >= self._next_ns:
            self._open()
        return [self._port.fileno()] if self._port is not None else []

    def receive(self, descriptor: int) -> bytes:
        try:
            data = os.read(descriptor, 4096)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._lose()
        return data

    def send(self, data: bytes) -> None:
        if self._port is None or not data:
            return
        try:
            os.write(self._port.fileno(), data)
        except BlockingIOError:
            return
        except OSError:
            self._lose()

    def _lose(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port, self._missing = None, True
            self._told.append((Code.DISCONNECT, f"{self._path} is gone"))

    def told(self) -> list[tuple[Code, str]]:
        said, self._told = self._told, []
        return said

    def close(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None


def open_link(url: str, baud: int, clock: Clock) -> Link:
    """tcpin:HOST:PORT, or a serial port. Raises DeviceError for what cannot be opened and will not come."""
    if not url.startswith("tcpin:"):
        if ":" in url and not url.startswith(("/", "COM", serial_port.USB)):
            raise DeviceError(f"loop: url: cannot open {url}: write tcpin:HOST:PORT or a serial port's path")
        return SerialLink(url, baud, clock)
    return TcpServerLink(*address(url.removeprefix("tcpin:")))


def address(text: str) -> tuple[str, int]:
    """HOST:PORT; without HOST the loopback. Raises DeviceError."""
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or int(port) > _LAST_PORT:
        raise DeviceError(f"loop: cannot listen on {text}: the port must be a number from 1 to 65535")
    return host or "127.0.0.1", int(port)


def listening_socket(text: str) -> socket.socket:
    """A UDP socket bound to HOST:PORT that does not block. Raises DeviceError."""
    place = address(text)
    here = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        here.bind(place)
    except OSError as error:
        here.close()
        raise _cannot_listen(text, error) from error
    here.setblocking(False)
    return here


def _cannot_listen(place: str, error: OSError) -> DeviceError:
    hint = ": another program listens there; close that or use another port"
    hint = hint if error.errno == errno.EADDRINUSE else ""
    return DeviceError(f"loop: cannot listen on {place}: {os.strerror(error.errno or 0)}{hint}")
