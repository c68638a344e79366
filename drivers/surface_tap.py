"""Measured surfaces on their way from the thread that reads a device into the loop that flies on them.

A datagram a value: whoever reads the device is never held up, and what the loop does not take in time is lost.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable, Iterator

from station.conventions import SURFACES
from station.profile import Rig
from station.rows import Rows, Sample

_VALUE = struct.Struct("<qBd")


class SurfaceTap:
    """Made before processes are forked: one side puts, the other takes."""

    def __init__(self, rig: Rig) -> None:
        self._in, self._out = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._in.setblocking(False)
        self._out.setblocking(False)
        columns = {s.name: s.signals for s in rig.streams()}
        self._streams = {
            stream: tuple((columns[stream].index(name), SURFACES.index(name)) for name in names)
            for stream, names in rig.measured_surfaces.items()
        }

    def putting(self, put: Callable[[Rows], None]) -> Callable[[Rows], None]:
        """`put`, with what it is handed of measured surfaces going into the loop first."""

        def tapped(row: Rows) -> None:
            if isinstance(row, Sample):
                for column, number in self._streams.get(row.stream, ()):
                    try:
                        self._in.send(_VALUE.pack(row.t_ns, number, row.values[column]))
                    except OSError:  # the loop is gone, or far behind
                        break
            put(row)

        return tapped

    def fileno(self) -> int:
        return self._out.fileno()

    def take(self) -> Iterator[tuple[int, str, float]]:
        """What has come: arrival in station time, ns, surface and angle, rad."""
        while True:
            try:
                t_ns, number, value = _VALUE.unpack(self._out.recv(_VALUE.size))
            except BlockingIOError:
                return
            yield t_ns, SURFACES[number], value

    def close(self) -> None:
        self._in.close()
        self._out.close()
