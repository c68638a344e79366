"""What a recording asks of the disk, and how long the disk takes to answer."""

from __future__ import annotations

import contextlib
import errno
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from station.clock import Clock

STALL_NS: Final = 400_000_000
"""An answer that takes longer is told. Files are synced each second and hold back 80 ms of rows: with this much for the
sync itself, a power cut costs 1.5 s at most."""
_UNSYNCABLE: Final = (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP, errno.EACCES, errno.EPERM, errno.EISDIR)
"""What systems answer that cannot sync such a file or folder; it is as safe there as the system makes it."""


class Disk:
    """Files of a recording. Every method may raise OSError; each call is timed, from whatever thread it comes."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._asked_ns: dict[int, int] = {}
        self._late: list[int] = []

    def create(self, path: Path) -> int:
        """A new file, for writing. Raises FileExistsError."""
        with self._timed():
            return os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY | getattr(os, "O_CLOEXEC", 0), 0o644)

    def write(self, file: int, data: memoryview) -> int:
        with self._timed():
            return os.write(file, data)

    def sync(self, file: int) -> None:
        """Return when what has been written outlasts a power cut."""
        with self._timed():
            try:
                getattr(os, "fdatasync", os.fsync)(file)
            except OSError as error:
                if error.errno not in _UNSYNCABLE:
                    raise

    def sync_folder(self, folder: Path) -> None:
        """Return when the folder's entries outlast a power cut; one that has been renamed or removed is left alone."""
        with self._timed(), contextlib.suppress(FileNotFoundError, NotADirectoryError, PermissionError):
            opened = os.open(folder, os.O_RDONLY)
            try:
                os.fsync(opened)
            except OSError as error:
                if error.errno not in _UNSYNCABLE:
                    raise
            finally:
                os.close(opened)

    def cut(self, file: int, size: int) -> None:
        with self._timed():
            os.ftruncate(file, size)

    def close(self, file: int) -> None:
        with self._timed():
            os.close(file)

    @contextlib.contextmanager
    def _timed(self) -> Iterator[None]:
        who, asked_ns = threading.get_ident(), self._clock.now_ns()
        self._asked_ns[who] = asked_ns
        try:
            yield
        finally:
            del self._asked_ns[who]
            took_ns = self._clock.now_ns() - asked_ns
            if took_ns > STALL_NS:
                self._late.append(took_ns)

    def unanswered_ns(self) -> int:
        """How long the disk has owed an answer until now."""
        asked = list(self._asked_ns.values())
        return self._clock.now_ns() - min(asked) if asked else 0

    def late_answers_ns(self) -> list[int]:
        """How long those took that were late and have come since this was last asked."""
        late, self._late = self._late, []
        return late


def make_folder(folder: Path, disk: Disk | None = None) -> None:
    """Made so that it outlasts a power cut, where a `disk` is given. Raises OSError; a file in its place is no folder,
    rather than a recording that exists already."""
    new = [p for p in (folder, *folder.parents) if not p.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(folder)) from error
    if disk is not None:
        for made in new:
            disk.sync_folder(made.parent)


def name_of_disk(folder: Path) -> str:
    """Where the disk of a folder is mounted, and its device where the system tells."""
    at = folder.absolute()
    while not os.path.ismount(at) and at != at.parent:
        at = at.parent
    with contextlib.suppress(OSError):
        mounted = [line.split() for line in Path("/proc/self/mounts").read_text(encoding="utf-8").splitlines()]
        devices = [words[0] for words in mounted if words[1].replace("\\040", " ") == str(at)]
        if devices:
            return f"disk {at} ({devices[-1]})"
    return f"disk {at}"
