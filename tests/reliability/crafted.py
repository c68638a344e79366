"""Bytes made to keep a reader busy, and what they cost: false starts, messages within one another, empty lines."""

from __future__ import annotations

import random
import time
from typing import Final

from drivers.adapter import Adapter
from drivers.codec import Codec
from station.clock import ManualClock
from station.profile import SerialDevice, StreamProfile
from station.rows import Code, Event, RawBlock, Rows

UBX: Final = {
    "long frames within one another": b"\xb5\x62\x05\x05\xff\x0f",
    "NAV-PVT within one another": b"\xb5\x62\x01\x07\x5c\x00",
    "starts": b"\xb5\x62",
    "sentences that never end": b"$",
    "sentences within one another": b"$" * 127 + b"\n",
}
MAVLINK: Final = {
    "starts": b"\xfe",
    "starts of version 2": b"\xfd\x01",
    "short packets within one another": b"\xfe\x01",
    "heartbeats within one another": b"\xfe\x09\x00\x00\x01\x00",
    "long packets within one another": b"\xfd\xff\x00\x00\x00\x00\x00\x00\x00\x00",
}
_LINES: Final = {"empty lines": b"\n", "short lines": b"$\n", "starts of lines": b"$" * 200 + b"\n"}
_FRAMES: Final = {
    "empty lines": b"\r",
    "short frames": b"t1000\r",
    "frames": b"t10080000000000000000\r",
    "bells": b"\x07\r",
}
KINDS: Final = {
    "boombox": {"empty packets": b"\0", "short packets": b"\1\0", "packets": b"\x0b" + b"\1" * 10 + b"\0"},
    "boombox_ascii": _LINES,
    "nmea": _LINES,
    "ubx": UBX,
    "vectornav": {"starts": b"\xfa", "short packets": b"\xfa\x01\x01\x00", "long packets": b"\xfa\x04\xff\x01"},
    "can": _FRAMES,
    "dronecan": _FRAMES,
    "mavlink": MAVLINK,
    "mavlink signed": MAVLINK,
}
"""For each link of mutations.links()."""
RATE: Final = 1_000_000
PIECE: Final = 5_000
"""Bytes a second, and at a time: what 5 ms bring."""


def cost(codec: Codec, kind: bytes, seconds: float = 3.0) -> tuple[float, int, int]:
    """Share of a core that an adapter takes for it; bytes recorded, and bytes unaccounted for, of so many seconds."""
    device = SerialDevice(
        name="a", link="serial", protocol="boombox", port="none",
        streams=(StreamProfile(name="s", message=0, rate="50 Hz", signals={}),),
    )  # fmt: skip
    clock, rows = ManualClock(10**9), list[Rows]()
    adapter = Adapter(device, codec, _no_port, clock, rows.append)
    data = kind * (RATE // len(kind) + 1)
    steps, spent = round(seconds * RATE / PIECE), 0.0
    for n in range(steps):
        at = n * PIECE % (RATE - PIECE)
        clock.advance_s(PIECE / RATE)
        began = time.process_time()
        adapter.take(data[at : at + PIECE])
        spent += time.process_time() - began
    clock.advance_s(1.0)
    adapter.take(b"")
    kept = sum(len(row.data) for row in rows if isinstance(row, RawBlock))
    told = {code: sum(r.count for r in rows if isinstance(r, Event) and r.code is code) for code in Code}
    return spent / seconds, kept, steps * PIECE - kept - told[Code.NOISE] - told[Code.DROPPED] * PIECE


def noise(seed: int) -> bytes:
    """No pattern at all."""
    return random.Random(seed).randbytes(RATE)


def _no_port() -> object:
    raise OSError("not opened here")
