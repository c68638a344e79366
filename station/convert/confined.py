"""Files from elsewhere are read by a process of its own, within bounds: a parser that is not ours may crash on one, go
on for ever, or ask for all the memory there is."""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import resource
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final, TypeVar

from station.rows import LogError, StationError

SECONDS: Final = 60
BYTES_A_SECOND: Final = 50_000
"""Processor time: pymavlink, the slowest parser, reads 0.5 to 2 MB of DataFlash a second."""
MEMORY: Final = 512 * 2**20
MEMORY_A_BYTE: Final = 60
"""Beyond what the station has already: modules of parsers; Python's numbers of 32 bytes for a file's of 4, twice."""
EVERY_S: Final = 0.25
_MIB: Final = 2**20
_FORK: Final = multiprocessing.get_context("fork")

Found = TypeVar("Found")


def confined(
    path: Path,
    read: Callable[[], Found],
    seconds: int = SECONDS,
    memory: int = MEMORY,
    waiting: Callable[[], None] = lambda: None,
) -> Found:
    """What `read` makes of the file at `path`; `waiting` is called meanwhile. Raises LogError whatever becomes of it.

    This guards against damaged files and against bugs of parsers, not against an attack by way of one.
    """
    size = path.stat().st_size
    seconds, memory = seconds + size // BYTES_A_SECOND, memory + size * MEMORY_A_BYTE
    ours, theirs = _FORK.Pipe(duplex=False)
    child = _FORK.Process(target=_read, args=(path, read, theirs, seconds, memory), name="reading", daemon=True)
    child.start()
    theirs.close()
    try:
        while not ours.poll(EVERY_S):
            waiting()
        found = ours.recv()
    except (EOFError, OSError):
        child.join()
        raise LogError(f"{path}: cannot be read: {_why(child.exitcode or 0, seconds)}\nis the file damaged?") from None
    finally:
        child.terminate()
        child.join()
        child.close()
        ours.close()
    if isinstance(found, StationError):
        raise found
    result: Found = found
    return result


def _read(path: Path, read: Callable[[], object], pipe: Connection, seconds: int, memory: int) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    faulthandler.disable()  # a crash is told in a sentence
    # A parser's chatter, a line for each byte that it passes over, is not for the user.
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    _limit(resource.RLIMIT_DATA, _in_use() + memory)
    try:
        found = read()
    except StationError as error:
        found = error
    except MemoryError:
        found = LogError(f"{path}: cannot be read: it would take more than {memory // _MIB} MiB\nis the file damaged?")
    except Exception as error:  # a parser raises whatever a broken file makes of it
        found = LogError(f"{path}: cannot be read: {type(error).__name__}: {error}\nis the file damaged?")
    _limit(resource.RLIMIT_DATA, resource.getrlimit(resource.RLIMIT_DATA)[1])
    pipe.send(found)


def _limit(kind: int, size: int) -> None:
    """The soft limit, so that it can be lifted again."""
    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (size if hard == resource.RLIM_INFINITY else min(size, hard), hard))


def _in_use() -> int:
    """Bytes of data of this process, as the system counts them for its limit; 0 where it does not say."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
    except OSError:
        return 0
    return next((int(line.split()[1]) * 1024 for line in status.splitlines() if line.startswith("VmData:")), 0)


def _why(status: int, seconds: int) -> str:
    if status in (-signal.SIGXCPU, -signal.SIGKILL):
        return f"it took more than {seconds} s of processor time"
    if status < 0:
        return f"the parser crashed ({signal.Signals(-status).name})"
    return f"the parser ended by itself (exit status {status})"
