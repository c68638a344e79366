"""The station's voice: exit codes, words for the user, and results as JSON."""

from __future__ import annotations

import contextlib
import json
import shutil
import sys
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from station.rows import LogError

DONE, ERROR, USAGE, DEGRADED = 0, 1, 2, 3
LEAST_WIDTH = 40
"""Columns: in less, words are not broken for it."""


def say(text: str) -> None:
    """Words for the user, on stderr; stdout is for what was asked for."""
    with contextlib.suppress(OSError):  # nobody there to hear it
        print(text, file=sys.stderr, flush=True)


def say_wrapped(text: str) -> None:
    """Words to read, not to copy: on a terminal, broken between words at its width."""
    if sys.stderr.isatty():
        width = max(shutil.get_terminal_size().columns, LEAST_WIDTH)
        lines = (textwrap.wrap(t, width, break_long_words=False, break_on_hyphens=False) for t in text.splitlines())
        text = "\n".join(line for wrapped in lines for line in wrapped or [""])
    say(text)


def judge(reasons: Sequence[str]) -> int:
    """The exit code of what was done but for these `reasons`, which the last line on stderr tells; DONE without any."""
    if not reasons:
        return DONE
    say(f"station: degraded: {'; '.join(reasons)}")
    return DEGRADED


def write_json(result: Mapping[str, Any], to: str) -> None:
    """The result of a verb to a file, or to stdout for "-". Raises LogError if the file cannot be written."""
    if to == "-":
        print(json.dumps(result, allow_nan=False))
        return
    try:
        Path(to).write_text(json.dumps(result, indent=1, allow_nan=False), encoding="utf-8")
    except OSError as error:
        raise LogError(f"{to}: cannot be written: {error.strerror}") from error


def check_json(to: str | None) -> None:
    """Before an hour of work whose result could not be written. Raises LogError."""
    if to not in (None, "-") and not Path(str(to)).absolute().parent.is_dir():
        raise LogError(f"{to}: cannot be written: no such folder")
