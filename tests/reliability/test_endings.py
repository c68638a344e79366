"""A flight that is killed, or loses its power, loses no more than the README promises."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from reliability.endings import CUT_S, KILLED_S, Ending, Journal, about, cut_on_ext4, ending, fly, kill, may_mount

from station.clock import SystemClock
from station.conventions import TICK_NS
from station.log import WriterThread, parts, read_rows, summarise

CUTS = 50


def assert_kept(found: Ending, limit_s: float) -> None:
    assert found.lost_s <= limit_s
    assert found.holes == 0
    assert found.verdict in ("truncated", "complete")


def test_kill_9_at_a_random_moment(tmp_path: Path) -> None:
    assert_kept(kill(tmp_path, 1), KILLED_S)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 102))
def test_kill_9_at_100_random_moments(tmp_path: Path, seed: int) -> None:
    assert_kept(kill(tmp_path, seed), KILLED_S)


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Journal, list[int], Path]:
    """Six seconds of flight in files of more than two, so that ends of files do not stand in for syncs; what was safe
    when, and the times of its ticks."""
    folder = tmp_path_factory.mktemp("disk") / "new" / "logs"
    disk, told = Journal(), []
    writer = WriterThread(folder, about(), SystemClock(), lambda event: None, disk, rotate_bytes=140_000)
    fly(writer, 300, told.append)
    writer.close()
    return disk, told, writer.path


def test_a_power_cut_at_50_random_moments(flown: tuple[Journal, list[int], Path], tmp_path: Path) -> None:
    disk, told, _ = flown
    moments = random.Random(1)
    for n in range(CUTS):
        cut_ns = moments.randint(told[0], told[-1])
        disk.left_at(cut_ns, tmp_path / str(n), zeros=bool(n % 2))
        had = max(t for t in told if t <= cut_ns)
        if had - told[0] > CUT_S * 1e9:
            found = ending(tmp_path / str(n), had)
            assert found.lost_s <= CUT_S
            assert found.holes == 0


def test_without_syncs_the_same_cuts_lose_everything(flown: tuple[Journal, list[int], Path], tmp_path: Path) -> None:
    """The file layer's own test: had nothing been synced, nothing would be left."""
    disk, told, _ = flown
    kept, disk.safe = disk.safe, {path: [] for path in disk.safe}
    try:
        disk.left_at(told[-1], tmp_path / "left", zeros=False)
        assert all(path.stat().st_size == 0 for path in (tmp_path / "left").iterdir())
    finally:
        disk.safe = kept


def test_after_the_end_a_power_cut_costs_nothing(flown: tuple[Journal, list[int], Path], tmp_path: Path) -> None:
    disk, told, last = flown
    disk.left_at(SystemClock().now_ns(), tmp_path / "left", zeros=True)
    files = parts(sorted((tmp_path / "left").iterdir(), key=lambda p: len(p.name))[0])
    assert len(files) > 2
    assert files[-1].name == last.name
    assert summarise(files[0]).verdict == "complete"
    assert summarise(files[0]).ticks == len(told)
    assert max(row.t_ns for row in read_rows(files[0])) == told[-1]
    assert TICK_NS * len(told) > CUT_S * 1e9


@pytest.mark.slow
@pytest.mark.skipif(not may_mount(), reason="needs root, loop devices and mkfs.ext4")
@pytest.mark.parametrize("seed", range(50))
def test_a_power_cut_of_an_ext4_disk(tmp_path: Path, seed: int) -> None:
    assert_kept(cut_on_ext4(tmp_path, seed), CUT_S)
