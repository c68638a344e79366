"""Counters that wrap, of every link that has one, through the adapter: the truth is how the messages were made."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from drivers.adapter import Adapter
from drivers.can_dbc import encode_frame
from drivers.can_frames import encode_slcan
from drivers.codec import Codec, Reading
from drivers.mavlink import MavlinkCodec, MavlinkEncoder
from drivers.serial_boombox import encode_line, encode_packet
from drivers.serial_gnss import encode_nav_pvt, encode_sentence
from station.clock import ManualClock
from station.profile import Channel, SerialDevice, StreamProfile
from station.rows import Rows, Sample
from tests.reliability.mutated_links import can_codec, links
from tests.reliability.speakers import device

S = 10**9
BOOT_NS = 2**32 * 1_000_000
"""Of a time in ms since the autopilot's start, 32 bits: 49.7 days (mavlink.io, common.xml, time_boot_ms)."""


class Wrapping(NamedTuple):
    """A link's codec and how a message of the n-th turn is said at a device time (ns); the period of its time."""

    codec: Callable[[], Codec]
    say: Callable[[int, int], bytes]
    period_ns: int
    counts: bool
    """Whether its messages have numbers of their own."""


def wrapping() -> dict[str, Wrapping]:
    codecs = {name: link.codec for name, link in links().items()}
    frame = next(m for m in can_codec().messages.values() if m.wrap_ns and m.seq_wrap)

    def on_can(n: int, t_ns: int) -> bytes:
        values = dict.fromkeys(frame.signals, 1.0)
        return encode_slcan(*encode_frame(frame, values, t_ns, n))

    def autopilot(n: int, t_ns: int) -> bytes:
        return vehicle.encode("ATTITUDE", {"pitch": 0.1}, t_ns % BOOT_NS)

    vehicle, us = MavlinkEncoder(), 2**32 * 1000
    return {
        "boombox, us": Wrapping(codecs["boombox"], lambda n, t: encode_packet(1, n, t // 1000, (7,)), us, True),
        "boombox lines, us": Wrapping(
            codecs["boombox_ascii"], lambda n, t: encode_line(1, n, t // 1000, (7,)), us, True
        ),
        "UBX, week": Wrapping(
            codecs["ubx"], lambda _, t: encode_nav_pvt(t, 50.0, 10.0, 1e5, (1.0, 2.0, 3.0)), 604_800 * S, False
        ),
        "NMEA, day": Wrapping(
            codecs["nmea"], lambda _, t: encode_sentence("RMC", t, lat=47.1, lon=8.2, spd=22.4), 86_400 * S, False
        ),
        "MAVLink, ms": Wrapping(lambda: MavlinkCodec(device()), autopilot, BOOT_NS, False),
        "CAN, 14 bits": Wrapping(codecs["can"], on_can, frame.wrap_ns, True),
    }  # fmt: skip


@dataclass(slots=True)
class Found:
    """Messages that came, how many wraps of the time they passed, how far a time was off, ns, and how many numbers."""

    messages: int = 0
    wraps: int = 0
    worst_ns: int = 0
    numbers: int = 0


def fly(one: Wrapping, turns: int, seed: int) -> Found:
    """Runs of messages at 50 Hz across the end of the period, and silences of up to three periods between them."""
    noise, found, codec = random.Random(seed), Found(), one.codec()
    heard = next(r for r in one.codec().feed(one.say(0, S) + one.say(1, 2 * S)) if isinstance(r, Reading))
    field = next(name for name, value in heard.fields.items() if math.isfinite(value))
    signals = {"alpha_vane": Channel(field=field, unit="deg")}
    stream = StreamProfile(name="s", message=heard.message, rate="50 Hz", signals=signals)
    box = SerialDevice(name="a", link="serial", protocol="boombox", port="none", streams=(stream,))
    clock, rows = ManualClock(10**15), list[Rows]()
    adapter = Adapter(box, codec, _no_port, clock, rows.append)
    at, n = one.period_ns - 200_000_000, 0
    first, before = None, 0
    for _ in range(turns):
        for k in range(20):
            rows.clear()
            adapter.take(one.say(n, at))
            for sample in (row for row in rows if isinstance(row, Sample) and row.t_device_ns is not None):
                found.messages += 1
                first = first or (at, sample.t_device_ns or 0)
                found.worst_ns = max(found.worst_ns, abs((sample.t_device_ns or 0) - first[1] - (at - first[0])))
                # After a silence the number is known but for whole rounds of its counter.
                found.numbers += one.counts and k > 0 and sample.seq != before + 1
                before = sample.seq or 0
            step = 20_000_000 if k < 19 else _to_the_end(at, one.period_ns, noise)
            clock.advance_s(step * 1e-9)
            found.wraps += (at + step) // one.period_ns - at // one.period_ns
            at, n = at + step, n + 1
    return found


def _to_the_end(at: int, period: int, noise: random.Random) -> int:
    """To shortly before a period ends, this one or one of the next three; whole milliseconds."""
    left = period * (at // period + noise.randrange(1, 4)) - noise.randrange(20, 380) * 1_000_000 - at
    return left if left > 0 else left + period


def _no_port() -> object:
    raise OSError("not opened here")
