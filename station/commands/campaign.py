"""The verb `station campaign`."""

from __future__ import annotations

import os
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from station.clock import SystemClock
from station.rows import UsageError


class Engine(StrEnum):
    local = "local"
    dask = "dask"


def campaign(
    spec: Annotated[str, typer.Argument(metavar="SPEC", help="a name under profiles/campaigns, or a path")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="folder for rows and figures")],
    engine: Annotated[Engine, typer.Option(help="processes of this machine, or a Dask cluster")] = Engine.local,
    scheduler: Annotated[str | None, typer.Option(metavar="ADDRESS", help="of the Dask scheduler")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="go on where it was stopped")] = False,
    workers: Annotated[int | None, typer.Option(min=1, help="processes; one a core if left out")] = None,
) -> int:
    """Monte Carlo: simulated flights by the thousand, every one estimated; Parquet and figures."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from station.campaign.engine import Store, fly_dask, fly_local
    from station.campaign.figures import draw
    from station.campaign.spec import load_plan

    if (engine is Engine.dask) != (scheduler is not None):
        raise UsageError(
            "--engine dask and --scheduler ADDRESS go together\nfor example --scheduler tcp://127.0.0.1:8786"
        )
    plan = load_plan(spec)
    store = Store(out, plan, resume)
    clock = SystemClock()
    already = plan.flights - store.flights_missing()
    count = 0
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    begin = clock.now_ns()
    # Drawn when a batch is done, not by a thread: processes are forked from this one.
    with Progress(*columns, console=Console(stderr=True), auto_refresh=False) as progress:
        bar = progress.add_task(plan.campaign.name, total=plan.flights, completed=already, rate="")

        def done(flights: int) -> None:
            nonlocal count
            count += flights
            rate = count / ((clock.now_ns() - begin) * 1e-9)
            progress.update(bar, advance=flights, rate=f"{rate:.0f} flights/s", refresh=True)

        if scheduler is not None:
            fly_dask(plan, store, scheduler, done)
        else:
            fly_local(plan, store, workers or len(os.sched_getaffinity(0)), done)
    seconds = (clock.now_ns() - begin) * 1e-9
    result = store.finish()
    for line in store.writing(lambda: draw(plan, result, out)):
        sys.stdout.write(line + "\n")
    kept = f" ({already} kept from before)" if already else ""
    sys.stdout.write(f"{result}\n{count} flights in {seconds:.1f} s: {count / seconds:.0f} flights/s{kept}\n")
    return 0
