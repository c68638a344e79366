"""Rows read by a file's index are those that reading all of it gives, whole, cut or damaged; mcap's reader agrees."""

from __future__ import annotations

import errno
import io
import math
import random
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from station.clock import ManualClock
from station.conventions import SIGNALS, Stream
from station.log import About, LogWriter, points, read_rows, row_times, spill, table, write_log
from station.log.disk import Disk
from station.profile import load_aircraft
from station.rows import Code, Event, Frame, LogError, Rows, Sample, Tick

ABOUT = About(load_aircraft("twin_otter"), (Stream("box.vanes", ("alpha_vane", "beta_vane"), 200.0, 0.2),))
ZERO = 5 * 10**9
TICK = 20_000_000


def rows_of(ticks: int) -> list[Rows]:
    noise, made = random.Random(4), list[Rows]()
    for k in range(ticks):
        t = ZERO + k * TICK
        made += [Sample(t + i, "box.vanes", None, k, (noise.random(), noise.random())) for i in range(4)]
        made.append(Tick(t + 5, k, t))
        made.append(Frame(t, k, tuple(noise.random() for _ in SIGNALS), (0.0,) * len(SIGNALS), (0,) * len(SIGNALS)))
        if k % 100 == 20:
            made.append(Event(t, "operator", Code.POINT_START, k // 100))
        if k % 100 == 80:
            made.append(Event(t, "operator", Code.POINT_END, k // 100))
    return made


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """In three files, their chunks closed by time as in flight."""
    clock = ManualClock(ZERO)
    writer = LogWriter(tmp_path_factory.mktemp("index"), ABOUT, clock, print, "flight", 60_000, Disk(clock))
    for row in rows_of(1000):
        writer.append([row])
        if isinstance(row, Tick):
            writer.flush()
            clock.sleep_until_ns(row.t_ns + TICK)
    writer.close()
    return writer.path.with_name("flight.mcap")


SPANS = [(ZERO, ZERO), (ZERO + 3 * TICK, ZERO + 400 * TICK + 7), (0, ZERO - 1), (ZERO + 900 * TICK, 2**62)]


@pytest.mark.parametrize("span", SPANS)
def test_a_span_is_what_all_of_it_has_there(flight: Path, span: tuple[int, int]) -> None:
    assert len(list(flight.parent.glob("*.mcap"))) > 2
    expected = [row for row in read_rows(flight) if span[0] <= row.t_ns <= span[1]]
    assert list(read_rows(flight, None, span)) == expected
    frames = [row for row in expected if isinstance(row, Frame)]
    assert list(read_rows(flight, (Frame,), span)) == frames


@pytest.mark.parametrize("span", SPANS)
def test_mcaps_own_reader_finds_as_much(tmp_path: Path, span: tuple[int, int]) -> None:
    path = tmp_path / "a.mcap"
    write_log(path, ABOUT, rows_of(1000))
    with path.open("rb") as file:
        theirs = [m.log_time for _, _, m in make_reader(file).iter_messages(["/frame"])]
    assert [row.t_ns for row in read_rows(path, (Frame,), span)] == [t for t in theirs if span[0] <= t <= span[1]]
    assert row_times(path, Frame).tolist() == [ZERO + k * TICK for k in range(1000)]


@pytest.mark.parametrize("room", [math.inf, 0, 1000])
def test_an_index_set_aside_during_the_flight_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: float
) -> None:
    """On a disk that has room for it, for none of it, and for the first of it."""
    files = []

    class Aside(io.FileIO):
        def write(self, data: Any) -> int:
            if self.tell() + len(data) > room:
                super().write(bytes(data)[:10])
                raise OSError(errno.ENOSPC, "No space left on device")
            return super().write(data)

    def one(**_: Any) -> io.FileIO:
        files.append(tmp_path / f"aside{len(files)}")
        return Aside(files[-1], "w+")

    monkeypatch.setattr(spill, "MOST_HELD", 300)
    monkeypatch.setattr(tempfile, "TemporaryFile", one)
    path = tmp_path / "a.mcap"
    write_log(path, ABOUT, rows_of(1000))
    (aside,) = files
    assert (aside.stat().st_size > 3000) == (room > 3000)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert len(summary.chunk_indexes) == summary.statistics.chunk_count > 10
        theirs = [m.log_time for _, _, m in make_reader(file).iter_messages(["/frame"])]
    assert theirs == [ZERO + k * TICK for k in range(1000)]
    assert row_times(path, Frame).tolist() == theirs


@pytest.mark.parametrize("end", [0.4, 0.9, 0.999])
def test_a_cut_file_has_no_index_and_is_read_all_the_same(tmp_path: Path, end: float) -> None:
    write_log(tmp_path / "a.mcap", ABOUT, rows_of(400))
    data = (tmp_path / "a.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(end * len(data))])
    there = list(read_rows(cut))
    span = (ZERO + 10 * TICK, ZERO + 300 * TICK)
    assert list(read_rows(cut, (Frame,), span)) == [
        r for r in there if isinstance(r, Frame) and span[0] <= r.t_ns <= span[1]
    ]
    assert row_times(cut, Tick).tolist() == [r.t_ns for r in there if isinstance(r, Tick)]


@pytest.mark.parametrize("seed", range(30))
def test_a_wrong_byte_gives_no_wrong_row(tmp_path: Path, seed: int) -> None:
    """Anywhere, the index too: what the index leads to carries checksums of its own."""
    write_log(tmp_path / "a.mcap", ABOUT, rows_of(300))
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    sound = {repr(r) for r in read_rows(tmp_path / "a.mcap")}
    data[random.Random(seed).randrange(8, len(data))] ^= 0x40
    hurt = tmp_path / "hurt.mcap"
    hurt.write_bytes(data)
    found = [repr(r) for r in read_rows(hurt, (Frame, Sample, Tick, Event), (0, 2**62))]
    assert set(found) <= sound
    assert len(found) == len(set(found))
    assert set(found) >= {repr(r) for r in read_rows(hurt)}


def test_a_table_of_a_span_is_that_part_of_the_whole(flight: Path) -> None:
    whole, part = table(flight), table(flight, (4.0, 6.0))
    expected = whole.between(4.0, 6.0)
    assert part.t0_ns == whole.t0_ns
    assert np.array_equal(part.t_s, expected.t_s)
    assert all(np.array_equal(part.columns[n], expected.columns[n]) for n in SIGNALS)
    assert [(p.n, p.start_s, p.end_s) for p in points(flight)][:2] == [
        (0, pytest.approx(0.4), pytest.approx(1.6)), (1, pytest.approx(2.4), pytest.approx(3.6)),
    ]  # fmt: skip
    with pytest.raises(LogError, match="nothing from 100 to 200 s"):
        table(flight, (100.0, 200.0))
