"""The verb `station campaign`."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from station.clock import SystemClock
from station.commands.common import completing
from station.console import say


class Engine(StrEnum):
    local = "local"
    dask = "dask"


def campaign(
    spec: Annotated[
        str,
        typer.Argument(
            metavar="SPEC", help="a name under profiles/campaigns, or a path", autocompletion=completing("campaigns")
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="folder for rows and figures")],
    engine: Annotated[Engine, typer.Option(help="processes of this machine, or a Dask cluster")] = Engine.local,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="of a Dask scheduler that you trust: who reaches it runs code on its workers"
        ),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="go on where it was stopped")] = False,
    workers: Annotated[int | None, typer.Option(min=1, help="processes; one a core if left out")] = None,
) -> int:
    """Monte Carlo: simulated flights by the thousand, every one estimated; Parquet and figures."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from station.api.monte_carlo import campaign as fly

    clock = SystemClock()
    begin = clock.now_ns()
    before: int | None = None
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    # Drawn when a batch is done, not by a thread: processes are forked from this one.
    with Progress(*columns, console=Console(stderr=True), auto_refresh=False) as progress:
        bar = progress.add_task(spec, total=None, rate="")

        def flown(kept: int, of: int) -> None:
            nonlocal begin, before
            if before is None:
                before, begin = kept, clock.now_ns()
            rate = (kept - before) / max((clock.now_ns() - begin) * 1e-9, 1e-9)
            words = f"{rate:.3g} flights/s" if kept > before else ""
            progress.update(bar, total=of, completed=kept, rate=words, refresh=True)

        made = fly(
            spec,
            out,
            engine=engine.value,
            scheduler=scheduler,
            resume=resume,
            workers=workers,
            progress=flown,
            say=say,
        )
    seconds = (clock.now_ns() - begin) * 1e-9
    for line in made.sentences:
        sys.stdout.write(line + "\n")
    kept = f" ({before} kept from before)" if before else ""
    rate = f"{made.flown} flights in {seconds:.1f} s: {made.flown / seconds:.0f} flights/s{kept}"
    sys.stdout.write(f"{made.result}\n{rate}\n")
    return 0
