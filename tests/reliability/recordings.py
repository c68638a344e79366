"""What of a flight's recording outlasts what: kills, power cuts, disks that stall, fill or vanish, damage."""

from __future__ import annotations

import os
import random
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from station.clock import ManualClock, SystemClock
from station.log import WriterThread, metadata, read_rows, summarise, write_log
from station.log.disk import Disk
from station.rows import LogError, Rows
from tests.reliability.endings import CUT_S, Ending, Journal, about, ending, fly, tick_rows

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


class Gone(Disk):
    """A disk that can be pulled out: everything fails, and its folder with all that is in it has gone."""

    is_gone = False

    def _ask(self) -> None:
        if self.is_gone:
            raise OSError(5, "Input/output error")

    def create(self, path: Path) -> int:
        self._ask()
        return super().create(path)

    def write(self, file: int, data: memoryview) -> int:
        self._ask()
        return super().write(file, data)

    def sync(self, file: int) -> None:
        self._ask()
        super().sync(file)

    def sync_folder(self, folder: Path) -> None:
        self._ask()
        super().sync_folder(folder)


def vanished_disk() -> Told:
    """Pulled out for 3 s of a flight in real time: what was on it is counted as lost, what comes then is not lost."""
    with tempfile.TemporaryDirectory() as work:
        folder, noise = Path(work) / "disk", random.Random(1)
        disk = Gone(SystemClock())
        writer = WriterThread(folder, about(), SystemClock(), lambda _: None, disk)
        since, longest, start = list[Rows](), 0.0, time.monotonic()
        for k in range(500):
            time.sleep(max(0.0, start + 0.02 * k - time.monotonic()))
            if k == 200:
                disk.is_gone = True
                shutil.rmtree(folder)
            disk.is_gone = 200 <= k < 350
            rows = tick_rows(k, time.monotonic_ns(), noise)
            since += rows if k >= 200 else []
            began = time.monotonic()
            writer.append(rows)
            writer.flush()
            longest = max(longest, time.monotonic() - began)
        writer.close()
        found = {repr(row) for path in folder.glob("*.mcap") for row in read_rows(path)}
    total = 500 * len(tick_rows(0, 0, noise))
    missing = sum(repr(row) not in found for row in since)
    uncounted = total - len(found) - writer.rows_lost
    words = f"{missing} rows since then missing, {uncounted} uncounted; the loop waited {longest * 1e3:.1f} ms at most"
    return "a disk pulled out for 3 s", "0, 0; 20 ms", words, not missing and not uncounted and longest < 0.02


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
