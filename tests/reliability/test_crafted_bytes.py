"""Bytes made to keep a reader busy are read in linear time, and what is sound behind them is read too.

Not time but lines of Python are counted: those that a reader runs for each byte.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

import pytest
from pymavlink.dialects.v20.ardupilotmega import MAVLink, MAVLink_heartbeat_message

from drivers.mavlink import MavlinkEncoder
from drivers.mavlink_frame import Framer
from drivers.serial_gnss import UbxCodec, encode_nav_pvt
from drivers.shedding import NOISE_BYTES_S, OTHER_BYTES_S
from station.flight.bus import Bus
from station.rows import Code, Event, RawBlock
from tests.reliability.crafted import KINDS, MAVLINK, UBX, cost
from tests.reliability.mutated_links import links

PIECE = 200
LINES_A_BYTE = 25
"""Ten statements for each start, of two bytes at least, and again for one that was not all there."""


def lines_run(work: Callable[[], None]) -> int:
    count = 0

    def tracer(_frame: FrameType, event: str, _: Any) -> Any:
        nonlocal count
        count += event == "line"
        return tracer

    before = sys.gettrace()
    sys.settrace(tracer)
    try:
        work()
    finally:
        sys.settrace(before)
    return count


def cut(data: bytes) -> list[bytes]:
    return [data[n : n + PIECE] for n in range(0, len(data), PIECE)]


@pytest.mark.parametrize("kind", UBX)
def test_ubx_starts_that_are_none_cost_each_byte_the_same(kind: str) -> None:
    data = UBX[kind] * (20_000 // len(UBX[kind]))
    codec = UbxCodec()
    assert lines_run(lambda: [codec.feed(piece) for piece in cut(data)] and None) < LINES_A_BYTE * len(data)
    found = [
        r for piece in cut(encode_nav_pvt(10**9, 50.0, 10.0, 1e5, (1e3, 0.0, 0.0)) * 60) for r in codec.feed(piece)
    ]
    assert len(found) >= 10  # a false start may hide 4 kB
    assert codec.bad + codec.resyncs > 0


@pytest.mark.parametrize("kind", MAVLINK)
def test_mavlink_starts_that_are_none_cost_each_byte_the_same(kind: str) -> None:
    data = MAVLINK[kind] * (20_000 // len(MAVLINK[kind]))
    framer = Framer()
    assert lines_run(lambda: [framer.feed(piece) for piece in cut(data)] and None) < LINES_A_BYTE * len(data)
    vehicle = MavlinkEncoder()
    assert sum(len(framer.feed(vehicle.heartbeat())) for _ in range(30)) >= 15  # a false start may hide 280 bytes


def test_a_packet_that_begins_in_a_false_starts_head_is_given_at_once() -> None:
    """Behind noise: the head of an ATTITUDE of version 1 (id 30, 28 bytes), whose id is the heartbeat's number."""
    sender = MAVLink(None, srcSystem=1, srcComponent=1)
    sender.seq = 30
    heartbeat = bytes(MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3).pack(sender, force_mavlink1=True))
    assert heartbeat[:3] == b"\xfe\x09\x1e"
    framer = Framer()
    (found,) = framer.feed(b"\xff" + b"\xfe\x1c\x00" + heartbeat)
    assert found.get_msgbuf() == heartbeat
    assert (framer.bad, framer.resyncs) == (1, 1)


def test_the_bus_is_bounded_while_nobody_drains_it() -> None:
    bus = Bus(capacity=100, raw_bytes=1000)
    for n in range(250):
        bus.put(Event(n, "test", Code.MARK))
    for n in range(250, 300):
        bus.put(RawBlock(n, "box", bytes(100)))
        assert len(bus._rows) <= 100
    rows = bus.drain()
    assert [r.t_ns for r in rows if isinstance(r, RawBlock)] == list(range(290, 300))
    lost = next(r for r in rows if isinstance(r, Event) and r.code is Code.DROPPED)
    assert lost.count == bus.dropped == 290
    bus.put(Event(400, "test", Code.MARK))
    assert len(bus.drain()) == 1


@pytest.mark.parametrize("name", KINDS)
def test_of_a_megabyte_a_second_no_more_is_read_than_a_link_may_cost(name: str) -> None:
    for kind in KINDS[name].values():
        _, kept, unaccounted = cost(links()[name].codec(), kind, seconds=2.0)
        assert 0.4 * NOISE_BYTES_S * 2 < kept < (OTHER_BYTES_S + 100 * 50) * 3.1
        assert unaccounted == 0
