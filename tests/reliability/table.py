"""What the station withstands, as a table: each trial with its limit and how it came out.

    uv run python -m tests.reliability.table [--quick]

Needs root, loop devices and ext4 for the power cuts of a real file system; without them it says so.
"""

from __future__ import annotations

import os
import random
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np

from station.clock import ManualClock, SystemClock
from station.convert import import_file
from station.log import WriterThread, metadata, read_rows, summarise, write_log
from station.log.disk import Disk
from station.rows import LogError, Rows
from tests.reliability import live_links
from tests.reliability.clocks import jumped, mapped, sent, stalled, starved
from tests.reliability.crafted import KINDS, cost
from tests.reliability.endings import (
    CUT_S,
    KILLED_S,
    Ending,
    Journal,
    about,
    cut_on_ext4,
    ending,
    fly,
    kill,
    may_mount,
    tick_rows,
)
from tests.reliability.mutations import FOREIGN, FOREIGN_S, GROWTH_MIB, LONGEST_S, NAMES, links
from tests.reliability.mutations import fly as fly_mutations
from tests.reliability.test_foreign_files import AIRCRAFT, DATAFLASH, dataflash, mat, mutated, ulog

Told = tuple[str, str, str, bool]
"""A trial, its limit, how it came out, and whether that holds."""
STALL_S = 2.0
SIDE_BY_SIDE = 3
"""Flights that end badly, flown at a time: they do little but wait."""


def endings(name: str, moments: int, limit_s: float, one: Callable[[Path, int], Ending]) -> Told:
    """The worst of many flights that end badly."""

    def flight(seed: int) -> Ending:
        with tempfile.TemporaryDirectory() as folder:
            return one(Path(folder), seed)

    with ThreadPoolExecutor(SIDE_BY_SIDE) as several:
        found = list(several.map(flight, range(moments)))
    worst, holes = max(e.lost_s for e in found), sum(e.holes for e in found)
    words = f"{worst:.3f} s lost at most, {holes} ticks missing before"
    return f"{name}, {moments} moments", f"{limit_s:g} s", words, worst <= limit_s and holes == 0


def journal(moments: int) -> Told:
    """Power cuts of a file layer that keeps what had been synced, one flight of 20 s in files of a second."""
    with tempfile.TemporaryDirectory() as work:
        disk, told = Journal(), list[int]()
        writer = WriterThread(Path(work) / "new" / "logs", about(), SystemClock(), lambda _: None, disk, 60_000)
        fly(writer, 1000, told.append)
        writer.close()
        noise, worst = random.Random(1), 0.0
        for n in range(moments):
            cut = noise.randint(told[0] + round(CUT_S * 1e9), told[-1])
            disk.left_at(cut, Path(work) / str(n), zeros=bool(n % 2))
            worst = max(worst, ending(Path(work) / str(n), max(t for t in told if t <= cut)).lost_s)
    words = f"{worst:.3f} s lost at most"
    name = f"power cut, a file layer that keeps what was synced, {moments} moments"
    return name, f"{CUT_S:g} s", words, worst <= CUT_S


class Stalling(Disk):
    """Each third second a write or a sync takes STALL_S."""

    def __init__(self) -> None:
        super().__init__(SystemClock())
        self.stalls, self._next = 0, time.monotonic() + 1.0

    def _hold(self) -> None:
        if time.monotonic() > self._next:
            self._next = time.monotonic() + STALL_S + 1.0
            self.stalls += 1
            time.sleep(STALL_S)

    def write(self, file: int, data: memoryview) -> int:
        with self._timed():
            self._hold()
            return os.write(file, data)

    def sync(self, file: int) -> None:
        with self._timed():
            self._hold()
            os.fdatasync(file)


def stalls(seconds: float) -> Told:
    with tempfile.TemporaryDirectory() as work:
        disk, longest = Stalling(), 0.0
        writer = WriterThread(Path(work), about(), SystemClock(), lambda _: None, disk)
        noise, start = random.Random(1), time.monotonic()
        for k in range(round(seconds * 50)):
            time.sleep(max(0.0, start + 0.02 * k - time.monotonic()))
            began = time.monotonic()
            writer.append(tick_rows(k, time.monotonic_ns(), noise))
            writer.flush()
            longest = max(longest, time.monotonic() - began)
        writer.close()
        summary = summarise(writer.path)
    lost = f"{writer.rows_lost} rows and {summary.ticks_missed} ticks lost"
    words = f"the loop waited {longest * 1e3:.1f} ms at most, {lost}"
    held = longest < 0.02 and not writer.rows_lost and not summary.ticks_missed
    return f"{disk.stalls} stalls of {STALL_S:g} s of a disk in {seconds:g} s", "20 ms, 0, 0", words, held


@contextmanager
def flown() -> Iterator[tuple[Path, list[Rows]]]:
    """Ten seconds of rows, as a recording."""
    with tempfile.TemporaryDirectory() as work:
        noise = random.Random(1)
        rows = [row for k in range(500) for row in tick_rows(k, 10**9 + k * 20_000_000, noise)]
        path = Path(work) / "flight.mcap"
        write_log(path, about(), rows)
        yield path, rows


def hurt(name: str, inputs: int, change: Callable[[bytes, random.Random], bytes]) -> Told:
    """Recordings that were damaged: no row altered, none unreadable but those of a chunk."""
    altered, refused, lost = 0, 0, 0
    with flown() as (path, rows):
        data, known, info = path.read_bytes(), set(map(repr, rows)), metadata(path)
        noise, bad = random.Random(2), path.with_name("hurt.mcap")
        head = data.index(b"zstd")
        for _ in range(inputs):
            changed = change(data, noise)
            bad.write_bytes(changed)
            try:
                found = [repr(row) for row in read_rows(bad)]
                altered += not known.issuperset(found) or metadata(bad) != info
                lost = max(lost, len(rows) - len(found) if len(changed) == len(data) else 0)
            except LogError:
                refused += len(changed) > 2 * head
    words = f"{altered} altered, {refused} unreadable, {lost} of {len(rows)} rows lost at most"
    return f"{name} of a recording, {inputs}", "0, 0, a chunk", words, not altered and not refused and lost < 1200


def flip(data: bytes, noise: random.Random) -> bytes:
    out = bytearray(data)
    out[noise.randrange(len(out))] ^= 1 << noise.randrange(8)
    return bytes(out)


def cut(data: bytes, noise: random.Random) -> bytes:
    return data[: noise.randrange(8, len(data))]


def foreign(inputs: int) -> Told:
    """Files from elsewhere, damaged: each ends in a LogError or in a recording that can be read."""
    worst, bad = 0.0, 0
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        sources = {
            "mat": [mat(work / "made.mat", False), mat(work / "made.mat", True)],
            "bin": [dataflash([1_000_000 + k * 20_000 for k in range(100)])],
            "ulg": [ulog()],
        }
        noise = random.Random(3)
        for kind, whole in sources.items():
            for _ in range(inputs):
                path, out = work / f"a.{kind}", work / "a.mcap"
                out.unlink(missing_ok=True)
                path.write_bytes(mutated(noise.choice(whole), noise))
                began = time.monotonic()
                try:
                    import_file(path, out, AIRCRAFT, (DATAFLASH,))
                    summarise(out)
                except LogError:
                    bad += out.exists()
                worst = max(worst, time.monotonic() - began)
    grown = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    words = f"{bad} left a recording that cannot be read; {worst:.1f} s and {grown:.0f} MiB at most"
    return f"damaged .mat, .bin and .ulg, {inputs} of each", "0; 65 s", words, not bad and worst < 65


def full_disk() -> Told:
    """No room for 3 s: rows wait, and are written when there is room again."""

    class Full(Disk):
        full = False

        def write(self, file: int, data: memoryview) -> int:
            if self.full:
                raise OSError(28, "No space left on device")
            return super().write(file, data)

    with tempfile.TemporaryDirectory() as work:
        clock, noise = ManualClock(10**9), random.Random(1)
        disk = Full(clock)
        writer = WriterThread(Path(work), about(), clock, lambda _: None, disk)
        first, written = writer.path, list[Rows]()
        for k in range(500):
            disk.full = 100 <= k < 250
            rows = tick_rows(k, clock.now_ns(), noise)
            written += rows
            writer.append(rows)
            writer.flush()
            clock.advance_s(0.02)
            time.sleep(0.002)
        writer.close()
        read = list(read_rows(first))
    words = f"{len(written) - len(read)} rows lost, {writer.rows_lost} counted"
    return "a disk full for 3 s", "0, 0", words, read == written and not writer.rows_lost


def clock_jumps(links: int) -> Told:
    """Device clocks that jump by 3 ms to an hour, each way, on links whose delays let 3 ms be seen."""
    sizes_s = [j * 1e-3 for j in (3, 4, 6, 10, 15, 19)] + [0.1, 2.0, 3600.0]
    late, wrong, worst = 0.0, 0, 0.0
    rng = np.random.default_rng(1)
    kinds = [("an adapter's millisecond", 5), ("an adapter's millisecond", 200), ("a network's 1 ms, exponential", 100)]
    for _ in range(links):
        for delay, rate in kinds:
            for by_s in (sign * size for size in sizes_s for sign in (-1, 1)):
                messages, first = jumped(sent(rate, 40.0, delay, rng), 30.0, by_s)
                found = mapped(messages)
                wrong += len(found.told) != 1
                if found.told:
                    late = max(late, float(messages.arrival[found.told[0]] - messages.arrival[first]) * 1e-9)
                    worst = max(worst, float(np.abs(found.error_s[found.told[0] + 1 :]).max()))
    count = links * len(kinds) * 2 * len(sizes_s)
    words = f"{wrong} not told, or told twice; told after {late:.2f} s, then off by {worst * 1e3:.2f} ms at most"
    holds = not wrong and late <= 1 and worst <= 0.002
    return f"device clocks that jump by 3 ms to 1 h, {count}", "0; 1 s, 2 ms", words, holds


def stalls_of_the_station(hours: float) -> Told:
    """Sound clocks on a machine that stands still, loses what its buffers do not hold, or starves its readers."""
    rng, told, before = np.random.default_rng(2), 0, 0
    for rate in (1, 5, 50, 100, 200):
        sound = sent(rate, hours * 720, "a network's 1 ms, exponential", rng)
        held, lost = (stalled(sound, rng, is_lossy=lossy) for lossy in (False, True))
        told += sum(len(mapped(messages).told) for messages in (held, lost, starved(sound, rng)))
        before += len(mapped(lost, law=1).told)
    words = f"{told} jumps told of clocks that did not jump ({before} by the law until now)"
    return f"a machine that stalls, {hours:g} h of five links", "0", words, not told


def crafted_bytes() -> Told:
    """The bytes that keep each reader busiest, through the adapter."""
    worst, which, bad = 0.0, "", 0
    for name, kinds in KINDS.items():
        for kind, data in kinds.items():
            share, _, unaccounted = cost(links()[name].codec(), data)
            bad += bool(unaccounted)
            worst, which = max((worst, which), (share, f"{name}, {kind}"))
    words = f"{worst:.0%} of a core ({which}); {bad} with bytes unaccounted for"
    count = sum(map(len, KINDS.values()))
    return f"1 MB/s of crafted bytes, {count} kinds", "20 %; 0", words, worst < 0.2 and not bad


def fast_links(streams: int, rate: int, seconds: float, *, is_flooded: bool) -> Told:
    """Links of the operating system in its time, and a flood of datagrams beside them."""
    found = live_links.fly(streams, rate, seconds, is_flooded=is_flooded)
    missing = found.sent - found.recorded
    words = (
        f"{missing} of {found.sent} samples missing, {found.ticks_missed} of {found.ticks} ticks missed, "
        f"{found.autopilot} of {found.autopilot_sent} messages of the autopilot; {found.core:.2f} of a core"
    )
    name = f"{streams} streams at {rate} Hz, {seconds:g} s"
    if is_flooded:
        name += f", and {found.flooded / seconds / 1000:.0f} thousand datagrams a second from elsewhere"
    limit = "0, 0; 1 core"
    return name, limit, words, not missing and not found.ticks_missed and found.core < 1


def mutations(name: str, inputs: int) -> Told:
    """Bad inputs of one codec or reader, as many as a minute of processor time takes."""
    found = fly_mutations(name, inputs, seconds=60.0)
    words = f"{found.raised} faults, {found.longest_s * 1e3:.0f} ms, {found.growth_mib:.0f} MiB at most"
    limit_s = FOREIGN_S if name in FOREIGN else LONGEST_S
    return f"mutated inputs of {name}, {found.inputs}", f"0; {limit_s:g} s, {GROWTH_MIB:g} MiB", words, found.holds


def main() -> None:
    part = 20 if "--quick" in sys.argv else 1
    trials: list[Callable[[], Told]] = [
        lambda: endings("kill -9", 100 // part, KILLED_S, kill),
        lambda: journal(50),
        lambda: stalls(60 / min(part, 5)),
        full_disk,
        lambda: hurt("flipped bits", 2000 // part, flip),
        lambda: hurt("cuts", 2000 // part, cut),
        lambda: foreign(1000 // part),
        lambda: clock_jumps(20 // part),
        lambda: stalls_of_the_station(1.0 / part),
        crafted_bytes,
        lambda: fast_links(8, 200, 60 / part, is_flooded=True),
        lambda: fast_links(32, 1000, 60 / part, is_flooded=False),
        *(partial(mutations, name, 1_000_000 // part) for name in NAMES),
    ]
    if may_mount():
        trials.insert(2, lambda: endings("power cut of an ext4 disk", 50 // part, CUT_S, cut_on_ext4))
    print("| trial | limit | found | |\n| --- | --- | --- | --- |")
    failed = False
    for trial in trials:
        name, limit, found, holds = trial()
        failed |= not holds
        print(f"| {name} | {limit} | {found} | {'holds' if holds else '**does not hold**'} |", flush=True)
    sys.exit(failed)


if __name__ == "__main__":
    main()
