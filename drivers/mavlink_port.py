"""Where MAVLink comes from, as a Port: UDP, TCP or a serial port.

    udpin:HOST:PORT    listen (also udp:); only to the address of the vehicle's first heartbeat, where what is sent goes
    udpout:HOST:PORT   send first and hear what comes back; needs something to send
    tcp:HOST:PORT      connect to a server
    PATH, usb:SERIAL   a serial port

An empty HOST (udpin::14550 or udpin:14550) is the loopback, so is anything not named.
"""

from __future__ import annotations

import errno
import select
import socket
from typing import Final, Protocol

from drivers import serial_port
from drivers.codec import Port
from drivers.mavlink_frame import SILENT_NS
from station.clock import Clock
from station.profile import MavlinkDevice
from station.rows import DeviceError

LOOPBACK: Final = "127.0.0.1"
_CONNECT_TIMEOUT_S: Final = 1.0
_SECOND_NS: Final = 1_000_000_000
_BIGGEST_DATAGRAM: Final = 65_535
FOREIGN_S: Final = 200
"""Datagrams of others in a second that are looked at; a vehicle and a ground station send fewer to each other."""
REST: Final = 4
"""Times as long as a datagram was looked at for a heartbeat the port rests: that takes a fifth of a core at most."""
REOPEN_NS: Final = 2 * SILENT_NS
_KEEPALIVE: Final = {"TCP_KEEPIDLE": 5, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 3}
"""A peer that has gone without a word is noticed after 11 s, though the station sends nothing."""
_SCHEMES: Final = ("udpin", "udp", "udpout", "tcp")
_HINTS: Final = {
    errno.EADDRINUSE: ": another program listens there; close that or use another port",
    errno.EADDRNOTAVAIL: ": this machine has no such address",
    errno.ECONNREFUSED: ": nobody listens there; is the sender running?",
}


class Gate(Protocol):
    """Who knows the vehicle by what it says."""

    def vouches_for(self, datagram: bytes) -> bool:
        """Whether a heartbeat of the vehicle is in it, signed where the rig has a key."""
        ...

    def pass_over(self, who: str) -> None:
        """Count a datagram of somebody else."""
        ...


class UdpPort:
    """Datagrams of one peer, one a read; those of others are passed over.

    A port that calls has its peer from the rig. One that listens takes the first for whose datagram `gate` vouches, and
    another only when that has been silent for SILENT_NS: an autopilot behind a router may come back from a new port.
    Until then nothing is read and nothing written. A flood of others' is left to the system once there is a peer, which
    then passes on the peer's alone until the port is opened anew, REOPEN_NS after the peer's last.
    """

    def __init__(self, here: socket.socket, peer: tuple[str, int] | None, gate: Gate, clock: Clock) -> None:
        self._socket = here
        self._peer = peer
        self._is_calling = peer is not None
        self._gate, self._clock = gate, clock
        self._heard_ns = self._opened_ns = self._second_ns = clock.now_ns()
        self._others = 0
        """Datagrams of others in this second."""
        self._is_fixed = False
        """Whether the system lets the peer's datagrams alone through."""

    def read(self, timeout_s: float) -> bytes:
        ready, _, _ = select.select([self._socket], [], [], timeout_s)
        now = self._clock.now_ns()
        if self._is_fixed and now - self._heard_ns > REOPEN_NS:
            raise ConnectionResetError("others flooded the port and the vehicle has gone; opening it anew")
        if not ready:
            return b""
        try:
            data, sender = self._socket.recvfrom(_BIGGEST_DATAGRAM)
        except ConnectionRefusedError:  # of what was written to a peer that has gone
            return b""
        if sender != self._peer and not self._takes(sender, data, now):
            self._hold_off(now)
            return b""
        self._heard_ns = now
        return data

    def _takes(self, sender: tuple[str, int], data: bytes, now: int) -> bool:
        if self._is_free(now) and self._gate.vouches_for(data):
            self._peer = sender
            return True
        # Before the vehicle's first heartbeat, which comes once a second, its own datagrams are nobody's either.
        if self._peer is not None:
            self._gate.pass_over(f"{_words(sender)}, as the vehicle is at {_words(self._peer)}")
        elif now - self._opened_ns > SILENT_NS:
            self._gate.pass_over(f"{_words(sender)}, as no heartbeat of the vehicle comes from there")
        return False

    def _is_free(self, now: int) -> bool:
        """Whether a vehicle may speak up from anywhere."""
        return not self._is_calling and (self._peer is None or now - self._heard_ns > SILENT_NS)

    def _hold_off(self, now: int) -> None:
        """Too many datagrams of others are kept out by the system or, before there is a peer, mostly lost."""
        if self._is_free(now):
            looked_ns = self._clock.now_ns()
            self._clock.sleep_until_ns(looked_ns + REST * (looked_ns - now))
            return
        if now - self._second_ns > _SECOND_NS:
            self._second_ns, self._others = now, 0
        self._others += 1
        if self._others >= FOREIGN_S and not self._is_fixed and self._peer is not None:
            self._socket.connect(self._peer)
            self._is_fixed = True
            self._gate.pass_over("a flood of datagrams, which the system keeps out from now on")

    def write(self, data: bytes) -> None:
        if self._peer is not None:
            self._socket.sendto(data, self._peer)

    def close(self) -> None:
        self._socket.close()


class TcpPort:
    """A connection to a server. One on which nothing comes for REOPEN_NS is given up, to be opened anew."""

    def __init__(self, connection: socket.socket, clock: Clock) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in _KEEPALIVE.items():
            if hasattr(socket, option):
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
        self._socket = connection
        self._clock = clock
        self._heard_ns = clock.now_ns()

    def read(self, timeout_s: float) -> bytes:
        ready, _, _ = select.select([self._socket], [], [], timeout_s)
        now = self._clock.now_ns()
        if not ready:
            if now - self._heard_ns > REOPEN_NS:
                raise ConnectionResetError(f"nothing has come for {REOPEN_NS // 10**9} s; opening it anew")
            return b""
        self._heard_ns = now
        data = self._socket.recv(_BIGGEST_DATAGRAM)
        if not data:
            raise ConnectionResetError("the other side closed the connection")
        return data

    def write(self, data: bytes) -> None:
        self._socket.sendall(data)

    def close(self) -> None:
        self._socket.close()


def open_port(device: MavlinkDevice, url: str, gate: Gate, clock: Clock) -> Port:
    """The link at `url`, open, `gate` knowing whose it is. Raises DeviceError saying why not and how to mend it."""
    scheme, _, rest = url.partition(":")
    if scheme not in _SCHEMES:
        if ":" in url and not url.startswith(("/", "COM", serial_port.USB)):
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
            return TcpPort(socket.create_connection(address, _CONNECT_TIMEOUT_S), clock)
        here = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            if scheme == "udpout":
                here.bind((LOOPBACK if _is_loopback(address[0]) else "", 0))
                return UdpPort(here, (socket.gethostbyname(address[0]), address[1]), gate, clock)
            here.bind(address)
        except OSError:
            here.close()
            raise
        return UdpPort(here, None, gate, clock)
    except OSError as error:
        hint = _HINTS.get(error.errno or 0, "")
        raise DeviceError(f"{device.name}: cannot open {url}: {error.strerror or error}{hint}") from error


def _words(address: tuple[str, int]) -> str:
    return f"{address[0]}:{address[1]}"


def _is_loopback(host: str) -> bool:
    return host == "localhost" or host.startswith("127.")


def _address(device: MavlinkDevice, url: str, rest: str) -> tuple[str, int]:
    host, _, port = rest.removeprefix("//").rpartition(":")
    if not port.isdecimal() or not 0 < int(port) < 65_536:
        raise DeviceError(f"{device.name}: cannot open {url}: the port must be a number from 1 to 65535")
    return host or LOOPBACK, int(port)
