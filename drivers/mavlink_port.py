"""Where MAVLink comes from, as a Port: UDP, TCP or a serial port.

    udpin:HOST:PORT    listen (also udp:); what is sent goes to whoever was heard last
    udpout:HOST:PORT   send first and hear what comes back; needs something to send
    tcp:HOST:PORT      connect to a server
    PATH               a serial port

An empty HOST (udpin::14550 or udpin:14550) is the loopback, so is anything not named.
"""

from __future__ import annotations

import errno
import select
import socket
from typing import Final

from drivers import serial_port
from drivers.codec import Port
from station.profile import MavlinkDevice
from station.rows import DeviceError

LOOPBACK: Final = "127.0.0.1"
_CONNECT_TIMEOUT_S: Final = 1.0
_BIGGEST_DATAGRAM: Final = 65_535
_SCHEMES: Final = ("udpin", "udp", "udpout", "tcp")
_HINTS: Final = {
    errno.EADDRINUSE: ": another program listens there; close that or use another port",
    errno.EADDRNOTAVAIL: ": this machine has no such address",
    errno.ECONNREFUSED: ": nobody listens there; is the sender running?",
}


class UdpPort:
    """Datagrams, one a read. Without a `peer` it listens, and writes to the last sender; before one, nowhere."""

    def __init__(self, here: socket.socket, peer: tuple[str, int] | None) -> None:
        self._socket = here
        self._peer = peer

    def read(self, timeout_s: float) -> bytes:
        ready, _, _ = select.select([self._socket], [], [], timeout_s)
        if not ready:
            return b""
        data, sender = self._socket.recvfrom(_BIGGEST_DATAGRAM)
        self._peer = sender
        return data

    def write(self, data: bytes) -> None:
        if self._peer is not None:
            self._socket.sendto(data, self._peer)

    def close(self) -> None:
        self._socket.close()


class TcpPort:
    """A connection to a server."""

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection

    def read(self, timeout_s: float) -> bytes:
        ready, _, _ = select.select([self._socket], [], [], timeout_s)
        if not ready:
            return b""
        data = self._socket.recv(_BIGGEST_DATAGRAM)
        if not data:
            raise ConnectionResetError("the other side closed the connection")
        return data

    def write(self, data: bytes) -> None:
        self._socket.sendall(data)

    def close(self) -> None:
        self._socket.close()


def open_port(device: MavlinkDevice, url: str) -> Port:
    """The link at `url`, open. Raises DeviceError saying why not and how to mend it."""
    scheme, _, rest = url.partition(":")
    if scheme not in _SCHEMES:
        if ":" in url and not url.startswith(("/", "COM")):
            raise DeviceError(
                f"{device.name}: cannot open {url}: write one of {', '.join(_SCHEMES)}:HOST:PORT or a path"
            )
        return serial_port.open_port(url, device.baud)
    if scheme == "udpout" and not device.timesync:
        raise DeviceError(
            f"{device.name}: {url}: nothing would come, as the rig allows nothing to be sent\n"
            "use udpin, or allow timesync"
        )
    address = _address(device, url, rest)
    try:
        if scheme == "tcp":
            connection = socket.create_connection(address, _CONNECT_TIMEOUT_S)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return TcpPort(connection)
        here = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            if scheme == "udpout":
                here.bind((LOOPBACK if _is_loopback(address[0]) else "", 0))
                return UdpPort(here, address)
            here.bind(address)
        except OSError:
            here.close()
            raise
        return UdpPort(here, None)
    except OSError as error:
        hint = _HINTS.get(error.errno or 0, "")
        raise DeviceError(f"{device.name}: cannot open {url}: {error.strerror or error}{hint}") from error


def _is_loopback(host: str) -> bool:
    return host == "localhost" or host.startswith("127.")


def _address(device: MavlinkDevice, url: str, rest: str) -> tuple[str, int]:
    host, _, port = rest.removeprefix("//").rpartition(":")
    if not port.isdecimal() or not 0 < int(port) < 65_536:
        raise DeviceError(f"{device.name}: cannot open {url}: the port must be a number from 1 to 65535")
    return host or LOOPBACK, int(port)
