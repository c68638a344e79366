"""A link that brings too much: what is passed over is bounded, counted and told, and other links do not notice."""

from __future__ import annotations

import random
import socket
from typing import Any

import pytest

from drivers.adapter import Adapter
from drivers.codec import Codec
from drivers.mavlink import MavlinkCodec, MavlinkEncoder
from drivers.mavlink_port import FOREIGN_S, REOPEN_NS, open_port
from drivers.serial_boombox import BoomboxCodec, encode_packet
from drivers.shedding import NOISE_BYTES_S, OTHER_BYTES_S, Allowance
from station.clock import ManualClock
from station.profile import MavlinkDevice, SerialDevice, load_rig
from station.rows import Code, Event, RawBlock, Rows, Sample

SIGNALS = {"alpha_vane": {"field": "v0", "unit": "deg", "slope": 0.005}}
BOOM = SerialDevice.model_validate({
    "name": "boom", "link": "serial", "protocol": "boombox", "port": "nowhere",
    "streams": [{"name": "vanes", "message": 1, "rate": "200 Hz", "signals": SIGNALS}],
})  # fmt: skip


def played(codec: Codec, blocks: list[bytes], every_s: float) -> tuple[Adapter, list[Rows]]:
    clock, rows = ManualClock(10**9), list[Rows]()
    adapter = Adapter(BOOM, codec, lambda: pytest.fail("not opened here"), clock, rows.append)
    for block in blocks:
        clock.advance_s(every_s)
        adapter.take(block)
    clock.advance_s(2.0)
    adapter.take(b"")
    return adapter, rows


def told(rows: list[Rows], code: Code) -> int:
    return sum(row.count for row in rows if isinstance(row, Event) and row.code is code)


def size(rows: list[Rows]) -> int:
    return sum(len(row.data) for row in rows if isinstance(row, RawBlock))


def test_an_allowance_by_hand() -> None:
    """100 a second: 100 at once, then none before 50 are back."""
    allowance = Allowance(100.0)
    assert not allowance.is_spent(0)
    allowance.spend(101)
    assert allowance.is_spent(0)
    assert allowance.is_spent(500_000_000)  # 49 are back
    assert not allowance.is_spent(520_000_000)
    allowance.spend(52)
    assert allowance.is_spent(520_000_000)
    assert not allowance.is_spent(10**10)
    allowance.spend(100)  # not more than 100 were back
    assert not allowance.is_spent(10**10)


def test_noise_is_recorded_up_to_a_rate_and_the_rest_is_counted() -> None:
    """A megabyte a second for ten seconds; then the link is in order again."""
    noise = [random.Random(n).randbytes(5000) for n in range(2000)]
    packets = [encode_packet(1, k, 5000 * k, (k,)) for k in range(400)]
    adapter, rows = played(BoomboxCodec(), [*noise, *packets], every_s=0.005)
    kept = size(rows)
    assert 0.5 * NOISE_BYTES_S * 10 < kept < 1.1 * NOISE_BYTES_S * 11 + len(b"".join(packets))
    assert kept + told(rows, Code.NOISE) == len(b"".join([*noise, *packets]))
    assert adapter.blocks_lost == told(rows, Code.DROPPED) == 0
    samples = [row for row in rows if isinstance(row, Sample)]
    assert len(samples) >= 400 - 0.5 / 0.005 - 1  # half a second's noise is forgiven in half a second


def test_all_that_a_broken_cable_of_921600_baud_brings_is_looked_at() -> None:
    noise = [random.Random(n).randbytes(460) for n in range(2000)]
    _, rows = played(BoomboxCodec(), noise, every_s=0.005)
    assert size(rows) == len(b"".join(noise))
    assert told(rows, Code.NOISE) == 0


def test_sound_messages_beyond_what_the_rig_can_mean_are_counted_as_lost() -> None:
    """Packet 9, which the rig does not name, at two megabytes a second."""
    packet = encode_packet(9, 0, 0, (1,))
    blocks = [packet * 600] * 1000
    adapter, rows = played(BoomboxCodec(), blocks, every_s=0.005)
    limit = OTHER_BYTES_S + 100 * 200
    assert 0.5 * limit * 5 < size(rows) < limit * 6 + len(blocks[0])
    assert adapter.blocks_lost == told(rows, Code.DROPPED) == 1000 - sum(isinstance(row, RawBlock) for row in rows) > 0
    assert told(rows, Code.NOISE) == 0


class Port:
    """A UDP port of a vehicle, and the vehicle's own socket."""

    def __init__(self) -> None:
        device = load_rig("mavlink_only").devices[0]
        assert isinstance(device, MavlinkDevice)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self.at = probe.getsockname()
        self.codec, self.clock = MavlinkCodec(device), ManualClock(10**12)
        self.port: Any = open_port(device, f"udpin:127.0.0.1:{self.at[1]}", self.codec, self.clock)
        self.vehicle, self.other = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))

    def close(self) -> None:
        for one in (self.port, self.vehicle, self.other):
            one.close()


def test_a_flood_of_datagrams_is_left_to_the_system_and_the_vehicle_is_still_heard() -> None:
    there, vehicle = Port(), MavlinkEncoder()
    try:
        there.vehicle.sendto(vehicle.heartbeat(), there.at)
        assert there.port.read(1.0)
        for _ in range(FOREIGN_S):
            there.other.sendto(b"x", there.at)
            assert there.port.read(1.0) == b""
        assert any("flood" in who for who in there.codec.foreign)
        for _ in range(50):  # none of these comes in any more
            there.other.sendto(b"x", there.at)
        there.vehicle.sendto(b"still here", there.at)
        assert there.port.read(1.0) == b"still here"
        there.port.write(b"back")
        assert there.vehicle.recv(100) == b"back"
        there.clock.advance_s(REOPEN_NS * 1e-9 + 1)
        with pytest.raises(ConnectionResetError, match="opening it anew"):
            there.port.read(0.0)
    finally:
        there.close()


def test_looking_for_the_first_heartbeat_takes_a_fifth_of_the_time() -> None:
    """A millisecond for each datagram of somebody else, then a rest of four."""
    there = Port()

    class Slow:
        def vouches_for(self, datagram: bytes) -> bool:
            there.clock.advance_s(0.001)
            return there.codec.vouches_for(datagram)

        def pass_over(self, _: str) -> None: ...

    there.port._gate = Slow()
    try:
        began = there.clock.now_ns()
        for _ in range(10):
            there.other.sendto(b"\xfe\x09\x00\x00\x01\x00" * 200, there.at)
            assert there.port.read(1.0) == b""
        assert there.clock.now_ns() - began == 10 * 5_000_000
        heartbeat = MavlinkEncoder().heartbeat()
        there.vehicle.sendto(heartbeat, there.at)
        assert there.port.read(1.0) == heartbeat
    finally:
        there.close()
