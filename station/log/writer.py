"""The writer that a flight depends on: a kill costs it a few ticks at most, and trouble with the disk is an event."""

from __future__ import annotations

import math
import queue
import threading
import uuid
from collections import deque
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Final

from station.clock import Clock, SystemClock, utc_file_stamp, utc_now_ns
from station.log.about import About, closing, preamble
from station.log.counts import Counts
from station.log.disk import Disk, make_folder, name_of_disk
from station.log.messages import RowWriter
from station.log.part import PartWriter
from station.rows import Code, Event, LogError, Rows, Sample

# Measured with tests/benchmarks/test_log_cost.py's tick (22 rows, values of pure noise) on 2 shared cores, mean and p99
# cost of a tick, bytes a tick: without chunks 67, 110 us, 7.4 kB; a chunk each tick 129, 230 us, 3.6 kB; 16 KiB 109,
# 207 us, 3.0 kB; 32 KiB 103, 210 us, 2.9 kB. Without chunks a kill would lose nothing, but there would be no checksum
# before the end of the file and 1.3 GB an hour. So: zstd chunks, closed when full or when their oldest row has waited
# 60 ms, which costs a killed flight at most 80 ms of rows, and 0.15 s with what waits for the thread that writes.
CHUNK_BYTES: Final = 32 * 1024
CHUNK_NS: Final = 60_000_000
RETRY_NS: Final = 1_000_000_000
SYNC_NS: Final = 1_000_000_000
"""Between syncs: a power cut costs what was written since, 1.5 s at most (disk.STALL_NS). A sync of a second's 150 kB
takes some ms on an SSD and up to 0.1 s on an SD card."""
_LOOK_NS: Final = 200_000_000
ROWS_OF_A_CHUNK: Final = 500
"""At most, even where each is a datagram of 64 kB: readers refuse chunks of more than 64 MiB."""
_HELD_ROWS: Final = 5_000
"""Rows kept while no file can be written: 4 s of a busy flight, re-encoded in some 40 ms when a disk is back."""


class Aside:
    """Carries out one thing after another in a thread of its own: what a thread that records is not to wait for."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._things: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None

    def put(self, thing: Callable[[], None]) -> None:
        if self._thread is None:
            # A daemon: a disk that never answers is not to keep the station from ending.
            self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
            self._thread.start()
        self._things.put(thing)

    def _run(self) -> None:
        while (thing := self._things.get()) is not None:
            thing()

    def close(self) -> None:
        """Return when all is done."""
        if self._thread is not None:
            self._things.put(None)
            self._thread.join()
            self._thread = None


class LogWriter:
    """Records a flight. After construction nothing here raises: trouble is a DISK event, and rows are kept for a while.

    Call `append` whenever there are rows and `flush` once a tick, from one thread. It waits for the disk to take what
    is written, but not for syncs: one a second, and one at the end of a file. While no file can be written a new one is
    tried at most once a second; `failed` then says why, else it is empty. `path` is the file being written,
    `bytes_written` the sum over the flight's files, `rows_lost` counts rows that are in none of them.
    """

    def __init__(
        self,
        folder: Path,
        about: About,
        clock: Clock,
        on_event: Callable[[Event], None],
        name: str | None = None,
        rotate_bytes: float | None = None,
        disk: Disk | None = None,
    ) -> None:
        """Raises LogError if the first file cannot be made. `name`, without .mcap, is the start in UTC if left out."""
        self._about, self._clock, self._on_event = about, clock, on_event
        self._disk = disk if disk is not None else Disk(clock)
        card_limit = about.card.rotate if about.card is not None else math.inf
        self._rotate_bytes = rotate_bytes if rotate_bytes is not None else card_limit
        self._folder = folder
        self._flight = uuid.uuid4().hex
        self._station_ns, self._utc_ns = clock.now_ns(), utc_now_ns()
        self._rows = RowWriter(about.streams, about.further.own)
        self._held: deque[Rows] = deque(maxlen=_HELD_ROWS)
        self._lost = self._unwritable = 0
        self.rows_lost = 0
        self._number = 0
        self._parts: list[PartWriter] = []
        self._counts: dict[PartWriter, Counts] = {}
        self._aside = Aside("syncing of a recording")
        self._is_syncing = False
        self._unsynced = ""
        self._opened_ns: int | None = None
        self._look_ns = self._retry_ns = self._sync_ns = self._station_ns
        stem = name if name is not None else utc_file_stamp()
        try:
            make_folder(folder, self._disk)
            self._stem, first = self._first(stem, exact=name is not None)
        except FileExistsError:
            raise LogError(f"{folder / stem}.mcap: exists already, and a recording is never overwritten") from None
        except OSError as error:
            raise LogError(f"{folder}: cannot record there: {error.strerror}\nuse another folder: --log") from error
        self._part: PartWriter | None = None
        self.first = first.path
        self._use(first)

    def _first(self, stem: str, exact: bool) -> tuple[str, PartWriter]:
        tried, n = stem, 1
        while True:
            try:
                if not any(self._folder.glob(f"{tried}.[0-9]*.mcap")):
                    return tried, self._new_part(self._folder / f"{tried}.mcap")
            except FileExistsError:
                if exact:
                    raise
            n += 1
            tried = f"{stem}-{n}"

    def _new_part(self, path: Path) -> PartWriter:
        about = preamble(self._about, self._flight, self._number, self._station_ns, self._utc_ns)
        counts = Counts.of(self._about.streams)
        part = PartWriter(path, self._disk, *about, partial(closing, counts))
        self._counts[part] = counts
        return part

    def _next(self) -> PartWriter:
        make_folder(self._folder, self._disk)
        before = self._number
        while True:
            self._number += 1
            try:
                return self._new_part(self._folder / f"{self._stem}.{self._number:04d}.mcap")
            except FileExistsError:
                continue
            except OSError:
                self._number = before
                raise

    @property
    def bytes_written(self) -> int:
        return sum(part.size for part in self._parts)

    def append(self, rows: Iterable[Rows]) -> None:
        rows = list(rows)
        for at in range(0, len(rows), ROWS_OF_A_CHUNK):
            self._append(rows[at : at + ROWS_OF_A_CHUNK])

    def _append(self, rows: list[Rows]) -> None:
        held, before = self._held, len(self._held)
        held.extend(rows)
        lost = before + len(rows) - len(held)
        self._lost += lost
        self.rows_lost += lost
        part = self._part
        if part is not None:
            self._write(part, rows)
            # Rows are held until their chunk is written: it ends before one would have to be let go.
            if part.chunk_size >= CHUNK_BYTES or len(held) > _HELD_ROWS - ROWS_OF_A_CHUNK:
                self._close_chunk(part)

    def _write(self, part: PartWriter, rows: Iterable[Rows]) -> None:
        encode, count = self._rows.message, self._counts[part].add
        messages = []
        for row in rows:
            try:
                topic, data = encode(row)
            except Exception as error:  # whatever a row holds, the flight goes on without it
                self._unwritable += 1
                self.rows_lost += 1
                if self._unwritable == 1:
                    self._report(f"a {type(row).__name__} cannot be recorded: {error}")
                continue
            count(row)
            t_ns = row.t_ns
            messages.append((topic, (row.seq or 0) if type(row) is Sample else 0, t_ns if t_ns > 0 else 0, data))
        part.add(messages)

    def flush(self) -> None:
        """Once a tick: what is old enough goes to the operating system, and the file is looked after."""
        now = self._clock.now_ns()
        part = self._part
        if part is None:
            if now >= self._retry_ns:
                self._reopen(now)
            return
        if part.chunk_size:
            if self._opened_ns is None:
                self._opened_ns = now
            # A tick early rather than late: the next look is 20 ms away.
            if now - self._opened_ns >= CHUNK_NS - 20_000_000:
                self._close_chunk(part)
        part = self._part  # another one, if closing the chunk ended the file
        if part is not None and now >= self._look_ns:
            self._look_ns = now + _LOOK_NS
            if not part.is_there():
                self._part = None
                self._counts[part].goes_on = True
                # Renamed, it can still be completed where it is now; removed, what is in memory goes to the next.
                elsewhere = part.is_linked()
                if self._end(part) and elsewhere:
                    self._held.clear()
                else:
                    self.rows_lost += part.messages
                self._fail(f"{part.path} has vanished", now)
                return
        if part is not None and now >= self._sync_ns and not self._is_syncing:
            self._sync_ns, self._is_syncing = now + SYNC_NS, True
            self._aside.put(partial(self._sync, part))

    def _sync(self, part: PartWriter) -> None:
        try:
            part.sync()
        except OSError as error:
            # The system forgets what it could not write, and later syncs succeed: there may be a hole from here on.
            if not self._unsynced:
                self._unsynced = f"{name_of_disk(self._folder)}: {error.strerror} while syncing {part.path}"
                self._report(f"{self._unsynced}; flying on, the file may not be whole")
        self._is_syncing = False

    def _close_chunk(self, part: PartWriter) -> None:
        try:
            part.close_chunk()
            self._held.clear()
            self._opened_ns = None
            if part.size >= self._rotate_bytes:
                self._part = None
                self._counts[part].goes_on = True
                # The index of a large file takes longer to write than a chunk may wait.
                self._aside.put(partial(self._complete, part))
                self._use(self._next())
                self._sync_ns = self._clock.now_ns()
        except OSError as error:
            if self._part is not None:
                if part.is_gone():
                    self.rows_lost += part.messages
                part.abandon()
            self._part = None
            self._fail(f"{part.path}: {error.strerror}", self._clock.now_ns())

    def _use(self, part: PartWriter) -> None:
        self._parts.append(part)
        self._part, self.path, self.failed = part, part.path, ""

    def _end(self, part: PartWriter) -> bool:
        try:
            part.finish(sync=True)
        except OSError:
            part.abandon()
            return False
        return True

    def _complete(self, part: PartWriter) -> None:
        if not self._end(part):
            self._unsynced = f"{part.path}: could not be completed"
            self._report(f"{self._unsynced}: see station recover")

    def _fail(self, why: str, now: int) -> None:
        self._opened_ns = None
        self.failed = why
        self._report(f"{why}; flying on, recording tried again each second")
        if now >= self._retry_ns:
            self._reopen(now)

    def _reopen(self, now: int) -> None:
        self._retry_ns = now + RETRY_NS
        lost, number = self._lost, self._number
        try:
            part = self._next()
        except OSError as error:
            self.failed = f"{self._folder}: {error.strerror}"
            return
        rows = list(self._held)
        try:
            for at in range(0, len(rows), ROWS_OF_A_CHUNK):
                self._write(part, rows[at : at + ROWS_OF_A_CHUNK])
                part.close_chunk()
        except OSError as error:
            part.abandon()
            part.path.unlink(missing_ok=True)
            self._number = number
            self.failed = f"{part.path}: {error.strerror}"
            return
        self._held.clear()
        self._lost = 0
        self._use(part)
        if lost:
            why = "rows lost: no file could be written for too long"
            self._on_event(Event(self._clock.now_ns(), "log", Code.DROPPED, lost, why))
        self._report(f"recording again in {part.path.name}" + (f", {lost} rows lost" if lost else ""))

    def _report(self, detail: str) -> None:
        self._on_event(Event(self._clock.now_ns(), "log", Code.DISK, 1, detail))

    def close(self) -> None:
        """Complete the file. Calling it again does nothing."""
        if self._part is None and self.failed:
            self._retry_ns = self._clock.now_ns()
            self._reopen(self._retry_ns)
        part, self._part = self._part, None
        if part is not None and not self._end(part):
            self.failed = f"{part.path}: could not be completed"
            self._report(self.failed)
        self._aside.close()
        self.failed = self._unsynced or self.failed


def write_log(path: Path, about: About, rows: Iterable[Rows], station_ns: int = 0, utc_ns: int = 0) -> int:
    """Write rows into a new recording and say how many. Raises LogError, and then leaves no file."""
    writer, counts, count = RowWriter(about.streams, about.further.own), Counts.of(about.streams), 0
    try:
        make_folder(path.parent)
        head = preamble(about, uuid.uuid4().hex, 0, station_ns, utc_ns)
        part = PartWriter(path, Disk(SystemClock()), *head, partial(closing, counts))
    except FileExistsError:
        raise LogError(f"{path}: exists already, and a recording is never overwritten") from None
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error.strerror}") from error
    try:
        for row in rows:
            topic, data = writer.message(row)
            counts.add(row)
            part.add([(topic, (row.seq or 0) if type(row) is Sample else 0, max(row.t_ns, 0), data)])
            count += 1
            if part.chunk_size >= CHUNK_BYTES:
                part.close_chunk()
        part.finish()
    except BaseException as error:
        part.abandon()
        path.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise LogError(f"{path}: cannot be written: {error.strerror}") from error
        raise
    return count
