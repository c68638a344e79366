"""A campaign on a Dask cluster of two workers of this machine against the in-process engine with two: flights per
second, processor time, and that both give the same rows.

OPENBLAS_NUM_THREADS=1 uv run python tests/benchmarks/dask_efficiency.py [FLIGHTS [PAIRS]]        by default 10000 1

Other work on the machine slows both: they take turns, and processor time (which waits of a busy machine do not touch)
stands beside the time that passed.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pyarrow.parquet as pq

from station.profile import profiles_dir

CAMPAIGN = "chapter4_condition2"
LEVELS = 4
WORKERS = 2


@contextmanager
def cluster(folder: Path) -> Iterator[tuple[str, list[psutil.Process]]]:
    """A scheduler and workers of one thread each, as `dask scheduler` and `dask worker` start them."""
    told = folder / "scheduler.json"
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(told)]
    worker = ["worker", "--scheduler-file", str(told), "--host", "127.0.0.1", "--nthreads", "1", "--no-nanny"]
    started: list[psutil.Process] = []
    with (folder / "cluster.log").open("w") as log:
        try:
            for words in (scheduler, *[[*worker, "--no-dashboard"]] * WORKERS):
                run = subprocess.Popen([sys.executable, "-m", "dask", *words], stdout=log, stderr=log, cwd=folder)
                started.append(psutil.Process(run.pid))
            yield str(told), started
        finally:
            for one in reversed(started):
                one.kill()
                one.wait()


def used(processes: list[psutil.Process]) -> float:
    return sum(sum(one.cpu_times()[:2]) for one in processes)


def fly(spec: Path, out: Path, *options: str) -> tuple[float, float]:
    """Seconds that passed and seconds of processor time of a campaign and its children."""
    begin = time.perf_counter()
    words = [sys.executable, "-m", "station", "campaign", str(spec), "-o", str(out), *options]
    child = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert child.stderr is not None
    errors = child.stderr.read()
    _, status, usage = os.wait4(child.pid, 0)
    if status:
        raise SystemExit(errors.decode())
    return time.perf_counter() - begin, usage.ru_utime + usage.ru_stime


def specification(folder: Path, flights: int) -> Path:
    text = (profiles_dir() / "campaigns" / f"{CAMPAIGN}.toml").read_text(encoding="utf-8").split("[[claims]]")[0]
    path = folder / f"flights_{flights}.toml"
    text = text.replace("runs = 200", f"runs = {flights // LEVELS}").replace('figures = ["estimates"]', "figures = []")
    path.write_text(text, encoding="utf-8")
    return path


def main(flights: int, pairs: int) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        spec, few = specification(folder, flights), specification(folder, 8 * LEVELS)
        with cluster(folder) as (told, processes):
            while not (Path(told).exists() and Path(told).stat().st_size):
                time.sleep(0.1)
            address = json.loads(Path(told).read_text())["address"]
            dask = ("--engine", "dask", "--scheduler", address)
            local = ("--workers", str(WORKERS))
            for k, options in enumerate((local, dask)):  # compiles
                fly(few, folder / f"few{k}", *options)
            passed, cpu = {"local": 0.0, "dask": 0.0}, {"local": 0.0, "dask": 0.0}
            for k in range(pairs):
                for engine, options in (("local", local), ("dask", dask)):
                    before = used(processes)
                    seconds, spent = fly(spec, folder / f"{engine}{k}", *options)
                    spent += used(processes) - before
                    passed[engine] += seconds
                    cpu[engine] += spent
                    rate = flights / seconds
                    print(
                        f"{engine:5} {flights:,} flights: {seconds:.1f} s, {rate:.0f} flights/s, {spent:.1f} s of CPU"
                    )
                rows = [pq.read_table(folder / f"{engine}{k}" / "flights.parquet") for engine in passed]
                print("the same rows" if rows[0].equals(rows[1]) else "OTHER ROWS")
    print(
        f"efficiency of Dask with {WORKERS} workers: {100 * passed['local'] / passed['dask']:.0f} % by time passed, "
        f"{100 * cpu['local'] / cpu['dask']:.0f} % by processor time"
    )


if __name__ == "__main__":
    asked = [int(n) for n in sys.argv[1:]]
    main(*asked, *(10_000, 1)[len(asked) :])
