"""The far end of a link, where an emulated device writes: pseudo-terminals, UDP and TCP on loopback.

Nothing blocks: what the other side does not take is lost, as on a real line. Unplugging takes the link away as the
system would; plugging in again brings it back under the same endpoint.
"""

from __future__ import annotations

import os
import socket
import tty
from collections.abc import Sequence
from itertools import accumulate
from pathlib import Path
from typing import Protocol


class DevicePort(Protocol):
    """A link's far end. `endpoint` is what the station opens."""

    endpoint: str

    def plug(self) -> None: ...

    def unplug(self) -> None:
        """Take the link away; does nothing if it is away already."""
        ...

    def send(self, messages: Sequence[bytes]) -> None: ...

    def descriptors(self) -> list[int]:
        """What to wait on for bytes from the station."""
        ...

    def receive(self, descriptor: int) -> bytes:
        """What the station sent; empty if it was nothing to answer."""
        ...

    def close(self) -> None:
        """Leave nothing behind."""
        ...


class PtyPort:
    """A serial line: the slave of a pseudo-terminal, behind a symbolic link that outlives an unplug."""

    def __init__(self, link: Path) -> None:
        self.endpoint = str(link)
        self._link = link
        self._master = -1
        self._slave = -1
        self._rest = b""

    def plug(self) -> None:
        self.unplug()
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._rest = b""
        self._link.symlink_to(os.ttyname(self._slave))

    def unplug(self) -> None:
        if self._master < 0:
            return
        self._link.unlink(missing_ok=True)
        # Our own hold on the slave keeps it alive between readers; the master's end hangs up on them.
        os.close(self._slave)
        os.close(self._master)
        self._master = self._slave = -1

    def send(self, messages: Sequence[bytes]) -> None:
        if self._master < 0:
            return
        data = self._rest + b"".join(messages)
        try:
            taken = os.write(self._master, data)
        except BlockingIOError:
            taken = 0
        # Half a message is finished before the next begins; whole messages that nobody takes are dropped: kept, they
        # would come seconds late, as if the device's clock had jumped.
        ends = accumulate(map(len, messages), initial=len(self._rest))
        self._rest = data[taken : next((end for end in ends if end >= taken), taken)]

    def descriptors(self) -> list[int]:
        return [self._master] if self._master >= 0 else []

    def receive(self, descriptor: int) -> bytes:
        try:
            return os.read(descriptor, 4096)
        except OSError:
            return b""

    def close(self) -> None:
        self.unplug()


class UdpPort:
    """Datagrams to a port on loopback that was free a moment ago, where the station is to listen."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self._to = probe.getsockname()
        self.endpoint = f"udpin:127.0.0.1:{self._to[1]}"
        self._plugged = False

    def plug(self) -> None:
        self._plugged = True

    def unplug(self) -> None:
        self._plugged = False

    def send(self, messages: Sequence[bytes]) -> None:
        if not self._plugged:
            return
        for data in messages:
            try:
                self._socket.sendto(data, self._to)
            except OSError:
                return

    def descriptors(self) -> list[int]:
        return [self._socket.fileno()]

    def receive(self, descriptor: int) -> bytes:  # noqa: ARG002 - there is only one
        try:
            data = self._socket.recv(2048)
        except OSError:
            return b""
        return data if self._plugged else b""

    def close(self) -> None:
        self._socket.close()


class TcpPort:
    """A server on loopback; every client gets every message. Unplugged, it hangs up and refuses."""

    def __init__(self) -> None:
        self._listener: socket.socket | None = None
        self._clients: dict[int, socket.socket] = {}
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self._at = probe.getsockname()
        self.endpoint = f"tcp:127.0.0.1:{self._at[1]}"

    def plug(self) -> None:
        if self._listener is None:
            self._listener = socket.create_server(self._at)
            self._listener.setblocking(False)

    def unplug(self) -> None:
        for client in self._clients.values():
            client.close()
        self._clients.clear()
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def send(self, messages: Sequence[bytes]) -> None:
        data = b"".join(messages)
        for number, client in list(self._clients.items()):
            try:
                taken = client.send(data)
            except BlockingIOError:
                continue
            except OSError:
                taken = -1
            if taken < len(data):
                # A client this far behind would get half a message: it has to come again.
                self._hang_up(number)

    def descriptors(self) -> list[int]:
        listening = [self._listener.fileno()] if self._listener is not None else []
        return [*listening, *self._clients]

    def receive(self, descriptor: int) -> bytes:
        if self._listener is not None and descriptor == self._listener.fileno():
            try:
                client, _ = self._listener.accept()
            except OSError:
                return b""
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._clients[client.fileno()] = client
            return b""
        try:
            data = self._clients[descriptor].recv(4096)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._hang_up(descriptor)
        return data

    def close(self) -> None:
        self.unplug()

    def _hang_up(self, descriptor: int) -> None:
        self._clients.pop(descriptor).close()
