"""Files that are there when they are whole, and not before: whatever ends the writing leaves none half-written."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def new_file(out: Path) -> Iterator[Path]:
    """A path beside `out` to write to, which becomes `out` in the end, or is removed. Raises FileExistsError where
    `out` is there already, before and after."""
    if out.exists():
        raise FileExistsError(errno.EEXIST, "exists already", str(out))
    # Of the same suffix, by which some libraries choose what they write.
    partial = out.with_name(f".{out.stem}.{os.getpid()}.partial{out.suffix}")
    try:
        yield partial
        # Not a rename, which would replace what another has made meanwhile.
        try:
            os.link(partial, out)
        except FileExistsError:
            raise FileExistsError(errno.EEXIST, "exists already", str(out)) from None
        except OSError:
            os.rename(partial, out)  # a file system without links
    finally:
        with suppress(OSError):
            partial.unlink()
