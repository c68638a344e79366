"""The recording survives what happens to it: kill -9, a full disk, a folder that goes away."""

from __future__ import annotations

import errno
import os
import random
import resource
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import MessageIndex

from station.clock import ManualClock
from station.conventions import Stream
from station.log import About, LogWriter, metadata, parts, read_rows, summarise, write_log
from station.log.part import PartWriter
from station.profile import load_aircraft
from station.rows import Code, Event, LogError, Rows, Sample, Tick

STREAM = Stream("boom.vanes", ("alpha_vane", "beta_vane"), 200.0, 0.1, "boom")
TICK_S = 0.02


def about() -> About:
    return About(load_aircraft("twin_otter"), (STREAM,))


class Flight:
    """A writer on a manual clock, fed `per_tick` samples and a tick each 20 ms."""

    def __init__(self, folder: Path, per_tick: int = 4, rotate_bytes: float | None = None) -> None:
        self.clock = ManualClock(10**9)
        self.events: list[Event] = []
        self.writer = LogWriter(folder, about(), self.clock, self.events.append, "flight", rotate_bytes)
        self.written: list[Rows] = []
        self._k, self._per_tick = 0, per_tick

    def fly(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK_S)):
            now = self.clock.now_ns()
            rows: list[Rows] = [
                Sample(now, "boom.vanes", now, self._k % 256, (self._k * 0.1, i * 0.3)) for i in range(self._per_tick)
            ]
            rows.append(Tick(now, self._k, now))
            self.writer.append(rows)
            self.writer.flush()
            self.written += rows
            self._k += 1
            self.clock.advance_s(TICK_S)


WRITER = """
import sys
import threading
from pathlib import Path
sys.path.insert(0, str(Path(sys.argv[1]).parent))
import test_log_writer as t
flight = t.Flight(Path(sys.argv[2]), int(sys.argv[3]))
while True:
    flight.fly(t.TICK_S)
    sys.stdout.write(f"{flight.written[-1].t_ns}\\n")
    sys.stdout.flush()
    flight.written.clear()
"""


@pytest.mark.parametrize(("per_tick", "seed"), [(1, 1), (1, 2), (20, 3), (20, 4), (200, 5)])
def test_a_kill_at_any_moment_loses_at_most_a_fifth_of_a_second(tmp_path: Path, per_tick: int, seed: int) -> None:
    child = subprocess.Popen(
        [sys.executable, "-c", WRITER, __file__, str(tmp_path), str(per_tick)], stdout=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    with child.stdout as out:
        recorded = [int(out.readline()) for _ in range(random.Random(seed).randint(20, 400))]
        child.kill()
        recorded += [int(line) for line in out if line.endswith("\n")]
    child.wait()
    path = tmp_path / "flight.mcap"
    last = max(row.t_ns for row in read_rows(path))
    assert (recorded[-1] - last) * 1e-9 <= 0.1
    summary = summarise(path)
    assert summary.verdict == "truncated"
    assert summary.ticks_missed == 0


def test_more_rows_in_a_tick_than_are_held_are_no_loss(tmp_path: Path) -> None:
    """A loop that was away for a second on a rig of 32 streams at 1 kHz."""
    flight = Flight(tmp_path, per_tick=32_000)
    flight.fly(0.04)
    flight.writer.close()
    assert flight.writer.rows_lost == 0
    assert list(read_rows(flight.writer.path)) == flight.written


def test_what_is_flushed_is_in_the_file_without_close(tmp_path: Path) -> None:
    flight = Flight(tmp_path)
    flight.fly(5.0)
    last = max(row.t_ns for row in read_rows(flight.writer.path))
    assert (flight.written[-1].t_ns - last) * 1e-9 <= 0.08
    flight.writer.close()
    assert list(read_rows(flight.writer.path)) == flight.written


def test_rotation_leaves_complete_files_that_read_as_one(tmp_path: Path) -> None:
    flight = Flight(tmp_path, per_tick=40, rotate_bytes=60_000)
    flight.fly(20.0)
    flight.writer.close()
    files = parts(tmp_path / "flight.mcap")
    assert [p.name for p in files[:3]] == ["flight.mcap", "flight.0001.mcap", "flight.0002.mcap"]
    assert list(read_rows(tmp_path / "flight.mcap")) == flight.written
    summary = summarise(tmp_path / "flight.mcap")
    assert (summary.verdict, summary.files, summary.ticks_missed) == ("complete", len(files), 0)
    assert summary.bytes == flight.writer.bytes_written == sum(p.stat().st_size for p in files)
    for path in files:
        assert summarise(path).verdict == "complete"
        assert metadata(path).aircraft == about().aircraft
        assert path.stat().st_size < 110_000
    alone = list(read_rows(files[1]))
    assert alone
    assert len(alone) < len(flight.written)


@pytest.mark.parametrize("rotate_bytes", range(20_000, 60_000, 4_000))
def test_rotation_is_no_loss_whenever_the_file_is_looked_after(tmp_path: Path, rotate_bytes: int) -> None:
    """A file that ends in the very tick in which it is looked after must not be taken for one that vanished."""
    flight = Flight(tmp_path, per_tick=40, rotate_bytes=rotate_bytes)
    flight.fly(6.0)
    flight.writer.close()
    assert flight.events == []
    assert summarise(tmp_path / "flight.mcap").verdict == "complete"
    assert list(read_rows(tmp_path / "flight.mcap")) == flight.written


def test_the_end_of_a_full_file_keeps_no_tick_waiting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its index, of half a gigabyte of recording, is written while the next file records."""
    may_end, finish = threading.Event(), PartWriter.finish

    def when_allowed(part: PartWriter, *, sync: bool) -> None:
        assert may_end.wait(60)
        finish(part, sync=sync)

    monkeypatch.setattr(PartWriter, "finish", when_allowed)
    flight = Flight(tmp_path, per_tick=40, rotate_bytes=60_000)
    try:
        flight.fly(3.0)
        assert flight.writer.path.name == "flight.0002.mcap"
        assert flight.writer.bytes_written > 120_000
    finally:
        may_end.set()
        flight.writer.close()
    assert flight.events == []
    assert summarise(tmp_path / "flight.mcap").verdict == "complete"
    assert list(read_rows(tmp_path / "flight.mcap")) == flight.written


def test_a_recording_is_never_overwritten(tmp_path: Path) -> None:
    first = Flight(tmp_path)
    first.fly(0.2)
    first.writer.close()
    before = first.writer.path.read_bytes()
    with pytest.raises(LogError, match=r"flight\.mcap: exists already"):
        Flight(tmp_path)
    with pytest.raises(LogError, match="exists already"):
        write_log(first.writer.path, about(), [Tick(0, 0, 0)])
    assert first.writer.path.read_bytes() == before


def test_two_flights_in_one_second_get_two_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("station.log.writer.utc_file_stamp", lambda: "20260102T030405Z")
    writers = [LogWriter(tmp_path, about(), ManualClock(), lambda event: None) for _ in range(3)]
    assert [w.path.name for w in writers] == [
        "20260102T030405Z.mcap",
        "20260102T030405Z-2.mcap",
        "20260102T030405Z-3.mcap",
    ]
    for writer in writers:
        writer.close()


def test_rotation_steps_over_a_file_that_is_in_the_way(tmp_path: Path) -> None:
    flight = Flight(tmp_path, per_tick=40, rotate_bytes=40_000)
    stranger = tmp_path / "flight.0001.mcap"
    stranger.write_bytes(b"someone else's")
    flight.fly(10.0)
    flight.writer.close()
    assert stranger.read_bytes() == b"someone else's"
    assert list(read_rows(tmp_path / "flight.mcap")) == flight.written


@contextmanager
def full_disk(monkeypatch: pytest.MonkeyPatch, room: int) -> Iterator[None]:
    """os.write takes `room` bytes more, then says the disk is full."""
    left = [room]
    real = os.write

    def write(fd: int, data: bytes) -> int:
        if left[0] <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        done = real(fd, data[: left[0]])
        left[0] -= done
        return done

    with monkeypatch.context() as patch:
        patch.setattr("station.log.disk.os.write", write)
        yield


def test_a_full_disk_is_an_alarm_and_the_flight_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flight = Flight(tmp_path, per_tick=20)
    flight.fly(1.0)
    with full_disk(monkeypatch, room=3_000):
        flight.fly(2.0)
        assert [e.code for e in flight.events] == [Code.DISK]
        assert "No space left on device" in flight.events[0].detail
        assert flight.writer.failed
        assert [p.name for p in tmp_path.iterdir()] == ["flight.mcap"]
    flight.fly(2.0)
    assert not flight.writer.failed
    assert flight.writer.path.name == "flight.0001.mcap"
    assert flight.events[-1].detail == "recording again in flight.0001.mcap"
    flight.writer.close()
    # Two seconds of rows were kept in memory, so nothing is missing; the file before still says that it ends early.
    assert list(read_rows(tmp_path / "flight.mcap")) == flight.written
    summary = summarise(tmp_path / "flight.mcap")
    assert (summary.verdict, summary.ticks_missed) == ("truncated", 0)


def test_a_disk_full_for_long_loses_the_oldest_rows_and_says_how_many(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flight = Flight(tmp_path, per_tick=49)
    flight.fly(1.0)
    with full_disk(monkeypatch, room=0):
        flight.fly(10.0)
    flight.fly(2.0)
    flight.writer.close()
    read = list(read_rows(tmp_path / "flight.mcap"))
    lost = len(flight.written) - len(read)
    assert lost > 0
    assert f"{lost} rows lost" in flight.events[-1].detail
    summary = summarise(tmp_path / "flight.mcap")
    assert summary.verdict == "truncated"
    assert summary.seconds_lost == pytest.approx(summary.ticks_missed * TICK_S, abs=0.05)


def test_a_file_size_limit_of_the_system_starts_the_next_file(tmp_path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    flight = Flight(tmp_path, per_tick=40)
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, hard))
    try:
        flight.fly(8.0)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    flight.writer.close()
    assert flight.events
    assert list(read_rows(tmp_path / "flight.mcap")) == flight.written


def test_a_vanished_folder_is_made_again(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    flight = Flight(folder)
    flight.fly(2.0)
    shutil.rmtree(folder)
    flight.fly(2.0)
    assert "vanished" in flight.events[0].detail
    flight.writer.close()
    read = list(read_rows(flight.writer.path))
    assert read == flight.written[-len(read) :]
    assert len(read) * TICK_S / 5 >= 1.7


def test_a_renamed_folder_keeps_a_complete_first_file(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    flight = Flight(folder)
    flight.fly(2.0)
    folder.rename(tmp_path / "elsewhere")
    flight.fly(2.0)
    flight.writer.close()
    assert summarise(tmp_path / "elsewhere" / "flight.mcap").problems == ["not here: the file after flight.mcap"]
    assert [
        *read_rows(tmp_path / "elsewhere" / "flight.mcap"),
        *read_rows(folder / "flight.0001.mcap"),
    ] == flight.written


def test_a_folder_that_cannot_be_made_again_is_tried_once_a_second(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "logs"
    flight = Flight(folder)
    flight.fly(1.0)
    shutil.rmtree(folder)
    folder.write_text("in the way")
    tries: list[Path] = []
    real = Path.mkdir

    def mkdir(self: Path, mode: int = 0o777, parents: bool = False, exist_ok: bool = False) -> None:
        tries.append(self)
        real(self, mode, parents, exist_ok)

    monkeypatch.setattr(Path, "mkdir", mkdir)
    flight.fly(5.0)
    assert 4 <= len(tries) <= 6
    folder.unlink()
    flight.fly(2.0)
    assert not flight.writer.failed
    flight.writer.close()
    assert summarise(flight.writer.path).problems == ["not here: flight.mcap"]


def test_a_row_that_cannot_be_written_is_reported_and_left_out(tmp_path: Path) -> None:
    flight = Flight(tmp_path)
    flight.writer.append([Tick(1, "x" * 3, object())])  # type: ignore[arg-type]
    flight.fly(0.2)
    flight.writer.close()
    assert "cannot be recorded" in flight.events[0].detail
    assert list(read_rows(flight.writer.path)) == flight.written


def test_a_folder_that_cannot_be_written_is_an_error_before_the_flight(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(LogError, match="cannot record there"):
        LogWriter(tmp_path / "file" / "logs", about(), ManualClock(), lambda event: None)


def test_closing_twice_does_nothing(tmp_path: Path) -> None:
    flight = Flight(tmp_path)
    flight.fly(0.1)
    flight.writer.close()
    size = flight.writer.path.stat().st_size
    flight.writer.close()
    assert flight.writer.path.stat().st_size == size


def test_the_index_leads_to_every_message(tmp_path: Path) -> None:
    """As a player that seeks by channel and time goes: chunk index, message index, message."""
    flight = Flight(tmp_path)
    flight.fly(3.0)
    flight.writer.close()
    with flight.writer.path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        found = 0
        for index in summary.chunk_indexes:
            end = 0
            for channel, place in index.message_index_offsets.items():
                file.seek(place)
                stream = ReadDataStream(file)
                assert stream.read1() == Opcode.MESSAGE_INDEX
                length = stream.read8()
                entries = MessageIndex.read(stream)
                assert entries.channel_id == channel
                found += len(entries.records)
                end = place + 9 + length
            first = index.chunk_start_offset + index.chunk_length
            assert (min(index.message_index_offsets.values()), end) == (first, first + index.message_index_length)
    assert found == summary.statistics.message_count == len(flight.written)
