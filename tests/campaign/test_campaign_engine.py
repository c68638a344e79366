"""Batches, kills, resumption and a real Dask cluster: the rows are the same, and none is lost or flown twice."""

from __future__ import annotations

import errno
import importlib.metadata
import json
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from station.campaign import engine
from station.campaign.engine import Store, batches, fly_dask, fly_local
from station.campaign.result_rows import fly_rows
from station.campaign.spec import Plan, load_plan
from station.rows import LogError, StationError, UsageError

SPEC = """
name = "t"
runs = 10
methods = ["II", "split"]
record = "6 s"
[flight]
[factors]
turbulence = ["calm", "light", "severe"]
[[inputs.doublet]]
kind = "doublet"
start = "1 s"
width = "1 s"
amplitude = "2 deg"
"""


@pytest.fixture
def plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Plan:
    """Thirty flights, four a batch: batches cross from case to case."""
    monkeypatch.setattr(engine, "BATCH_S", 24.0)
    path = tmp_path / "t.toml"
    path.write_text(SPEC, encoding="utf-8")
    return load_plan(str(path))


@pytest.fixture(scope="module")
def wanted(tmp_path_factory: pytest.TempPathFactory) -> pa.Table:
    path = tmp_path_factory.mktemp("spec") / "t.toml"
    path.write_text(SPEC, encoding="utf-8")
    return fly_rows(load_plan(str(path)), range(30))


def rows(store: Store) -> pa.Table:
    return pq.read_table(store.finish()).replace_schema_metadata(None)


class Stopped(Exception):
    """In place of a kill of the whole command."""


def stop_after(flights: int) -> Callable[[int], None]:
    kept = [0]

    def done(n: int) -> None:
        kept[0] += n
        if kept[0] >= flights:
            raise Stopped

    return done


def test_a_row_a_flight_and_method(wanted: pa.Table) -> None:
    assert wanted.num_rows == 60
    assert len(set(wanted["seed"].to_pylist())) == 30
    assert set(wanted["method"].to_pylist()) == {"II", "split"}
    assert wanted["turbulence"].to_pylist()[::20] == ["calm", "light", "severe"]
    one = wanted.slice(40, 1).to_pylist()[0]
    off = one["Cm_alpha"] - one["Cm_alpha_reference"]
    assert one["Cm_alpha_error"] == pytest.approx(off / abs(one["Cm_alpha_reference"]))
    assert one["Cm_alpha_bound"] == pytest.approx(2 * (one["Cm_alpha_sd"] ** 2 + one["Cm_alpha_model"] ** 2) ** 0.5)
    assert one["Cm_alpha_covered"] == (abs(off) <= one["Cm_alpha_bound"])


def test_processes_give_the_rows_of_one_and_resume_flies_only_what_is_missing(
    plan: Plan, wanted: pa.Table, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert len(batches(plan)) == 8
    store = Store(out, plan, resume=False)
    with pytest.raises(Stopped):
        fly_local(plan, store, 2, stop_after(8))
    kept = 30 - store.flights_missing()
    assert 8 <= kept < 30
    with pytest.raises(UsageError, match="--resume"):
        Store(out, plan, resume=False)
    again = Store(out, plan, resume=True)
    flown: list[int] = []
    fly_local(plan, again, 1, flown.append)
    assert sum(flown) == 30 - kept
    assert rows(again).equals(wanted)
    assert Store(out, plan, resume=True).missing() == []
    assert not multiprocessing.active_children()


def test_a_killed_worker_costs_its_batch_which_is_flown_again(plan: Plan, wanted: pa.Table, tmp_path: Path) -> None:
    store = Store(tmp_path / "out", plan, resume=False)
    flown: list[int] = []

    def done(n: int) -> None:
        flown.append(n)
        if len(flown) == 1:
            os.kill(multiprocessing.active_children()[0].pid or 0, signal.SIGKILL)

    fly_local(plan, store, 2, done)
    assert sum(flown) == 30
    assert rows(store).equals(wanted)


def _worker_of_a_command(alive: Connection) -> None:
    def worker() -> None:
        engine._end_with_the_parent()
        alive.send("ready")
        time.sleep(60.0)

    multiprocessing.get_context("fork").Process(target=worker).start()
    alive.close()
    time.sleep(60.0)


def test_workers_end_with_a_killed_command() -> None:
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)
    command = context.Process(target=_worker_of_a_command, args=(there,))
    command.start()
    there.close()
    assert here.recv() == "ready"
    command.kill()
    assert here.poll(10.0), "the worker lives on"
    with pytest.raises(EOFError):
        here.recv()
    command.join()


def test_a_part_cut_short_is_flown_again(plan: Plan, tmp_path: Path) -> None:
    store = Store(tmp_path / "out", plan, resume=False)
    store.keep(2, fly_rows(plan, batches(plan)[2]))
    assert 2 not in store.missing()
    part = next((tmp_path / "out" / "parts").glob("*.parquet"))
    part.write_bytes(part.read_bytes()[:-7])
    assert 2 in store.missing()


def test_another_specification_does_not_go_on(plan: Plan, tmp_path: Path) -> None:
    Store(tmp_path / "out", plan, resume=False)
    other = Plan(plan.campaign, plan.cases, plan.text + "# changed", plan.path)
    with pytest.raises(UsageError, match="another specification"):
        Store(tmp_path / "out", other, resume=True)


def test_a_full_disk_ends_it_and_keeps_the_finished_rows(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(tmp_path / "out", plan, resume=False)
    store.keep(0, fly_rows(plan, batches(plan)[0]))
    write = pq.write_table

    def full(table: pa.Table, path: Path, **keys: Any) -> None:
        write(table.slice(0, 1), path)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(pq, "write_table", full)
    with pytest.raises(LogError, match=r"the disk is full.*\n.*--resume"):
        fly_local(plan, store, 1, lambda n: None)
    monkeypatch.undo()
    monkeypatch.setattr(engine, "BATCH_S", 24.0)
    assert Store(tmp_path / "out", plan, resume=True).missing() == list(range(1, 8))
    assert not list((tmp_path / "out" / "parts").glob("*.partial"))


def test_a_disk_that_is_full_of_rows_is_told_when_figures_are_drawn(plan: Plan, tmp_path: Path) -> None:
    def draw() -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(LogError, match=r"the disk is full.*\n.*--resume"):
        Store(tmp_path / "out", plan, resume=False).writing(draw)


def test_a_scheduler_that_is_not_there(plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "CONNECT_S", 1.0)
    store = Store(tmp_path / "out", plan, resume=False)
    with pytest.raises(StationError, match=r"no Dask scheduler answers at tcp://127.0.0.1:9") as caught:
        fly_dask(plan, store, "tcp://127.0.0.1:9", lambda n: None)
    assert len(str(caught.value).splitlines()) <= 3


@pytest.mark.parametrize("address", ["nonsense", "tcp://host", "host:port", "tcp://:8786"])
def test_a_scheduler_s_address_without_host_or_port(plan: Plan, tmp_path: Path, address: str) -> None:
    with pytest.raises(UsageError, match="no host and port"):
        fly_dask(plan, Store(tmp_path / "out", plan, resume=False), address, lambda n: None)


class NoWorkersAtFirst:
    """What is asked of Dask's client before the first flight."""

    def __init__(self, versions: dict[str, str]) -> None:
        self.waited: list[float | None] = []
        self.versions = versions

    def submit(self, _: Callable[[], str], *, pure: bool) -> NoWorkersAtFirst:
        """Its own future."""
        return self

    def result(self, timeout: float | None = None) -> None:
        self.waited.append(timeout)
        if timeout is not None:
            raise TimeoutError

    def run(self, _: Callable[[], str]) -> dict[str, str]:
        return self.versions


def test_a_cluster_without_workers_says_so_and_waits() -> None:
    client, told = NoWorkersAtFirst({}), list[str]()
    engine._need_workers(client, "tcp://h:1", told.append)
    assert client.waited == [engine.CONNECT_S, None]
    assert told == ["tcp://h:1: the cluster has no workers: waiting\nstart some with `dask worker tcp://h:1`"]


def test_workers_of_another_station_are_refused_with_both_versions(plan: Plan) -> None:
    ours = importlib.metadata.version("flight-test-station")
    with pytest.raises(StationError, match=rf"worker tcp://w:1 has station 0\.0\.9, this is {re.escape(ours)}"):
        engine._need_workers(NoWorkersAtFirst({"tcp://w:0": ours, "tcp://w:1": "0.0.9"}), "tcp://h:1", print)
    # One that joins later.
    with pytest.raises(StationError, match=rf"a worker has station {re.escape(ours)}, the campaign 0\.0\.9"):
        engine.fly_of("0.0.9", plan, range(1))


def test_a_folder_that_cannot_be(plan: Plan, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(LogError, match="no campaign can be kept there: Not a directory"):
        Store(tmp_path / "file", plan, resume=False)
    broken = tmp_path / "broken"
    broken.mkdir()
    (broken / "campaign.json").write_text("{", encoding="utf-8")
    with pytest.raises(UsageError, match="name another folder"):
        Store(broken, plan, resume=True)
    taken = tmp_path / "taken"
    taken.mkdir()
    (taken / "flights.parquet").write_bytes(b"of another study")
    with pytest.raises(UsageError, match=r"holds a flights\.parquet of something else\nname another folder"):
        Store(taken, plan, resume=True)
    assert (taken / "flights.parquet").read_bytes() == b"of another study"


def test_rows_of_another_specification_are_not_taken_for_this_one_s(plan: Plan, tmp_path: Path) -> None:
    other = Plan(plan.campaign, plan.cases, plan.text + "# changed", plan.path)
    Store(tmp_path / "other", other, resume=False).keep(2, fly_rows(plan, batches(plan)[2]))
    store = Store(tmp_path / "out", plan, resume=False)
    part = tmp_path / "other" / "parts" / "000002.parquet"
    (tmp_path / "out" / "parts" / part.name).write_bytes(part.read_bytes())
    assert 2 in store.missing()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A scheduler and two workers on loopback: its address, and all three."""
    told = tmp_path / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": tmp_path}
    serve = [sys.executable, "-m", "dask", "scheduler", "--host", "127.0.0.1", "--port", "0"]
    work = [sys.executable, "-m", "dask", "worker", "--scheduler-file", str(told), "--host", "127.0.0.1"]
    alone = ["--nthreads", "1", "--no-nanny", "--no-dashboard"]
    children = [subprocess.Popen([*serve, "--no-dashboard", "--scheduler-file", str(told)], **quiet)]  # type: ignore[call-overload]
    children += [subprocess.Popen([*work, *alone], **quiet) for _ in range(2)]  # type: ignore[call-overload]
    try:
        for _ in range(600):
            if told.exists() and told.stat().st_size:
                break
            time.sleep(0.05)
        yield json.loads(told.read_text())["address"], children
    finally:
        for child in reversed(children):
            child.kill()
            child.wait()


def test_a_cluster_gives_the_same_rows_though_a_worker_is_killed(
    plan: Plan,
    wanted: pa.Table,
    tmp_path: Path,
    cluster: tuple[str, list[subprocess.Popen[bytes]]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """And where the scheduler dies, that is said, and what was finished is kept."""
    address, (scheduler, worker, _) = cluster
    store = Store(tmp_path / "out", plan, resume=False)
    flown: list[int] = []

    def kill(victim: subprocess.Popen[bytes], at: int) -> Callable[[int], None]:
        flown.clear()

        def done(n: int) -> None:
            flown.append(n)
            if len(flown) == at:
                victim.kill()

        return done

    fly_dask(plan, store, address, kill(worker, 2))
    assert sum(flown) == 30
    assert rows(store).equals(wanted)

    monkeypatch.setattr(engine, "CONNECT_S", 1.0)
    store = Store(tmp_path / "again", plan, resume=False)
    with pytest.raises(StationError, match=r"the scheduler was lost\n.*--resume"):
        fly_dask(plan, store, address, kill(scheduler, 1))
    assert len(store.missing()) == 8 - len(flown) < 8


class Kept:
    """In place of a folder: what was flown."""

    def __init__(self, batches: int) -> None:
        self.rows: dict[int, int] = {}
        self._batches = batches

    def missing(self) -> list[int]:
        return list(range(self._batches))

    def keep(self, i: int, rows: int) -> None:
        assert i not in self.rows
        self.rows[i] = rows


def test_an_adaptive_cluster_starts_its_workers_for_the_flights(monkeypatch: pytest.MonkeyPatch) -> None:
    """It begins with none, has none while nothing is asked of it, and a second where more waits than one flies in the
    time it aims at. In place of flights, waits."""
    from distributed import LocalCluster

    monkeypatch.setattr(engine, "batches", lambda plan: [range(k, k + 1) for k in range(40)])
    monkeypatch.setattr(engine, "fly_rows", lambda plan, flights: time.sleep(0.02) or flights.start)
    told: list[str] = []
    there: list[int] = []
    kept = Kept(40)
    with LocalCluster(
        n_workers=0, processes=False, threads_per_worker=1, host="tcp://127.0.0.1", dashboard_address=None
    ) as cluster:
        cluster.adapt(minimum=0, maximum=2, interval="20ms", target_duration="50ms")
        assert not cluster.workers
        fly_dask(None, kept, cluster.scheduler_address, lambda _: there.append(len(cluster.workers)), told.append)  # type: ignore[arg-type]
    assert kept.rows == {k: k for k in range(40)}
    assert max(there) == 2
    assert not told
