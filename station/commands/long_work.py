"""Long work shows itself: what is done, how far it has come and how long it takes, on a terminal and nowhere else."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from station.console import say
from station.log import span_ns

EVERY_S: Final = 0.25
"""Between two pictures of the bar: a computation has better to do."""


@contextmanager
def shown(words: str, log: Path | None = None, moving: bool = True) -> Iterator[Callable[[int], None]]:
    """While work is done, on stderr: a bar with the time left where `log` says how long it is, else the time it has
    taken; gone when it is done. Not `moving`, it needs no thread, which a process that is forked should not have. Gives
    a function to be told the station time (ns) that the work has come to."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        ProgressColumn,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda _: None
        return
    span = span_ns(log) if log is not None else None
    columns: tuple[ProgressColumn, ...] = (TextColumn("  {task.description}"),)
    if moving:
        columns += (BarColumn(), TimeRemainingColumn()) if span else (SpinnerColumn("line"), TimeElapsedColumn())
    try:
        with Progress(
            *columns, console=console, transient=True, refresh_per_second=1 / EVERY_S, auto_refresh=moving
        ) as progress:
            first, last = span or (0, 0)
            bar = progress.add_task(words, total=last - first if span else None)
            yield lambda t_ns: progress.update(bar, completed=t_ns - first)
    except KeyboardInterrupt:
        say("station: stopped: nothing was left half-written")
        raise
