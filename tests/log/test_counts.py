"""Counts that a file ends with are those of its rows, of one and of several files; of a hurt one they are made anew."""

from __future__ import annotations

import random
from dataclasses import asdict
from pathlib import Path

import pytest

import station.log.summary
from station.clock import ManualClock
from station.conventions import TICK_NS, Stream
from station.log import About, LogWriter, summarise, write_log
from station.log.disk import Disk
from station.profile import load_aircraft
from station.rows import Code, Event, MethodEstimate, Rows, Sample, Tick

ABOUT = About(
    load_aircraft("twin_otter"), (Stream("a.b", ("q",), 50.0, 0.2, "a"), Stream("a.silent", ("p",), 10.0, 1.0, "a"))
)


def rows(seed: int) -> list[Rows]:
    """Gaps, dropouts, missed ticks, repeated and numbered events; device times that wander and step back."""
    dice, made, k, device = random.Random(seed), list[Rows](), 0, 10**12
    for _ in range(2000):
        k += 1 if dice.random() > 0.02 else dice.randrange(2, 30)
        t = k * TICK_NS
        device += TICK_NS if dice.random() > 0.01 else dice.choice((-TICK_NS, 2 * TICK_NS, 40 * TICK_NS))
        made.append(Tick(t, k, t))
        if dice.random() > 0.05:
            made.append(Sample(t, "a.b", device, k % 256, (dice.random(),)))
        if dice.random() > 0.98:
            made.append(
                Event(t, "a", dice.choice((Code.CRC, Code.POINT_START, Code.DROPPED)), dice.randrange(1, 9), "x")
            )
        if dice.random() > 0.9:
            made.append(MethodEstimate(t, dice.choice(("II", "split")), ()))
    return made


def counted_anew(path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, object]:
    """The summary made of the rows themselves."""
    with monkeypatch.context() as patched:
        patched.setattr(station.log.summary, "counts_of", lambda _: None)
        return asdict(summarise(path))


@pytest.mark.parametrize("seed", range(4))
def test_counts_are_those_of_the_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    path = tmp_path / "a.mcap"
    made = rows(seed)
    write_log(path, ABOUT, made)
    with monkeypatch.context() as patched:
        patched.setattr(station.log.summary, "read_part", lambda _: pytest.fail("reads the rows"))
        found = asdict(summarise(path))
    assert found == counted_anew(path, monkeypatch)
    assert found["rows"] == len(made)
    assert found["event_counts"]["CRC"] == sum(r.count for r in made if isinstance(r, Event) and r.code is Code.CRC)
    assert found["ticks_missed"] == made[-1 if isinstance(made[-1], Tick) else -2].t_ns // TICK_NS - found["ticks"] - (
        made[0].t_ns // TICK_NS - 1
    )


@pytest.mark.parametrize("seed", range(3))
def test_counts_of_several_files_join(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    clock = ManualClock(0)
    writer = LogWriter(tmp_path, ABOUT, clock, print, "flight", 20_000, Disk(clock))
    made = rows(seed)
    for row in made:
        writer.append([row])
        if isinstance(row, Tick):
            clock.sleep_until_ns(row.t_ns)
            writer.flush()
    writer.close()
    assert len(list(tmp_path.iterdir())) > 2
    joined = asdict(summarise(tmp_path / "flight.mcap"))
    assert joined == counted_anew(tmp_path / "flight.mcap", monkeypatch)
    write_log(tmp_path / "one.mcap", ABOUT, made)
    one = asdict(summarise(tmp_path / "one.mcap"))
    of_a_file = {"path", "files", "bytes", "utc_start_ns"}
    assert {k: v for k, v in joined.items() if k not in of_a_file} == {
        k: v for k, v in one.items() if k not in of_a_file
    }


@pytest.mark.parametrize("seed", range(12))
def test_of_a_wrong_file_the_rows_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    write_log(tmp_path / "a.mcap", ABOUT, rows(1)[:300])
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    data[random.Random(seed).randrange(len(data) // 2, len(data))] ^= 0x10
    hurt = tmp_path / "hurt.mcap"
    hurt.write_bytes(data)
    assert asdict(summarise(hurt)) == counted_anew(hurt, monkeypatch)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((tmp_path / "a.mcap").read_bytes()[:-40])
    found = summarise(cut)
    assert (found.verdict, found.rows) == ("truncated", 300)


def test_gaps_and_dropouts_are_counted_by_device_time(tmp_path: Path) -> None:
    made: list[Rows] = []
    for k in range(100):
        if 20 <= k < 22 or 50 <= k < 75:
            continue
        arrival = 10**9 + (k - k % 5) * 20_000_000
        made.append(Sample(arrival, "a.b", k * 20_000_000, k, (0.0,)))
    write_log(tmp_path / "a.mcap", ABOUT, made)
    stream, _ = summarise(tmp_path / "a.mcap").streams
    assert stream.gaps == 2
    assert stream.longest_gap_s == pytest.approx(0.52)
    (dropout,) = stream.dropouts
    assert dropout.length_s == pytest.approx(0.52)


def test_events_are_counted_with_their_counts(tmp_path: Path) -> None:
    made = [Event(10**9, "boom", Code.CRC, 3), Event(2 * 10**9, "boom", Code.CRC, 4), Event(3 * 10**9, "x", Code.MARK)]
    write_log(tmp_path / "a.mcap", ABOUT, made)
    summary = summarise(tmp_path / "a.mcap")
    assert summary.event_counts == {"CRC": 7, "MARK": 1}
    assert [e.t_s for e in summary.events] == [0.0, 1.0, 2.0]


def test_test_points_are_counted_and_not_their_numbers_added(tmp_path: Path) -> None:
    codes = ((Code.POINT_START, 1), (Code.POINT_END, 1), (Code.POINT_START, 2), (Code.POINT_END, 2))
    made = [Event(10**9 * (k + 1), "operator", code, number) for k, (code, number) in enumerate(codes)]
    write_log(tmp_path / "a.mcap", ABOUT, made)
    assert summarise(tmp_path / "a.mcap").event_counts == {"POINT_START": 2, "POINT_END": 2}
