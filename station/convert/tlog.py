"""The raw MAVLink of a recording as a telemetry log: packets behind their times of arrival, as QGroundControl, MAVProxy
and MAVExplorer keep and read them.

Format: for each packet 8 bytes of microseconds since 1970, big-endian, then the packet as it came (pymavlink's
mavlogfile).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from pathlib import Path

from station.convert.groups import Told
from station.log import metadata, read_rows
from station.profile import MavlinkDevice
from station.rows import LogError, RawBlock

Splitter = Callable[[bytes], Iterable[bytes]]
"""Whole packets out of bytes that may begin and end within one."""


def write_tlog(path: Path, out: Path, splitter: Callable[[], Splitter] | None, told: Told = lambda _: None) -> int:
    """Write what MAVLink devices sent, all in one in the order of arrival, into a new file; returns the packets.
    `splitter` makes one for each device. Raises LogError and OSError."""
    info = metadata(path)
    rig = info.about.rig
    assert splitter is not None
    ours = {d.name: splitter() for d in (rig.devices if rig else ()) if isinstance(d, MavlinkDevice)}
    if not ours:
        raise LogError(f"{path}: has no raw MAVLink: no device of its rig speaks it")
    offset_ns = info.utc_ns - info.station_ns
    count = 0
    with out.open("xb") as file:
        for row in read_rows(path, (RawBlock,)):
            if isinstance(row, RawBlock) and row.device in ours:
                told(row.t_ns)
                stamp = struct.pack(">Q", max(row.t_ns + offset_ns, 0) // 1000)
                for packet in ours[row.device](row.data):
                    file.write(stamp + packet)
                    count += 1
    if not count:
        raise LogError(f"{path}: has no raw MAVLink: only a recording by station run keeps what devices sent")
    return count
