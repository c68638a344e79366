"""Where the flights are flown: in processes of this machine, or on a Dask cluster; in batches, whose rows are kept as
they come.

A batch is some consecutive flights, and its rows depend on the specification and on their numbers only: not on the
engine, the number of workers, or the order in which batches end. Each becomes a file of its own under DIR/parts,
written beside and renamed, so what a kill leaves is whole. At the end they become DIR/flights.parquet in the order of
flights.
"""

from __future__ import annotations

import errno
import hashlib
import importlib
import importlib.metadata
import itertools
import json
import multiprocessing
import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, TypeVar
from urllib.parse import urlsplit

import pyarrow as pa
import pyarrow.parquet as pq

from station.campaign.case import PARTS, compile_part
from station.campaign.result_rows import fly_rows
from station.campaign.spec import Plan
from station.campaign.whole_records import WHOLE
from station.conventions import TICK_HZ
from station.rows import LogError, StationError, UsageError

BATCH_S: Final = 4000.0
"""Seconds of flight in a batch: half a second of work or more on any machine."""
WHOLE_S: Final = 2000.0
"""Seconds of flight that one by the methods of a whole record counts as: filter error and IV take a second or two."""
LEAST_QUEUED: Final = 32
"""Batches on a cluster, however few workers it has: an adaptive one grows by what waits."""
ATTEMPTS: Final = 5
"""Workers may die on a batch so many times before it is taken for the batch's fault."""
CONNECT_S: Final = 10.0
"""How long a scheduler may take to answer."""
RESULT: Final = "flights.parquet"
_PARTS: Final = "parts"
_MANIFEST: Final = "campaign.json"

T = TypeVar("T")

Done = Callable[[int], None]
"""Called with the number of flights of every batch that is kept."""


def batches(plan: Plan) -> list[range]:
    """Numbers of the flights of each batch."""
    seconds = plan.ticks / TICK_HZ + (WHOLE_S if set(plan.campaign.methods) & set(WHOLE) else 0.0)
    size = max(1, round(BATCH_S / seconds))
    return [range(b, min(b + size, plan.flights)) for b in range(0, plan.flights, size)]


class Store:
    """A campaign's folder."""

    def __init__(self, folder: Path, plan: Plan, resume: bool) -> None:
        """Raises UsageError if the folder holds another campaign, or this one without `resume`."""
        self.folder = folder
        self._parts = folder / _PARTS
        self._batches = batches(plan)
        version = importlib.metadata.version("flight-test-station")
        identity: dict[str, object] = {
            "specification": hashlib.sha256(plan.text.encode()).hexdigest(),
            "station": version,
            "batches": len(self._batches),
        }
        manifest = folder / _MANIFEST
        if manifest.exists():
            if not resume:
                raise UsageError(
                    f"{folder}: holds a campaign already\nadd --resume to finish it, or name another folder"
                )
            if _read(manifest) != identity:
                raise UsageError(f"{folder}: was begun with another specification or station\nname another folder")
        elif self.result.exists():
            raise UsageError(f"{folder}: holds a {RESULT} of something else\nname another folder")
        try:
            self._begin(manifest, identity)
        except OSError as error:
            why = "the disk is full" if _is_full(error) else error.strerror
            raise LogError(f"{folder}: no campaign can be kept there: {why}\nname another folder") from error
        self._metadata = {b"station.campaign": plan.text.encode(), b"station.version": version.encode()}

    def _begin(self, manifest: Path, identity: dict[str, object]) -> None:
        self._parts.mkdir(parents=True, exist_ok=True)
        for stale in self._parts.glob("*.partial"):
            stale.unlink()
        if not manifest.exists():
            partial = manifest.with_suffix(".partial")
            partial.write_text(json.dumps(identity), encoding="utf-8")
            os.replace(partial, manifest)

    @property
    def result(self) -> Path:
        return self.folder / RESULT

    def missing(self) -> list[int]:
        """Numbers of the batches that are not kept yet."""
        if self.result.exists():
            return []
        return [i for i, batch in enumerate(self._batches) if not self._is_kept(i, len(batch))]

    def flights_missing(self) -> int:
        """How many flights are still to be flown."""
        return sum(len(self._batches[i]) for i in self.missing())

    def _is_kept(self, i: int, flights: int) -> bool:
        path = self._part(i)
        try:
            found = pq.read_metadata(path).metadata or {}
        except (OSError, pa.ArrowInvalid):
            return False
        return found.items() >= {**self._metadata, b"flights": str(flights).encode()}.items()

    def _part(self, i: int) -> Path:
        return self._parts / f"{i:06d}.parquet"

    def keep(self, i: int, rows: pa.Table) -> None:
        """Write a batch's rows. Raises LogError where that fails; what was kept before stays."""
        path = self._part(i)
        partial = path.with_suffix(".partial")
        marked = rows.replace_schema_metadata({**self._metadata, b"flights": str(len(self._batches[i])).encode()})

        def write() -> None:
            pq.write_table(marked, partial, compression="zstd")
            os.replace(partial, path)

        self.writing(write, partial)

    def finish(self) -> Path:
        """All batches in one file, a row group each. Raises LogError."""
        if self.result.exists():
            return self.result
        partial = self.result.with_suffix(".partial")

        def write() -> None:
            schema = pq.read_schema(self._part(0)).with_metadata(self._metadata)
            with pq.ParquetWriter(partial, schema, compression="zstd") as writer:
                for i in range(len(self._batches)):
                    # Not pq.read_table, which imports pandas.
                    writer.write_table(pq.ParquetFile(self._part(i)).read().replace_schema_metadata(self._metadata))
            os.replace(partial, self.result)

        self.writing(write, partial)
        for i in range(len(self._batches)):
            self._part(i).unlink(missing_ok=True)
        with suppress(OSError):
            self._parts.rmdir()
        return self.result

    def writing(self, write: Callable[[], T], partial: Path | None = None) -> T:
        """What `write` gives. Raises LogError where the disk does not let it; `partial` is then removed."""
        try:
            return write()
        except OSError as error:
            if partial is not None:
                with suppress(OSError):
                    partial.unlink(missing_ok=True)
            what = "the disk is full" if _is_full(error) else str(error)
            raise LogError(
                f"{self.folder}: {what}; the rows of finished batches are kept\nmend it, then run again with --resume"
            ) from error


def _read(manifest: Path) -> object:
    try:
        return json.loads(manifest.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def _is_full(error: OSError) -> bool:
    return error.errno in (errno.ENOSPC, errno.EDQUOT)


def fly_local(plan: Plan, store: Store, workers: int, done: Done) -> None:
    """Fly the missing batches in processes of this machine. Raises StationError."""
    missing = store.missing()
    if not missing:
        return
    planned = batches(plan)
    attempts = dict.fromkeys(missing, 0)
    while missing:
        # A fork has at once what this process has imported, which a new one takes seconds to; safe on Linux only.
        context = multiprocessing.get_context("fork" if sys.platform == "linux" else "spawn")
        with ProcessPoolExecutor(
            min(workers, len(missing)), mp_context=context, initializer=_end_with_the_parent
        ) as pool:
            try:
                wait([pool.submit(compile_part, plan, part) for part in range(PARTS)])
                for i, rows in _in_flight(missing, lambda i: pool.submit(fly_rows, plan, planned[i]), 2 * workers):
                    store.keep(i, rows)
                    done(len(planned[i]))
            except BrokenProcessPool:
                missing = store.missing()
                for i in missing[: 2 * workers]:
                    attempts[i] += 1
                    if attempts[i] >= ATTEMPTS:
                        raise StationError(
                            f"flights {planned[i].start} to {planned[i].stop - 1}: workers die on them"
                        ) from None
                continue
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
        missing = store.missing()


def _end_with_the_parent() -> None:
    """In a worker: end when the command was killed, rather than wait for its next batch forever."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, name="end with the parent", daemon=True).start()


def _in_flight(
    numbers: Iterable[int], submit: Callable[[int], Future[pa.Table]], most: int
) -> Iterator[tuple[int, pa.Table]]:
    """Results as they come, with at most `most` batches waiting or flying: memory stays flat."""
    waiting = iter(numbers)
    flying: dict[Future[pa.Table], int] = {}
    while True:
        for i in waiting:
            flying[submit(i)] = i
            if len(flying) >= most:
                break
        if not flying:
            return
        ended, _ = wait(flying, return_when=FIRST_COMPLETED)
        for future in ended:
            yield flying.pop(future), future.result()


def _is_address(scheduler: str) -> bool:
    parts = urlsplit(scheduler if "://" in scheduler else f"tcp://{scheduler}")
    try:
        return bool(parts.hostname and parts.port)
    except ValueError:
        return False


def _need_workers(client: Any, scheduler: str, say: Callable[[str], None]) -> None:
    """Wait for a worker, saying so where none comes soon. Raises StationError where one has another station.

    What is waited for is a task: an adaptive cluster starts workers for tasks only.
    """

    def theirs() -> str:
        try:
            return importlib.metadata.version("flight-test-station")
        except importlib.metadata.PackageNotFoundError:
            return "none"

    asked = client.submit(theirs, pure=False)
    try:
        asked.result(timeout=CONNECT_S)
    except TimeoutError:
        say(f"{scheduler}: the cluster has no workers: waiting\nstart some with `dask worker {scheduler}`")
        asked.result()
    ours = importlib.metadata.version("flight-test-station")
    for worker, version in client.run(theirs).items():
        if version != ours:
            raise StationError(
                f"worker {worker} has station {version}, this is {ours}: its flights would be another station's\n"
                "install the same on every worker"
            )


def fly_of(version: str, plan: Plan, flights: range) -> pa.Table:
    """`fly_rows` by the same station; a worker that joins later may have another. Raises StationError."""
    ours = importlib.metadata.version("flight-test-station")
    if version != ours:
        raise StationError(f"a worker has station {ours}, the campaign {version}\ninstall the same on every worker")
    return fly_rows(plan, flights)


def fly_dask(plan: Plan, store: Store, scheduler: str, done: Done, say: Callable[[str], None] = lambda _: None) -> None:
    """Fly the missing batches on a Dask cluster that is there already; `say` is told what it waits for. Raises
    StationError."""
    if not _is_address(scheduler):
        raise UsageError(f"--scheduler {scheduler}: no host and port\nwrite for example tcp://127.0.0.1:8786")
    distributed: Any = importlib.import_module("distributed")
    missing = store.missing()
    planned = batches(plan)
    try:
        client = distributed.Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise StationError(
            f"no Dask scheduler answers at {scheduler}: {str(error) or type(error).__name__:.120}\n"
            "start one with `dask scheduler` and workers with `dask worker ADDRESS`; finished rows are kept"
        ) from None
    with client:
        _need_workers(client, scheduler, say)
        version = importlib.metadata.version("flight-test-station")
        waiting = iter(missing)
        numbers: dict[Any, int] = {}

        def submit(i: int) -> Any:
            future = client.submit(fly_of, version, plan, planned[i], pure=False, retries=ATTEMPTS)
            numbers[future.key] = i
            return future

        def submit_more() -> list[Any]:
            """Two batches a thread that is there now: workers come and go."""
            threads = sum(w["nthreads"] for w in client.scheduler_info(n_workers=-1)["workers"].values())
            return [submit(i) for i in itertools.islice(waiting, max(LEAST_QUEUED, 2 * threads) - len(numbers))]

        coming = distributed.as_completed(submit_more(), loop=client.loop)
        for future in coming:
            i = numbers.pop(future.key)
            try:
                rows = future.result()
            except distributed.KilledWorker:
                raise StationError(
                    f"flights {planned[i].start} to {planned[i].stop - 1}: workers die on them"
                ) from None
            except (OSError, TimeoutError, distributed.CancelledError) as error:
                raise StationError(
                    f"{scheduler}: the scheduler was lost\nfinished rows are kept: run again with --resume"
                ) from error
            future.release()
            store.keep(i, rows)
            done(len(planned[i]))
            for more in submit_more():
                coming.add(more)
