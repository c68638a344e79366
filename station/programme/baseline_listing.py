"""A measured baseline in the terminal."""

from __future__ import annotations

import math

from rich import box
from rich.console import Console
from rich.table import Table as Grid

from station.identification.listing import WIDTH
from station.numerics.random_effects import Pooled
from station.programme.changes import CALM
from station.programme.measured_baseline import MeasuredBaseline
from station.programme.points_listing import rounded


def print_baseline(made: MeasuredBaseline) -> None:
    """What was pooled, with its 95 % interval, the scatter between points and the sd that another point would have."""
    console = Console()
    console = console if console.is_terminal else Console(width=WIDTH)
    named = ", ".join(p.name for p in made.points)
    console.print(f"baseline of {len(made.points)} points: {named}", highlight=False, markup=False)
    grid = Grid("", "mean ± 95 %", "scatter", "points", "sd of another", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name, p in {**made.values, **({"CD_0": made.drag} if made.drag else {})}.items():
        sd = (
            made.aircraft.derivatives[name].sd
            if name != "CD_0"
            else made.aircraft.measured and made.aircraft.measured.CD_0_sd
        )
        grid.add_row(name, rounded(p.value, p.widening * p.error), _scatter(p), str(p.number), f"{sd:.2g}")
    console.print(grid)
    if made.definition == CALM:
        console.print("quasi-steady derivatives: the profile has no tail or boom to tell unsteady lift apart")
    for remark in made.remarks:
        console.print(remark, highlight=False, markup=False)


def _scatter(p: Pooled) -> str:
    return f"{100 * p.between / abs(p.value):.1f} %" if math.isfinite(p.between) else "-"
