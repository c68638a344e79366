"""Many fast links at once, of the operating system and in its time: are all samples recorded, and what do they cost?

    uv run python -m tests.reliability.live_links [--streams 32] [--rate 1000] [--seconds 10] [--flood]

Boom boxes of four streams each on pseudo-terminals and an autopilot on UDP, driven by a process of their own; drivers,
bus, aligner, loop and recording are the station's, without estimators and screen. With `--flood` somebody else sends
datagrams to the autopilot's port as fast as the machine can.

    ... live_links boxes STREAMS RATE SECONDS PORT      the process that drives them
    ... live_links flood PORT SECONDS
"""

from __future__ import annotations

import argparse
import gc
import math
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

from drivers import mavlink_port, serial_port
from drivers.adapter import Adapter
from drivers.gathering import Gathering
from drivers.mavlink import MavlinkCodec, MavlinkEncoder
from drivers.serial_boombox import BoomboxCodec, encode_packet
from station.clock import SystemClock
from station.conventions import Stream
from station.flight import loop
from station.flight.alignment import Aligner
from station.flight.bus import Bus
from station.log import About, WriterThread, summarise
from station.profile import Channel, MavlinkDevice, SerialDevice, StreamProfile, load_aircraft

NAMES: Final = ("alpha_vane", "beta_vane", "elevator")
OF_A_BOX: Final = 4
BLOCK_S: Final = 0.005
"""The boxes write each so often, as USB adapters do."""
ATTITUDE_HZ: Final = 50
AFTER_S: Final = 1.0
"""Flown on after the last byte was sent: what waits in the system is read."""


@dataclass(frozen=True, slots=True)
class Flown:
    """What came of it."""

    sent: int
    recorded: int
    ticks: int
    ticks_missed: int
    core: float
    """Share of one that the whole process took."""
    lost: int
    """Rows that the station says were lost."""
    flooded: int
    autopilot: int
    """Messages of the autopilot that were recorded, and sent."""
    autopilot_sent: int


def boxes(streams: int, rate: int, seconds: float, port: int) -> None:
    """Each stream's packets in time, and attitudes with heartbeats; when the system takes none, they wait."""
    ends = [os.openpty() for _ in range(streams // OF_A_BOX)]
    for master, slave in ends:
        tty.setraw(master)
        tty.setraw(slave)
    print(*(os.ttyname(slave) for _, slave in ends), flush=True)
    sys.stdin.readline()
    vehicle, autopilot = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), MavlinkEncoder()
    begun, done, said = time.monotonic(), 0, 0
    while done < rate * seconds:
        time.sleep(BLOCK_S)
        due = min(int((time.monotonic() - begun) * rate), round(rate * seconds))
        for master, _ in ends:
            packets = [
                encode_packet(i, n, round(n * 1e6 / rate), [500 * math.sin(w * n / rate) for w in (3, 9, 6)])
                for n in range(done, due)
                for i in range(OF_A_BOX)
            ]
            data = b"".join(packets)
            while data:
                data = data[os.write(master, data) :]
        done = due
        while said < done * ATTITUDE_HZ // rate:
            beat = autopilot.heartbeat() if said % ATTITUDE_HZ == 0 else b""
            attitude = autopilot.encode("ATTITUDE", {"pitch": 0.1}, said * 10**9 // ATTITUDE_HZ)
            vehicle.sendto(beat + attitude, ("127.0.0.1", port))
            said += 1
    print(done * streams, said, flush=True)
    sys.stdin.readline()


def flood(port: int, seconds: float) -> None:
    """Datagrams as fast as the system takes them."""
    sender, count, end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), 0, time.monotonic() + seconds
    while time.monotonic() < end:
        for _ in range(100):
            sender.sendto(b"\xfe\x09\x00\x00\x01\x00" * 200, ("127.0.0.1", port))
        count += 100
    print(count, flush=True)


@contextmanager
def child(*words: object) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "tests.reliability.live_links", *map(str, words)]
    one = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2]
    )
    try:
        yield one
    finally:
        one.kill()
        one.communicate()


def fly(streams: int, rate: int, seconds: float, *, is_flooded: bool = False) -> Flown:
    clock, bus, stop = SystemClock(), Bus(), threading.Event()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    with ExitStack() as stack:
        driver = stack.enter_context(child("boxes", streams, rate, seconds, port))
        assert driver.stdin is not None
        assert driver.stdout is not None
        paths = driver.stdout.readline().split()
        gathering = Gathering(clock)
        adapters = [_box(n, path, rate, bus, gathering) for n, path in enumerate(paths)]
        adapters.append(_autopilot(port, clock, bus))
        all_streams = [
            Stream(f"{a.device.name}.{s.name}", tuple(s.signals), s.rate, 0.2, a.device.name)
            for a in adapters
            for s in a.device.streams
        ]
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        writer = WriterThread(folder, About(load_aircraft("twin_otter"), tuple(all_streams)), clock, bus.put)
        aligner = Aligner(all_streams, {})
        aligner.begin()
        for adapter in adapters:
            stack.callback(adapter.stop)
            adapter.start()
        while not all(adapter.connected for adapter in adapters):
            time.sleep(0.01)
        stack.enter_context(_as_in_flight())
        thread = threading.Thread(target=lambda: loop.run(
            loop.beats(bus, clock, 0.06, stop, None), aligner, lambda: loop.Chain(_Nothing()), writer
        ))  # fmt: skip
        began, began_s = time.process_time(), time.monotonic()
        thread.start()
        driver.stdin.write("go\n")
        driver.stdin.flush()
        flooding = stack.enter_context(child("flood", port, seconds)) if is_flooded else None
        sent, said = map(int, driver.stdout.readline().split())
        core = (time.process_time() - began) / (time.monotonic() - began_s)
        flooded = int(flooding.stdout.readline()) if flooding is not None and flooding.stdout is not None else 0
        time.sleep(AFTER_S)
        stop.set()
        thread.join()
        writer.close()
        found = summarise(writer.path)
    samples = {s.name: s.samples for s in found.streams}
    heard = samples.pop("autopilot.attitude", 0)
    lost = writer.rows_lost + bus.dropped + sum(adapter.blocks_lost for adapter in adapters)
    return Flown(sent, sum(samples.values()), found.ticks, found.ticks_missed, core, lost, flooded, heard, said)


def _box(n: int, path: str, rate: int, bus: Bus, gathering: Gathering) -> Adapter:
    channels = {name: Channel(field=f"v{i}", unit="deg", slope=0.01) for i, name in enumerate(NAMES)}
    device = SerialDevice(
        name=f"box{n}", link="serial", protocol="boombox", port=path,
        streams=tuple(
            StreamProfile(name=f"s{i}", message=i, rate=f"{rate} Hz", signals=channels) for i in range(OF_A_BOX)
        ),
    )  # fmt: skip
    opener = partial(serial_port.open_port, path, 115_200)
    return Adapter(device, BoomboxCodec(), opener, SystemClock(), bus.put, path, gathering)


def _autopilot(port: int, clock: SystemClock, bus: Bus) -> Adapter:
    pitch = {"theta": {"field": "pitch", "unit": "rad"}}
    device = MavlinkDevice.model_validate({
        "name": "autopilot", "link": "mavlink", "url": "emulated",
        "streams": [{"name": "attitude", "message": "ATTITUDE", "rate": f"{ATTITUDE_HZ} Hz", "signals": pitch}],
    })  # fmt: skip
    codec, url = MavlinkCodec(device), f"udpin:127.0.0.1:{port}"
    return Adapter(device, codec, lambda: mavlink_port.open_port(device, url, codec, clock), clock, bus.put)


@contextmanager
def _as_in_flight() -> Iterator[None]:
    """The interpreter as `station run` sets it."""
    interval = sys.getswitchinterval()
    gc.disable()
    sys.setswitchinterval(0.0005)
    try:
        yield
    finally:
        sys.setswitchinterval(interval)
        gc.enable()


class _Nothing:
    """No estimator."""

    def step(self, _: object) -> tuple[None, tuple[()]]:
        raise ArithmeticError("none here")

    def start_point(self) -> None: ...


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--streams", type=int, default=32)
    options.add_argument("--rate", type=int, default=1000)
    options.add_argument("--seconds", type=float, default=10.0)
    options.add_argument("--flood", action="store_true")
    chosen = options.parse_args()
    found = fly(chosen.streams, chosen.rate, chosen.seconds, is_flooded=chosen.flood)
    print(f"{found.recorded} of {found.sent} samples recorded, {found.lost} rows said to be lost")
    print(f"{found.autopilot} of {found.autopilot_sent} messages of the autopilot; {found.flooded} datagrams of others")
    print(f"{found.ticks_missed} of {found.ticks} ticks missed; {found.core:.2f} of a core")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["boxes", streams, rate, seconds, port]:
            boxes(int(streams), int(rate), float(seconds), int(port))
        case ["flood", port, seconds]:
            flood(int(port), float(seconds))
        case _:
            main()
