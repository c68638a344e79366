"""What the way from bytes to the recording costs: many boom boxes at once, each message decoded, aligned and recorded.

    uv run python tests/benchmarks/front_end.py [--streams 32] [--links 8] [--rate 1000] [--seconds 10] [--profile]
    nice -n -15 uv run python tests/benchmarks/front_end.py --live

Processor time of a second of flight is told, of one core. Time is simulated, work is not. With `--live` time is the
machine's: another process sends each message at its time through pseudo-terminals, threads read them, ticks come every
20 ms and may be missed. No estimator and no page.
"""

from __future__ import annotations

import argparse
import cProfile
import gc
import math
import os
import pstats
import sys
import tempfile
import threading
import time
import tty
from collections.abc import Callable, Iterator
from multiprocessing import Process
from pathlib import Path

from drivers import serial_port
from drivers.adapter import Adapter
from drivers.gathering import Gathering
from drivers.protocols import protocol_named
from drivers.serial_boombox import encode_packet
from station.clock import Clock, ManualClock, SystemClock
from station.conventions import SIGNALS, TICK_HZ, TICK_NS, Stream
from station.flight import loop
from station.flight.alignment import Aligner
from station.flight.bus import Bus
from station.log import About, WriterThread, summarise
from station.profile import Channel, SerialDevice, StreamProfile, load_aircraft
from station.rows import Tick

BLOCK_NS = 5_000_000
"""Bytes are taken each so often where time is simulated."""
LAG_S = 0.06
SETTLE_S = 3.0
"""The loop goes on for so long more than messages are sent, the first 2 s after the sender has begun."""
NAMES = ("alpha_vane", "beta_vane", "elevator")


class Box:
    """A boom box of several streams, and what has come of it."""

    def __init__(
        self,
        number: int,
        streams: int,
        rate_hz: float,
        bus: Bus,
        gathering: Gathering,
        clock: Clock,
        port: str = "none",
    ) -> None:
        channels = {name: Channel(field=f"v{i}", unit="deg", slope=0.01) for i, name in enumerate(NAMES)}
        self.device = SerialDevice(
            name=f"box{number}", link="serial", protocol="boombox", port=port,
            streams=tuple(
                StreamProfile(name=f"s{i}", message=i, rate=f"{rate_hz} Hz", signals=channels) for i in range(streams)
            ),
        )  # fmt: skip
        codec = protocol_named("boombox").codec()
        self.adapter = Adapter(
            self.device, codec, lambda: serial_port.open_port(port, 921_600), clock, bus.put, port, gathering
        )
        self._rate, self._sent = rate_hz, 0

    def until(self, t_ns: int) -> bytes:
        """What it has sent since the last call."""
        count = int(t_ns * self._rate) // 10**9
        packets = [
            encode_packet(
                i, n, round(n * 1e6 / self._rate), [500 * math.sin(n * w / self._rate + i) for w in (3, 9, 6)]
            )
            for n in range(self._sent, count)
            for i in range(len(self.device.streams))
        ]
        self._sent = count
        return b"".join(packets)


def streams_of(boxes: list[Box]) -> list[Stream]:
    return [
        Stream(f"{b.device.name}.{s.name}", tuple(s.signals), s.rate, 0.2, b.device.name)
        for b in boxes
        for s in b.device.streams
    ]


def simulated(boxes: list[Box], blocks: list[list[bytes]], clock: ManualClock, bus: Bus) -> Iterator[loop.Beat]:
    start = clock.now_ns()
    of_tick = TICK_NS // BLOCK_NS
    for k in range(len(blocks) // of_tick):
        for of_boxes in blocks[k * of_tick : (k + 1) * of_tick]:
            clock.advance_s(BLOCK_NS * 1e-9)
            for box, data in zip(boxes, of_boxes, strict=True):
                box.adapter.take(data)
        yield loop.Beat(Tick(start + (k + 1) * TICK_NS, k, start + (k - 2) * TICK_NS), bus.drain())


def fly(boxes: list[Box], beats: Iterator[loop.Beat], clock: Clock, bus: Bus, folder: Path) -> Path:
    """All of it through the station's front end."""
    streams = streams_of(boxes)
    writer = WriterThread(folder, About(load_aircraft("twin_otter"), tuple(streams)), clock, bus.put)
    loop.run(beats, Aligner(streams, {}), lambda: loop.Chain(_Nothing()), writer)
    writer.close()
    return writer.path


class _Nothing:
    def step(self, _: object) -> tuple[None, tuple[()]]:
        raise ArithmeticError("no estimator here")

    def start_point(self) -> None: ...


def send(masters: list[int], steps: list[list[bytes]], step_ns: int, begin_ns: int) -> None:
    """Each step's bytes at their time."""
    clock = SystemClock()
    for n, of_boxes in enumerate(steps):
        clock.sleep_until_ns(begin_ns + n * step_ns)
        for master, data in zip(masters, of_boxes, strict=True):
            os.write(master, data)


def fly_simulated(chosen: argparse.Namespace, folder: Path) -> Path:
    clock, bus = ManualClock(10**9), Bus()
    gathering = Gathering(clock)
    boxes = [Box(i, chosen.streams // chosen.links, chosen.rate, bus, gathering, clock) for i in range(chosen.links)]
    steps = round(chosen.seconds * 1e9) // BLOCK_NS
    blocks = [[box.until(n * BLOCK_NS) for box in boxes] for n in range(1, steps + 1)]
    return measured(lambda: fly(boxes, simulated(boxes, blocks, clock, bus), clock, bus, folder), boxes, chosen)


def fly_live(chosen: argparse.Namespace, folder: Path) -> Path:
    clock, bus = SystemClock(), Bus()
    pairs = [os.openpty() for _ in range(chosen.links)]
    for _, slave in pairs:
        tty.setraw(slave)
    names = [os.ttyname(slave) for _, slave in pairs]
    of_each = chosen.streams // chosen.links
    gathering = Gathering(clock)
    boxes = [Box(i, of_each, chosen.rate, bus, gathering, clock, name) for i, name in enumerate(names)]
    step_ns = round(1e9 / chosen.rate)
    steps = [[box.until(n * step_ns) for box in boxes] for n in range(1, round(chosen.seconds * chosen.rate) + 1)]
    sender = Process(target=send, args=([m for m, _ in pairs], steps, step_ns, clock.now_ns() + 2_000_000_000))
    sender.start()
    del steps
    sys.setswitchinterval(0.0005)  # as station run has it
    for box in boxes:
        box.adapter.start()
    beats = loop.beats(bus, clock, LAG_S, threading.Event(), chosen.seconds + SETTLE_S)
    path = measured(lambda: fly(boxes, beats, clock, bus, folder), boxes, chosen)
    sender.join()
    for box in boxes:
        box.adapter.stop()
    return path


def measured(work: Callable[[], Path], boxes: list[Box], chosen: argparse.Namespace) -> Path:
    """Does it, and tells the processor time."""
    Aligner(streams_of(boxes), {}).begin()
    gc.collect()
    gc.disable()
    gc.freeze()
    profiler = cProfile.Profile() if chosen.profile else None
    began = time.process_time()
    if profiler is not None:
        profiler.enable()
    path = work()
    took = time.process_time() - began
    if profiler is not None:
        profiler.disable()
        pstats.Stats(profiler).sort_stats("tottime").print_stats(22)
    samples = chosen.streams * chosen.rate * chosen.seconds
    print(f"{took / chosen.seconds:.2f} of one core, {1e6 * took / samples:.1f} us a sample")
    return path


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--streams", type=int, default=32)
    options.add_argument("--links", type=int, default=8)
    options.add_argument("--rate", type=float, default=1000.0)
    options.add_argument("--seconds", type=float, default=10.0)
    options.add_argument("--live", action="store_true")
    options.add_argument("--profile", action="store_true")
    chosen = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = (fly_live if chosen.live else fly_simulated)(chosen, Path(folder))
        summary, size = summarise(path), path.stat().st_size
    samples = sum(s.samples for s in summary.streams)
    expected = round(chosen.streams * chosen.rate * chosen.seconds)
    ticks = round(chosen.seconds * TICK_HZ)
    print(f"{samples} of {expected} samples recorded, {summary.ticks_missed} of {ticks} ticks missed")
    print(f"{size / 2**20 / chosen.seconds:.2f} MiB a second, {threading.active_count()} threads left")
    assert set(NAMES) <= set(SIGNALS)


if __name__ == "__main__":
    main()
