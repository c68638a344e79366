"""An identification in the terminal: a table of estimates, and the remarks on them."""

from __future__ import annotations

import math
from typing import Final

from rich import box
from rich.console import Console
from rich.measure import Measurement
from rich.table import Column
from rich.table import Table as Grid

from station.conventions import LATERAL
from station.estimation.method_table import METHODS
from station.identification.advice import NextInput
from station.identification.drag_results import drag_lines, drag_of
from station.identification.handling_qualities import derived_lines, identified_qualities
from station.identification.identified import Identification
from station.identification.instrument_table import print_table
from station.rows import ParamEstimate, Status

WIDTH: Final = 100
"""Columns, where the output is no terminal."""
QUASI_STEADY: Final = " q.s."
"""Marks the row of a method's quasi-steady derivatives, beside its own."""
LATERAL_GROUPS: Final = ("CY", "Cl", "Cn")
UNBOUNDED: Final = 10_000
"""Columns that nothing is as wide as."""
DECIMALS: Final = 4
"""Of an estimate without an error."""


def print_estimates(found: Identification) -> None:
    """One row a method, one column a derivative; methods that have none of them are named below with the reason."""
    console = Console()
    console = console if console.is_terminal else Console(width=WIDTH)
    start, end = found.interval_s
    print_table(found.instruments, console)
    console.print(
        f"{found.aircraft.name}, {start:.2f} to {end:.2f} s, turbulence {found.turbulence}; "
        f"recommended: {found.recommended or 'none'}. Estimate ± 2 standard errors; - is not estimated."
    )
    for grid in _estimates(found, console):
        console.print(grid)
    console.print(_meaning(found), highlight=False, markup=False, end="")
    reasons: dict[str, list[str]] = {}
    for name, made in found.methods.items():
        if made.why:
            reasons.setdefault(made.why, []).append(name)
    for why, names in reasons.items():
        console.print(f"{', '.join(names)}: {why}", highlight=False, markup=False)
    for line in (*derived_lines(identified_qualities(found)), *drag_lines(drag_of(found.record))):
        console.print(line, highlight=False, markup=False)
    against = _consistency(found)
    if against is not None:
        console.print(against)
        console.print("Each by lift / by moment; where these differ, the methods differ by more than alpha.")
    preference = found.flown.preference if found.flown and "physical" in found.methods else None
    if preference is not None:
        word = "lower" if preference > 0 else "higher"
        better = f"physical's deviance is {abs(preference):.0f} {word} than the quasi-steady model's"
        console.print(better, highlight=False)
    advice = found.next_input
    if isinstance(advice, NextInput) and math.isfinite(advice.relative):
        least = f"least well known: {advice.poorest}, 2 standard errors are {advice.relative:.0%} of it"
        console.print(f"{least}; fly next: {advice.ranking[0].name}", highlight=False)
    for remark in found.remarks:
        console.print(remark, highlight=False, markup=False)


def _meaning(found: Identification) -> str:
    own = [m for m, made in found.methods.items() if made.status == "ok" and made.quasi_steady]
    return f"{definitions(own)} Row{'s' * (len(own) > 1)}{QUASI_STEADY}: by {', '.join(own)}.\n" if own else ""


def definitions(own: list[str]) -> str:
    """What the rows of methods that estimate the aircraft's `own` derivatives mean, and those of all others."""
    assert all(METHODS[m].definition == "derivatives" for m in own)
    return (
        f"{', '.join(own)}: the aircraft's own derivatives, unsteady lift apart. All others are quasi-steady: what the "
        "manoeuvre gives in calm air, unsteady lift in it."
    )


def _estimates(found: Identification, console: Console) -> list[Grid]:
    known = list(dict.fromkeys(p.name for m in found.methods.values() for p in m.parameters))
    lateral = [n for n in known if n in LATERAL]
    groups = [
        [n for n in known if n not in LATERAL],
        *([n for n in lateral if n.startswith(c)] for c in LATERAL_GROUPS),
    ]
    grids = []
    for names in groups:
        rows = {}
        for m, made in found.methods.items():
            if made.status == "ok":
                rows[f"{m} *" if m == found.recommended else m] = [_cell(made.parameter(n)) for n in names]
                quasi_steady = {p.name: p for p in made.quasi_steady}
                rows[f"{m}{QUASI_STEADY}"] = [_cell(quasi_steady.get(n)) for n in names]
        rows = {m: cells for m, cells in rows.items() if any(c != "-" for c in cells)}
        if rows:
            grids.append(estimates_grid(names, rows, console))
    return grids


def estimates_grid(names: list[str], rows: dict[str, list[str]], console: Console) -> Grid:
    """Rows of estimates, their errors below them where they do not fit beside them."""
    grid = _grid(names, rows)
    if Measurement.get(console, console.options.update(max_width=UNBOUNDED), grid).maximum <= console.width:
        return grid
    return _grid(names, {m: [c.replace("±", "\n±") for c in cells] for m, cells in rows.items()})


def _grid(names: list[str], rows: dict[str, list[str]]) -> Grid:
    grid = Grid(Column(no_wrap=True), *names, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for m, cells in rows.items():
        grid.add_row(m, *cells)
    return grid


def _consistency(found: Identification) -> Grid | None:
    pairs = [p for p in found.consistency.pairs if found.methods[p.method].status == "ok"] if found.consistency else []
    if not pairs or found.consistency is None:
        return None
    grid = Grid(f"against {found.consistency.base}", "t_alpha", "t_q", "t_de", "alpha alone?", box=box.SIMPLE_HEAD)
    for pair in pairs:
        both = (f"{getattr(pair.force, t):.3f} / {getattr(pair.moment, t):.3f}" for t in ("t_alpha", "t_q", "t_de"))
        grid.add_row(pair.method, *both, "yes" if pair.agree else "no")
    return grid


def _cell(p: ParamEstimate | None) -> str:
    if p is None or p.status is not Status.ESTIMATED:
        return "-"
    twice = 2 * p.sd
    decimals = max(0, 1 - math.floor(math.log10(twice))) if twice > 0 else DECIMALS
    return f"{p.value:.{decimals}f}±{twice:.{decimals}f}"
