"""Flights that end badly: killed, or their power cut; and how much of what had reached the station is lost.

uv run python tests/reliability/endings.py FOLDER     a child that flies into FOLDER until it is ended
"""

from __future__ import annotations

import fcntl
import math
import os
import random
import shutil
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from station.clock import SystemClock
from station.conventions import TICK_NS, Stream
from station.log import About, WriterThread, read_rows, summarise
from station.log.disk import Disk
from station.profile import load_aircraft
from station.rows import RawBlock, Rows, Sample, Tick

KILLED_S: Final = 0.15
CUT_S: Final = 1.5
"""What may be lost, of what had reached the station (logs/README.md)."""
STREAM: Final = Stream("boom.vanes", ("alpha_vane", "beta_vane"), 1000.0, 0.1, "boom")
_SHUTDOWN: Final = 0x8004587D
_NO_LOG_FLUSH: Final = struct.pack("I", 2)
"""ioctl EXT4_IOC_SHUTDOWN with EXT4_GOING_FLAGS_NOLOGFLUSH (linux/fs/ext4/ext4.h): nothing more reaches the device, as
filesystem testers cut the power."""


def about() -> About:
    return About(load_aircraft("twin_otter"), (STREAM,))


def tick_rows(k: int, now: int, noise: random.Random) -> list[Rows]:
    """A tick of 20 samples and their bytes, which zstd cannot pack: some 50 kB/s of recording."""
    rows: list[Rows] = [RawBlock(now, "boom", noise.randbytes(400))]
    rows += [Sample(now - i, "boom.vanes", now, (20 * k + i) % 256, (noise.random(), 0.3)) for i in range(20)]
    rows.append(Tick(now, k, now))
    return rows


def fly(writer: WriterThread, ticks: float, each: Callable[[int], None], stop: threading.Event | None = None) -> None:
    """Ticks at 50 Hz of the machine's clock; `each` is told a tick's time when it has been handed over."""
    clock, noise = SystemClock(), random.Random(1)
    start, k = clock.now_ns(), 0
    while k < ticks and not (stop is not None and stop.is_set()):
        clock.sleep_until_ns(start + k * TICK_NS)
        now = clock.now_ns()
        writer.append(tick_rows(k, now, noise))
        writer.flush()
        each(now)
        k += 1


@contextmanager
def flying(folder: Path) -> Iterator[tuple[subprocess.Popen[str], list[int]]]:
    """A child that flies into `folder`, and the times of its ticks as it hands them over. It is killed at the end."""
    child = subprocess.Popen([sys.executable, __file__, str(folder)], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    told: list[int] = []

    def listen(out: Iterator[str]) -> None:
        told.extend(int(line) for line in out if line.endswith("\n"))

    listener = threading.Thread(target=listen, args=(child.stdout,))
    listener.start()
    try:
        while not told and child.poll() is None:
            time.sleep(0.01)
        yield child, told
    finally:
        child.kill()
        listener.join()
        child.stdout.close()
        child.wait()


@dataclass(frozen=True, slots=True)
class Ending:
    """How a flight ended: seconds lost of what had reached the station; ticks missing before that; its verdict."""

    lost_s: float
    holes: int
    verdict: str


def ending(folder: Path, last_ns: int) -> Ending:
    """Of the recording in `folder`, if the station's last tick was at `last_ns`. Without a file all is lost."""
    paths = sorted(folder.glob("*.mcap"), key=lambda p: len(p.name))
    if not paths:
        return Ending(math.inf, 0, "none")
    summary = summarise(paths[0])
    last = max((row.t_ns for row in read_rows(paths[0])), default=0)
    return Ending((last_ns - last) * 1e-9, summary.ticks_missed, summary.verdict)


def kill(folder: Path, seed: int) -> Ending:
    """kill -9 after up to 3 s of flight."""
    with flying(folder) as (child, told):
        time.sleep(random.Random(seed).uniform(0.3, 3.0))
        child.kill()
        child.wait()
    return ending(folder, told[-1])


def cut_on_ext4(work: Path, seed: int) -> Ending:
    """The power of an ext4 disk is cut after up to 5 s of flight; what its journal gives back is read."""
    image, disk = work / "disk.img", work / "disk"
    disk.mkdir(parents=True)
    with image.open("wb") as file:
        file.truncate(64 * 2**20)
    run("mkfs.ext4", "-q", str(image))
    run("mount", "-o", "loop", str(image), str(disk))
    try:
        with flying(disk / "logs") as (_, told):
            time.sleep(random.Random(seed).uniform(1.0, 5.0))
            folder = os.open(disk, os.O_RDONLY)
            fcntl.ioctl(folder, _SHUTDOWN, _NO_LOG_FLUSH)
            last = told[-1]
            os.close(folder)
    finally:
        unmount(disk)
    run("mount", "-o", "loop", str(image), str(disk))
    try:
        return ending(disk / "logs", last)
    finally:
        unmount(disk)
        image.unlink()


def unmount(disk: Path) -> None:
    """Now or, where the system is still busy with it, soon."""
    for _ in range(100):
        if subprocess.run(("umount", str(disk)), capture_output=True).returncode == 0:
            return
        time.sleep(0.1)
    run("umount", str(disk))


def run(*words: str) -> None:
    subprocess.run(words, check=True, capture_output=True)


def may_mount() -> bool:
    return os.geteuid() == 0 and Path("/dev/loop-control").exists() and shutil.which("mkfs.ext4") is not None


class Journal(Disk):
    """A disk that notes when what became safe, so that its power can be cut at any moment afterwards.

    A file outlasts a cut if a sync of its folder began after it was made and was over before the cut; of its bytes,
    those that were written before such a sync of itself began.
    """

    def __init__(self) -> None:
        super().__init__(SystemClock())
        self.clock = SystemClock()
        self.paths: dict[int, Path] = {}
        self.sizes: dict[Path, list[tuple[int, int]]] = {}
        """Time and size of each file as it grew."""
        self.safe: dict[Path, list[tuple[int, int]]] = {}
        """Time when so many of its bytes were safe."""
        self.entered: dict[Path, int] = {}
        """When a file's, or a folder's, entry was safe."""

    def create(self, path: Path) -> int:
        file = super().create(path)
        self.paths[file] = path
        self.sizes[path] = [(self.clock.now_ns(), 0)]
        self.safe[path] = []
        return file

    def write(self, file: int, data: memoryview) -> int:
        done = super().write(file, data)
        sizes = self.sizes[self.paths[file]]
        sizes.append((self.clock.now_ns(), sizes[-1][1] + done))
        return done

    def sync(self, file: int) -> None:
        path = self.paths[file]
        size = self.sizes[path][-1][1]
        super().sync(file)
        self.safe[path].append((self.clock.now_ns(), size))

    def sync_folder(self, folder: Path) -> None:
        there = list(folder.iterdir())
        super().sync_folder(folder)
        for path in there:
            self.entered.setdefault(path, self.clock.now_ns())

    def cut(self, file: int, size: int) -> None:
        raise AssertionError(f"nothing is cut back here: {file}, {size}")

    def left_at(self, t_ns: int, folder: Path, zeros: bool) -> None:
        """Write what a power cut at `t_ns` leaves into `folder`; some file systems put `zeros` for what they lost."""
        folder.mkdir()
        for path, safe in self.safe.items():
            if self.entered.get(path, math.inf) > t_ns or self.entered.get(path.parent, math.inf) > t_ns:
                continue
            size = max((n for t, n in safe if t <= t_ns), default=0)
            written = max(n for t, n in self.sizes[path] if t <= t_ns)
            (folder / path.name).write_bytes(path.read_bytes()[:size] + bytes(written - size if zeros else 0))


def main(folder: Path) -> None:
    writer = WriterThread(folder, about(), SystemClock(), lambda event: None)

    def tell(now: int) -> None:
        sys.stdout.write(f"{now}\n")
        sys.stdout.flush()

    fly(writer, math.inf, tell)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
