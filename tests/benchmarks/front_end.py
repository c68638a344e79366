"""What the way from bytes to the recording costs: many boom boxes at once, each message decoded, aligned and recorded.

    uv run python tests/benchmarks/front_end.py [--streams 32] [--rate 1000] [--seconds 10] [--profile]

Time is simulated, work is not: the processor time of a second of flight is told, of one core. No estimator and no page.
In the machine's time, through pseudo-terminals: tests/reliability/live_links.py.
"""

from __future__ import annotations

import argparse
import cProfile
import math
import pstats
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from drivers.adapter import Adapter
from drivers.protocols import protocol_named
from drivers.serial_boombox import encode_packet
from station.clock import ManualClock
from station.conventions import SIGNALS, TICK_HZ, TICK_NS, Stream
from station.flight import loop
from station.flight.alignment import Aligner
from station.flight.bus import Bus
from station.log import About, WriterThread, summarise
from station.profile import Channel, SerialDevice, StreamProfile, load_aircraft
from station.rows import Tick

STREAMS_OF_A_BOX = 4
BLOCK_NS = 5_000_000
"""Bytes are taken each so often."""
NAMES = ("alpha_vane", "beta_vane", "elevator")


class Box:
    """A boom box of several streams, and what has come of it."""

    def __init__(self, number: int, streams: int, rate_hz: float, clock: ManualClock, bus: Bus) -> None:
        channels = {name: Channel(field=f"v{i}", unit="deg", slope=0.01) for i, name in enumerate(NAMES)}
        self.device = SerialDevice(
            name=f"box{number}", link="serial", protocol="boombox", port="none",
            streams=tuple(
                StreamProfile(name=f"s{i}", message=i, rate=f"{rate_hz} Hz", signals=channels) for i in range(streams)
            ),
        )  # fmt: skip
        self.adapter = Adapter(self.device, protocol_named("boombox").codec(), _no_port, clock, bus.put)
        self._rate, self._sent = rate_hz, 0

    def until(self, t_ns: int) -> bytes:
        """What it has sent since the last call."""
        count = int(t_ns * self._rate) // 10**9
        packets = [
            encode_packet(i, n, round(n * 1e6 / self._rate), [500 * math.sin(w * n / self._rate) for w in (3, 9, 6)])
            for n in range(self._sent, count)
            for i in range(len(self.device.streams))
        ]
        self._sent = count
        return b"".join(packets)


def _no_port() -> object:
    raise OSError("not opened here")


def streams_of(boxes: list[Box]) -> list[Stream]:
    return [
        Stream(f"{b.device.name}.{s.name}", tuple(s.signals), s.rate, 0.2, b.device.name)
        for b in boxes
        for s in b.device.streams
    ]


def fly(boxes: list[Box], blocks: list[list[bytes]], clock: ManualClock, bus: Bus, folder: Path) -> Path:
    """All of it through the station's front end."""
    streams = streams_of(boxes)
    writer = WriterThread(folder, About(load_aircraft("twin_otter"), tuple(streams)), clock, bus.put)
    aligner = Aligner(streams, {})

    def beats() -> Iterator[loop.Beat]:
        start = clock.now_ns()
        of_tick = TICK_NS // BLOCK_NS
        for k in range(len(blocks) // of_tick):
            for of_boxes in blocks[k * of_tick : (k + 1) * of_tick]:
                clock.advance_s(BLOCK_NS * 1e-9)
                for box, data in zip(boxes, of_boxes, strict=True):
                    box.adapter.take(data)
            yield loop.Beat(Tick(start + (k + 1) * TICK_NS, k, start + (k - 2) * TICK_NS), bus.drain())

    loop.run(beats(), aligner, lambda: loop.Chain(_Nothing()), writer)
    writer.close()
    return writer.path


class _Nothing:
    def step(self, _: object) -> tuple[None, tuple[()]]:
        raise ArithmeticError("no estimator here")

    def start_point(self) -> None: ...


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--streams", type=int, default=32)
    options.add_argument("--rate", type=float, default=1000.0)
    options.add_argument("--seconds", type=float, default=10.0)
    options.add_argument("--profile", action="store_true")
    chosen = options.parse_args()
    clock, bus = ManualClock(10**9), Bus()
    number = max(1, chosen.streams // STREAMS_OF_A_BOX)
    boxes = [Box(i, min(chosen.streams, STREAMS_OF_A_BOX), chosen.rate, clock, bus) for i in range(number)]
    steps = round(chosen.seconds * 1e9) // BLOCK_NS
    blocks = [[box.until(n * BLOCK_NS) for box in boxes] for n in range(1, steps + 1)]
    Aligner(streams_of(boxes), {}).begin()
    profiler = cProfile.Profile() if chosen.profile else None
    with tempfile.TemporaryDirectory() as folder:
        began = time.process_time()
        if profiler is not None:
            profiler.enable()
        path = fly(boxes, blocks, clock, bus, Path(folder))
        if profiler is not None:
            profiler.disable()
        took = time.process_time() - began
        summary = summarise(path)
        size = path.stat().st_size
    if profiler is not None:
        pstats.Stats(profiler).sort_stats("tottime").print_stats(22)
    samples = sum(s.samples for s in summary.streams)
    expected = round(chosen.streams * chosen.rate * chosen.seconds)
    print(
        f"{samples} of {expected} samples recorded, {summary.ticks_missed} of {chosen.seconds * TICK_HZ:g} ticks missed"
    )
    print(f"{took / chosen.seconds:.2f} of one core, {1e6 * took / max(samples, 1):.1f} us a sample")
    print(f"{size / 2**20 / chosen.seconds:.2f} MiB a second, {threading.active_count()} threads left")
    assert set(NAMES) <= set(SIGNALS)


if __name__ == "__main__":
    main()
