"""The thread that records: a disk that does not answer costs the flight no tick, and rows only when memory is full."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Final

from station.clock import Clock
from station.log.about import About
from station.log.disk import Disk, name_of_disk
from station.log.writer import CHUNK_NS, LogWriter
from station.rows import Code, Event, RawBlock, Rows

QUEUE_BYTES: Final = 64 * 2**20
"""What may wait for the disk: two and a half minutes of the bench's flight (25 rows and 0.4 kB of raw bytes a tick)."""
ROW_BYTES: Final = 320
"""What a row takes in memory: sys.getsizeof of a Sample of three values, its tuple, floats and integers."""
TOLD_NS: Final = 1_000_000_000
"""A disk that has not answered for so long is an alarm while it lasts; from disk.STALL_NS on it is told afterwards."""
TELL_EVERY_NS: Final = 5_000_000_000
"""Of a disk that is late each second only so often."""
END_S: Final = 60.0
"""How long the end of a flight waits for a disk: SD cards were seen to stall for 2 s, disks that wake up for 10 s."""


class WriterThread:
    """A LogWriter's duties, done by a thread of its own. After construction nothing raises and nothing waits.

    Call `append` whenever there are rows and `flush` once a tick, from one thread.
    """

    def __init__(
        self,
        folder: Path,
        about: About,
        clock: Clock,
        on_event: Callable[[Event], None],
        disk: Disk | None = None,
        rotate_bytes: float | None = None,
        queue_bytes: int = QUEUE_BYTES,
    ) -> None:
        """Raises LogError if the first file cannot be made."""
        self._disk = disk if disk is not None else Disk(clock)
        self._writer = LogWriter(folder, about, clock, on_event, None, rotate_bytes, self._disk)
        self._clock, self._on_event, self._most = clock, on_event, queue_bytes
        self._disk_name = name_of_disk(folder)
        self._batch: list[Rows] = []
        self._batches: queue.SimpleQueue[tuple[list[Rows], int] | None] = queue.SimpleQueue()
        # Each is counted by one thread alone; what waits is the difference.
        self._given = self._taken = 0
        self._shed = self._shed_before = 0
        self._is_told = False
        self._tell_ns = clock.now_ns()
        self._gave_up = ""
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    @property
    def path(self) -> Path:
        """The file that is being written."""
        return self._writer.path

    @property
    def recording(self) -> Path:
        """The file by which the whole recording is named: its first; where that has gone, the one being written."""
        return first if (first := self._writer.first).exists() else self.path

    @property
    def bytes_written(self) -> int:
        return self._writer.bytes_written

    @property
    def rows_lost(self) -> int:
        """Rows that are in no file: memory was full, or they could not be written."""
        return self._shed_before + self._shed + self._writer.rows_lost

    @property
    def failed(self) -> str:
        """Why the recording is not whole; empty while it is."""
        return self._gave_up or self._writer.failed

    def append(self, rows: Iterable[Rows]) -> None:
        self._batch += rows

    def flush(self) -> None:
        """Hand over what has been appended, and say how the disk does."""
        batch, self._batch = self._batch, []
        if batch:
            self._hand_over(batch)
        now, unanswered_ns = self._clock.now_ns(), self._disk.unanswered_ns()
        if unanswered_ns > TOLD_NS and not self._is_told:
            self._is_told = True
            self._say(f"{self._disk_name} has not answered for {unanswered_ns * 1e-9:.1f} s; rows wait in memory")
        elif unanswered_ns <= TOLD_NS and (self._is_told or now >= self._tell_ns):
            late_ns = self._disk.late_answers_ns()
            if late_ns:
                self._is_told, self._tell_ns = False, now + TELL_EVERY_NS
                took_s, lost = max(late_ns) * 1e-9, f"{self._shed} rows lost so far" if self._shed else "no row lost"
                self._say(f"recording again: {self._disk_name} answered after {took_s:.1f} s; {lost}", len(late_ns))

    def _hand_over(self, batch: list[Rows]) -> None:
        size = _size(batch)
        waiting = self._given - self._taken
        # Once full, half of it must be empty before rows are taken again: rather one long gap than many.
        if waiting + size > (self._most // 2 if self._shed else self._most):
            if not self._shed:
                self._say(
                    f"{self._disk_name} does not keep up: {waiting / 2**20:.0f} MiB wait for it, rows are being lost"
                )
            self._shed += len(batch)
            return
        if self._shed:
            self._tell_loss()
            self._shed_before, self._shed = self._shed_before + self._shed, 0
        self._given += size
        self._batches.put((batch, size))

    def _tell_loss(self) -> None:
        words = f"{self._disk_name} did not keep up"
        self._on_event(Event(self._clock.now_ns(), "log", Code.DROPPED, self._shed, f"rows lost: {words}"))
        self._say(f"recording again, {self._shed} rows lost: {words}")

    def _say(self, words: str, count: int = 1) -> None:
        self._on_event(Event(self._clock.now_ns(), "log", Code.DISK, count, words))

    def _run(self) -> None:
        while True:
            try:
                taken = self._batches.get(timeout=CHUNK_NS * 1e-9)
            except queue.Empty:  # the loop is away: what it gave must not wait for it
                self._writer.flush()
                continue
            if taken is None:
                break
            batch, size = taken
            self._writer.append(batch)
            self._writer.flush()
            self._taken += size
        self._writer.close()

    def close(self) -> None:
        """Complete the file, waiting END_S at most for the disk. Calling it again does nothing."""
        if self._gave_up or not self._thread.is_alive():
            return
        self.flush()
        self._batches.put(None)
        self._thread.join(END_S)
        if self._thread.is_alive():
            self._gave_up = f"{self._disk_name} has not answered for {END_S:.0f} s; {self.path} lacks the last rows"
            self._say(self._gave_up)


def _size(rows: Sequence[Rows]) -> int:
    return ROW_BYTES * len(rows) + sum(len(row.data) for row in rows if type(row) is RawBlock)
