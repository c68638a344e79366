"""Long work shows itself: what is done, how far it has come and how long it takes, on a terminal and nowhere else."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

from station.clock import SystemClock
from station.console import say
from station.log import span_ns

if TYPE_CHECKING:
    from rich.progress import TaskID

EVERY_S: Final = 0.25
"""Between two pictures of the bar: a computation has better to do."""
STOPPED: Final = "station: stopped: nothing was left half-written"


@contextmanager
def shown(words: str, log: Path | None = None) -> Iterator[Callable[[int], None]]:
    """While work is done, on stderr: a bar with the time left where `log` says how long it is, else the time it has
    taken; gone when it is done. Gives a function to be told the station time (ns) that the work has come to."""
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
    columns += (BarColumn(), TimeRemainingColumn()) if span else (SpinnerColumn("line"), TimeElapsedColumn())
    try:
        with Progress(*columns, console=console, transient=True, refresh_per_second=1 / EVERY_S) as progress:
            first, last = span or (0, 0)
            bar = progress.add_task(words, total=last - first if span else None)
            yield lambda t_ns: progress.update(bar, completed=t_ns - first)
    except KeyboardInterrupt:
        say(STOPPED)
        raise


@contextmanager
def steps(words: str, begins: Mapping[str, float]) -> Iterator[Callable[[str], None]]:
    """Gives a function to be told each step as it begins, which is a line on stderr. On a terminal a bar stands below:
    the share of the work that is usually done when a step of such a name `begins`, the time taken, and that left if it
    goes on so, which a step that has to be repeated makes longer."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    clock = SystemClock()
    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda step: say(f"  {step}")
        return
    columns = (TextColumn("  {task.description}"), BarColumn(), TimeElapsedColumn(), TextColumn("{task.fields[left]}"))
    try:
        with Progress(*columns, console=console, transient=True, refresh_per_second=1 / EVERY_S) as progress:
            bar, begin_ns, done = progress.add_task(words, total=1.0, left=""), clock.now_ns(), 0.0

            def told(step: str) -> None:
                nonlocal done
                progress.console.print(f"  {step}", markup=False, highlight=False)
                done = max([done, *(share for name, share in begins.items() if step.startswith(name))])
                passed_s = 1e-9 * (clock.now_ns() - begin_ns)
                left = f"about {math.ceil(passed_s * (1 / done - 1))} s left" if done else ""
                progress.update(bar, completed=done, left=left)

            yield told
    except KeyboardInterrupt:
        say(STOPPED)
        raise


@contextmanager
def shares(words: str) -> Iterator[Callable[[float | None], None]]:
    """The same without a thread, which a process that is forked should not have: gives a function to be told what
    share of the work is done, None where nobody knows; a bar with the time taken and, after the first share, that
    left."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda _: None
        return
    columns = (TextColumn("  {task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    try:
        with Progress(*columns, console=console, transient=True, auto_refresh=False) as progress:
            reading = progress.add_task(words, total=None)
            writing: list[TaskID] = []

            def told(share: float | None) -> None:
                if share is not None and not writing:
                    progress.remove_task(reading)
                    writing.append(progress.add_task(f"{words}: writing", total=1.0))
                if share is not None:
                    progress.update(writing[0], completed=share)
                progress.refresh()

            progress.refresh()
            yield told
    except KeyboardInterrupt:
        say(STOPPED)
        raise
