"""An emulated CAN adapter: the Lawicel (slcan) protocol on pseudo-terminals, one bus behind them all.

Each terminal is an adapter of its own on the bus: what one sends, the others receive. Left out: acceptance filters,
CAN FD, arbitration and the bus's rate, time stamps (`Z0` is acknowledged, `Z1` refused), polling mode, error flags
(`F` always reads none).

Source: Lawicel AB, CANUSB manual, commands and replies.
"""

from __future__ import annotations

import os
import re
import termios
import tty
from collections.abc import Sequence
from pathlib import Path
from typing import Final

_OK: Final = b"\r"
_REFUSED: Final = b"\a"
_FRAME: Final = re.compile(rb"(?:[tr][0-7][0-9A-Fa-f]{2}|[TR][01][0-9A-Fa-f]{7})[0-8](?:[0-9A-Fa-f]{2})*")
_BITRATE: Final = re.compile(rb"S[0-9]|s[0-9A-Fa-f]{4}")
_LONGEST_COMMAND: Final = 32
_MOST_PENDING: Final = 16_384
"""Bytes kept for a client that does not read, beyond what the terminal itself holds."""


class SlcanAdapter:
    """The bus and its adapters, each behind a symbolic link that keeps its path through an unplug.

    Nothing blocks and there is no thread: call `receive` when a descriptor is readable, so that commands are answered.
    Frames go to the adapters whose channel is open; to one whose client does not read, whole frames are lost and
    counted in `dropped`, never parts of a line. The first link is the `endpoint`.
    """

    def __init__(self, *links: Path) -> None:
        self.endpoint = str(links[0])
        self._links = links
        self._ports: dict[int, _Terminal] = {}
        self._dropped = 0

    @property
    def dropped(self) -> int:
        """Messages lost for want of a reader."""
        return self._dropped + sum(port.dropped for port in self._ports.values())

    def plug(self) -> None:
        """Make the adapters appear, their channels closed."""
        self.unplug()
        for link in self._links:
            port = _Terminal(link)
            self._ports[port.master] = port

    def unplug(self) -> None:
        """Take the adapters away under their clients' hands; does nothing if they are away."""
        self._dropped = self.dropped
        for port in self._ports.values():
            port.close()
        self._ports.clear()

    def send(self, messages: Sequence[bytes]) -> None:
        """Lines (or garbage) to every adapter whose channel is open, as they are."""
        for port in self._ports.values():
            if port.is_open:
                for data in messages:
                    port.write(data)

    def descriptors(self) -> list[int]:
        """What to wait on for commands."""
        return list(self._ports)

    def receive(self, descriptor: int) -> bytes:
        """Carry out the commands that have come. Always empty: the adapter answers them itself."""
        port = self._ports[descriptor]
        for command in port.commands():
            line = port.carry_out(command)
            if line:
                for other in self._ports.values():
                    if other is not port and other.is_open:
                        other.write(line)
        return b""

    def close(self) -> None:
        self.unplug()


class _Terminal:
    """One adapter: its pseudo-terminal, its channel's state, and what its client has not taken yet."""

    def __init__(self, link: Path) -> None:
        # Our own hold on the slave keeps the terminal alive between clients.
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)
        # The link goes with the terminal: the system gives the terminal's number to whoever opens the next one.
        link.unlink(missing_ok=True)
        link.symlink_to(os.ttyname(self._slave))
        self._link = link
        self.is_open = False
        self.dropped = 0
        self._may_send = False
        self._command = b""
        self._pending = b""

    def close(self) -> None:
        self._link.unlink(missing_ok=True)
        os.close(self._slave)
        os.close(self.master)

    def write(self, data: bytes) -> None:
        """All of it, now or after what is still pending; none of it if the client is too far behind."""
        if len(self._pending) + len(data) > _MOST_PENDING:
            self.dropped += 1
            data = b""
        self._pending += data
        try:
            self._pending = self._pending[os.write(self.master, self._pending) :]
        except BlockingIOError:
            return

    def commands(self) -> list[bytes]:
        """Those completed by what has come, without their ends."""
        try:
            data = os.read(self.master, 4096)
        except OSError:
            return []
        *whole, rest = (self._command + data).replace(b"\n", b"").split(b"\r")
        self._command = rest[-_LONGEST_COMMAND:]
        return whole

    def carry_out(self, command: bytes) -> bytes:
        """Do and answer it. Returns the line to pass on if it sends a frame, otherwise nothing."""
        kind, rest = command[:1], command[1:]
        answer = _REFUSED
        line = b""
        if kind in b"tTrR" and kind:
            if self.is_open and self._may_send and _is_frame(command):
                line = command + b"\r"
                answer = (b"z" if kind in b"tr" else b"Z") + _OK
        elif kind == b"":  # an empty line clears a client's half-written command
            answer = _OK
        elif kind in b"OL" and not rest:
            if not self.is_open:
                self.is_open, self._may_send, answer = True, kind == b"O", _OK
        elif kind == b"C" and not rest:
            if self.is_open:
                self.is_open, answer = False, _OK
            # Frames that nobody has read are those of the last client.
            self._pending = b""
            termios.tcflush(self._slave, termios.TCIFLUSH)
        elif _BITRATE.fullmatch(command):
            answer = _REFUSED if self.is_open else _OK
        elif command == b"V":
            answer = b"V1013" + _OK
        elif command == b"N":
            answer = b"NEMUL" + _OK
        elif command == b"F" and self.is_open:
            answer = b"F00" + _OK
        elif command == b"Z0" and not self.is_open:
            answer = _OK
        self.write(answer)
        return line


def _is_frame(command: bytes) -> bool:
    if _FRAME.fullmatch(command) is None:
        return False
    head = 4 if command[:1] in b"tr" else 9
    carried = 0 if command[:1] in b"rR" else 2 * int(command[head : head + 1])
    return len(command) == head + 1 + carried
