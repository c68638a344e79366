"""A disk that stalls, or is full, keeps no tick waiting; what it costs is counted and told.

No test here measures time: the disk answers when the flight is over, so a flight that waited for it would never end.
"""

from __future__ import annotations

import errno
import os
import random
import threading
import time
from pathlib import Path

import pytest
from reliability.endings import about, tick_rows

from station.clock import ManualClock
from station.log import WriterThread, read_rows, summarise
from station.log.disk import Disk, name_of_disk
from station.rows import Code, Event, Rows

TICK_S = 0.02


class StallingDisk(Disk):
    """Answers at once until `stalls` is cleared of what it is to answer: write, sync."""

    def __init__(self, clock: ManualClock, *kinds: str) -> None:
        super().__init__(clock)
        self.kinds = kinds
        self.answers = threading.Event()
        self.answers.set()
        self.is_full = False

    def write(self, file: int, data: memoryview) -> int:
        with self._timed():
            if "write" in self.kinds:
                assert self.answers.wait(60)
            if self.is_full:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return os.write(file, data)

    def sync(self, file: int) -> None:
        with self._timed():
            if "sync" in self.kinds:
                assert self.answers.wait(60)
            os.fdatasync(file)


class Flight:
    """A writer thread on a manual clock, fed ticks as fast as it takes them."""

    def __init__(self, folder: Path, *kinds: str, queue_bytes: int = 2**26) -> None:
        self.clock = ManualClock(10**9)
        self.disk = StallingDisk(self.clock, *kinds)
        self.events: list[Event] = []
        self.writer = WriterThread(folder, about(), self.clock, self.events.append, self.disk, queue_bytes=queue_bytes)
        self.written: list[Rows] = []
        self._noise = random.Random(1)
        self._k = 0

    def fly(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK_S)):
            rows = tick_rows(self._k, self.clock.now_ns(), self._noise)
            self.writer.append(rows)
            self.writer.flush()
            self.written += rows
            self._k += 1
            self.clock.advance_s(TICK_S)

    def until(self, what: str) -> None:
        """Let the writer's threads go on until the disk is asked, or all has been taken."""
        for _ in range(6000):
            idle = self.writer._given == self.writer._taken and not self.disk._asked_ns
            if idle if what == "idle" else self.disk._asked_ns:
                return
            time.sleep(0.01)
        raise AssertionError(f"not {what} within 60 s")


@pytest.mark.parametrize("kind", ["write", "sync"])
def test_a_disk_that_stalls_costs_no_tick_and_is_named(tmp_path: Path, kind: str) -> None:
    flight = Flight(tmp_path, kind)
    flight.fly(2.0)
    flight.until("idle")
    flight.disk.answers.clear()
    flight.clock.advance_s(1.0)
    flight.fly(0.1)
    flight.until("asked")
    flight.fly(2.0)
    assert [e.code for e in flight.events] == [Code.DISK]
    assert f"{name_of_disk(tmp_path)} has not answered for 1." in flight.events[0].detail
    flight.disk.answers.set()
    flight.until("idle")
    flight.fly(0.1)
    assert len(flight.events) == 2
    assert flight.events[1].detail.startswith(f"recording again: {name_of_disk(tmp_path)} answered after 2.")
    assert flight.events[1].detail.endswith("no row lost")
    flight.fly(1.0)
    flight.writer.close()
    assert (flight.writer.rows_lost, flight.writer.failed) == (0, "")
    assert list(read_rows(flight.writer.path)) == flight.written
    assert summarise(flight.writer.path).verdict == "complete"


def test_when_memory_is_full_rows_are_lost_counted_and_told(tmp_path: Path) -> None:
    flight = Flight(tmp_path, "write", queue_bytes=2**20)
    flight.fly(1.0)
    flight.until("idle")
    flight.disk.answers.clear()
    flight.fly(10.0)
    assert any("rows are being lost" in e.detail for e in flight.events)
    flight.disk.answers.set()
    flight.until("idle")
    flight.fly(1.0)
    flight.writer.close()
    read = list(read_rows(flight.writer.path))
    lost = len(flight.written) - len(read)
    assert lost > 0
    assert flight.writer.rows_lost == lost
    assert [e.count for e in flight.events if e.code is Code.DROPPED] == [lost]
    assert any(e.detail.startswith(f"recording again, {lost} rows lost") for e in flight.events)
    # One gap, and not many: whole ticks up to it, whole ticks from it on.
    before = next(n for n, (a, b) in enumerate(zip(read, flight.written, strict=False)) if a != b)
    assert read == flight.written[:before] + flight.written[before + lost :]
    assert summarise(flight.writer.path).ticks_missed == lost // 22


def test_a_full_disk_holds_no_tick_and_what_is_kept_is_written_when_there_is_room(tmp_path: Path) -> None:
    flight = Flight(tmp_path, "write")
    flight.fly(1.0)
    flight.until("idle")
    flight.disk.is_full = True
    flight.fly(1.0)
    flight.until("idle")
    assert "No space left on device" in flight.events[0].detail
    flight.disk.is_full = False
    # The rows kept are written again by a disk that does not answer meanwhile: the flight does not notice.
    flight.disk.answers.clear()
    flight.clock.advance_s(1.0)
    flight.fly(3.0)
    flight.disk.answers.set()
    flight.until("idle")
    flight.fly(0.2)
    flight.writer.close()
    assert flight.writer.path.name.endswith(".0001.mcap")
    assert flight.writer.rows_lost == 0
    assert list(read_rows(sorted(tmp_path.iterdir(), key=lambda p: len(p.name))[0])) == flight.written


def test_a_disk_that_fails_to_sync_makes_the_recording_doubtful(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flight = Flight(tmp_path)

    def fail(_: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(flight.disk, "sync", fail)
    flight.fly(2.0)
    flight.until("idle")
    flight.fly(2.0)
    flight.writer.close()
    assert any("Input/output error while syncing" in e.detail for e in flight.events)
    assert name_of_disk(tmp_path) in flight.writer.failed


def test_the_end_of_a_flight_does_not_wait_for_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("station.log.writer_thread.END_S", 0.2)
    flight = Flight(tmp_path, "write")
    flight.disk.answers.clear()
    flight.fly(1.0)
    flight.writer.close()
    assert "lacks the last rows" in flight.writer.failed
    flight.disk.answers.set()
    flight.writer._thread.join(60)


@pytest.mark.skipif(not Path("/proc/self/mounts").exists(), reason="the system does not list its mounts there")
def test_the_disk_of_a_folder_is_where_it_is_mounted() -> None:
    assert name_of_disk(Path("/proc/self")) == "disk /proc (proc)"


def test_a_flight_of_many_files_is_named_by_its_first(tmp_path: Path) -> None:
    """The last words of a flight named the file written last: `identify` of that is of the flight's end alone."""
    clock, noise = ManualClock(10**9), random.Random(1)
    writer = WriterThread(tmp_path, about(), clock, lambda _: None, rotate_bytes=20_000)
    first = writer.recording
    for k in range(200):
        writer.append(tick_rows(k, clock.now_ns(), noise))
        writer.flush()
        clock.advance_s(TICK_S)
    writer.close()
    assert writer.path != first == writer.recording
    assert summarise(writer.recording).files > 1
    first.unlink()
    assert writer.recording == writer.path
