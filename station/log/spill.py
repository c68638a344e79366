"""Bytes that a recording needs again only at its end, kept out of memory."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Final

MOST_HELD: Final = 1 << 16
"""Bytes held before they are spilt: those of 12 s of a busy flight, so that the disk is seldom asked."""


class Spill:
    """Bytes in their order: in a file without a name beside the recording, in memory where none can be had."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._held = bytearray()
        self._file: IO[bytes] | None = None
        self._spilt = 0
        self._may_spill = True

    def __len__(self) -> int:
        return self._spilt + len(self._held)

    def add(self, data: bytes) -> None:
        """Never raises for the disk's sake."""
        self._held += data
        if len(self._held) < MOST_HELD or not self._may_spill:
            return
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile(dir=self._folder, buffering=0)  # noqa: SIM115
            done = 0
            while done < len(self._held):
                done += self._file.write(memoryview(self._held)[done:])
        except OSError:
            # A full disk above all: what was spilt before is still there, and the recording says that it is full.
            self._may_spill = False
            return
        self._spilt += len(self._held)
        self._held.clear()

    def pieces(self) -> Iterator[bytes]:
        """All of it, MOST_HELD bytes at a time. Raises OSError."""
        if self._file is not None:
            self._file.seek(0)
            left = self._spilt
            while left:
                piece = self._file.read(min(left, MOST_HELD))
                if not piece:
                    raise OSError("what was set aside of the recording's index is gone")
                left -= len(piece)
                yield piece
        yield bytes(self._held)

    def close(self) -> None:
        self._held.clear()
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()
