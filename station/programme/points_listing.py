"""A programme's points in the terminal: what was flown, every method at every point, and what has changed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from rich import box
from rich.console import Console
from rich.table import Table as Grid

from station.conventions import LONGITUDINAL
from station.identification.listing import WIDTH
from station.numerics.random_effects import Pooled
from station.programme.changes import CALM, MEASURED, OWN, Baseline, Change, compared, recommended
from station.programme.flown_points import FlownPoint
from station.programme.programme import Programme, significant
from station.rows import ParamEstimate, Status

W_BAND: Final = (
    "standard deviation of the vertical gust in 2 to 7 Hz, m/s, during the inputs; gusts of all lengths are several "
    "times that"
)
"""What a programme shows of the air: it is what the classes of turbulence are told by."""


def print_programme(made: Programme) -> None:
    """A table of points, one of each by every method, the baseline, and the changes."""
    console = Console()
    console = console if console.is_terminal else Console(width=WIDTH)
    console.print(_points(made))
    _print_baseline(made.baseline, console)
    for place, point in enumerate(made.points):
        if point.methods is not None:
            heading = f"{point.title}: {point.turbulence} during the input; recommended: {recommended(point) or 'none'}"
            console.print(heading, highlight=False, markup=False, style="bold")
            console.print(_methods(point, made.changes[place], made.baseline, 2 if console.width >= WIDTH else 1))
        if point.why:
            console.print(f"{point.title}: {point.why}", highlight=False, markup=False)
    console.print(
        "Estimate ± 2 standard errors; below it the change against the baseline in per cent, with its 95 % interval, * "
        "where that leaves 0 out. - is not estimated.",
        highlight=False,
        markup=False,
    )
    for place, point in enumerate(made.points):
        changed = "; ".join(significant(made.change(place)))
        if changed and point.title not in made.baseline.points:
            console.print(f"changed at {point.title}: {changed}", highlight=False, markup=False)
            like = made.likeness(place)
            console.print(f"  {like}", highlight=False, markup=False)
    for remark in made.remarks:
        console.print(remark, highlight=False, markup=False)


def _points(made: Programme) -> Grid:
    grid = Grid(
        "", "point", "condition", "from", "to s", "inputs", "air", "w 2-7 Hz", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0)
    )
    has_drag = any(p.drag is not None for p in made.points)
    if has_drag:
        grid.add_column("CD_0")
    for p in made.points:
        gust = f"{p.gust_sd:.3f}" if math.isfinite(p.gust_sd) else "-"
        is_one = "b" if p.title in made.baseline.points else ""
        cells = (f"{p.start_s:.0f}", f"{p.end_s:.0f}", str(len(p.inputs)), p.turbulence, gust)
        grid.add_row(is_one, p.name, p.condition, *cells, *([drag_words(p)] if has_drag else []))
    grid.caption, grid.caption_justify = f"w 2-7 Hz: {W_BAND}", "left"
    return grid


def drag_words(p: FlownPoint) -> str:
    """CD_0 of a point with 2 standard errors."""
    return "-" if p.drag is None else rounded(p.drag.value, 2 * p.drag.error)


def _print_baseline(baseline: Baseline, console: Console) -> None:
    of = (
        f"{len(baseline.points)} points by {baseline.method}"
        if baseline.points
        else f"the profile, {baseline.source}"
        if baseline.source == MEASURED
        else "the profile"
    )
    console.print(f"baseline: {of}", highlight=False, markup=False, style="bold")
    drag = [] if baseline.drag is None else [baseline.drag]
    grid = Grid("", *LONGITUDINAL, *("CD_0" for _ in drag), box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for definition, called in ((OWN, "own"), (CALM, "q.s.")):
        values = baseline.values.get(definition, {})
        if values:
            shown = [*(values.get(n) for n in LONGITUDINAL), *drag]
            grid.add_row(called, *map(_pooled, shown))
            if len(baseline.points) > 1:
                grid.add_row("  scatter", *map(_scatter, shown), style="dim")
    console.print(grid)


def _pooled(p: Pooled | None) -> str:
    return "-" if p is None else rounded(p.value, p.widening * p.error)


def _scatter(p: Pooled | None) -> str:
    return "-" if p is None or not math.isfinite(p.between) else f"{100 * p.between / abs(p.value):.1f} %"


def _methods(point: FlownPoint, changes: Mapping[str, Mapping[str, Change]], baseline: Baseline, digits: int) -> Grid:
    grid = Grid("", *LONGITUDINAL, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    best = recommended(point)
    refused: dict[str, list[str]] = {}
    for name, result in (point.methods or {}).items():
        if result.status != "ok":
            refused.setdefault(result.why or "no estimate", []).append(name)
            continue
        values = compared(point, name, baseline)
        mark = f"{name} *" if name == best else name
        grid.add_row(mark, *(_cell(values.get(n), digits) for n in LONGITUDINAL))
        grid.add_row("", *(_percent(changes[name].get(n)) for n in LONGITUDINAL), style="dim")
    grid.caption = "\n".join(f"{', '.join(names)}: {why}" for why, names in refused.items()) or None
    grid.caption_justify = "left"
    return grid


def _cell(p: ParamEstimate | None, digits: int) -> str:
    if p is None or p.status is not Status.ESTIMATED:
        return "-"
    return rounded(p.value, 2 * p.sd, digits)


def rounded(value: float, error: float, digits: int = 2) -> str:
    """To so many digits of the error."""
    decimals = max(0, digits - 1 - math.floor(math.log10(error))) if error > 0 else 3
    return f"{value:.{decimals}f}±{error:.{decimals}f}"


def _percent(change: Change | None) -> str:
    if change is None or not change.is_known:
        return ""
    half = 0.5 * (change.high - change.low)
    return f"{change.estimate:+.0f}±{half:.0f}{'*' if change.is_significant else ''}"
