"""An identification in the terminal: a table of estimates, and what is to be said of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table as Grid

from station.conventions import LATERAL


def print_estimates(result: Mapping[str, Any]) -> None:
    """One row a method, one column a derivative; methods that have none of them are named below with why."""
    methods = result["methods"]
    start, end = result["interval_s"]
    console = Console()
    console = console if console.is_terminal else Console(width=100)
    console.print(
        f"{result['aircraft']}, {start:.2f} to {end:.2f} s, turbulence {result['turbulence']['level'] or 'unknown'}; "
        f"recommended: {result['recommended'] or 'none'}. Estimate ± 2 standard errors; - is not estimated."
    )
    known = list(dict.fromkeys(n for m in methods.values() for n in m["parameters"]))
    lateral = [n for n in known if n in LATERAL]
    groups = [
        [n for n in known if n not in LATERAL],
        *([n for n in lateral if n.startswith(c)] for c in ("CY", "Cl", "Cn")),
    ]
    for names in groups:
        rows = {m: [_cell(made, n) for n in names] for m, made in methods.items() if made["status"] == "ok"}
        rows = {m: cells for m, cells in rows.items() if any(c != "-" for c in cells)}
        if rows:
            grid = Grid("", *names, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
            for m, cells in rows.items():
                grid.add_row(f"{m} *" if m == result["recommended"] else m, *cells)
            console.print(grid)
    reasons: dict[str, list[str]] = {}
    for name, made in methods.items():
        if made["why"]:
            reasons.setdefault(made["why"], []).append(name)
    for why, names in reasons.items():
        console.print(f"{', '.join(names)}: {why}", highlight=False, markup=False)
    pairs = [p for p in result["consistency"].get("pairs", ()) if methods[p["to"]]["status"] == "ok"]
    if pairs:
        grid = Grid(f"against {pairs[0]['from']}", "t_alpha", "t_q", "t_de", "alpha alone?", box=box.SIMPLE_HEAD)
        for pair in pairs:
            lift, moment = (p for name, p in pair.items() if name in ("CL", "CZ", "Cm"))
            both = (f"{lift[t]:.3f} / {moment[t]:.3f}" for t in lift)
            grid.add_row(pair["to"], *both, "yes" if pair["agree"] else "no")
        console.print(grid)
        console.print("By lift / by moment: what a method takes alpha for; where they differ, it is not alpha alone.")
    less = methods.get("physical", {}).get("settings", {}).get("deviance_less_than_quasi_steady")
    if less is not None:
        word = "lower" if less > 0 else "higher"
        console.print(f"physical's deviance is {abs(less):.0f} {word} than the quasi-steady model's", highlight=False)
    advice = result.get("next_input", {})
    if advice.get("ranking") and advice["relative_2sd"] is not None:
        least = f"least known: {advice['poorest']} to {advice['relative_2sd']:.0%} (2 standard errors)"
        console.print(f"{least}; most would tell: {advice['ranking'][0]['input']}", highlight=False)
    for remark in result["remarks"]:
        console.print(remark, highlight=False, markup=False)


def _cell(method: Mapping[str, Any], name: str) -> str:
    p = method["parameters"].get(name)
    if p is None or p["status"] != "estimated":
        return "-"
    twice = 2 * p["std_error"]
    decimals = max(0, 1 - math.floor(math.log10(twice))) if twice > 0 else 4
    return f"{p['estimate']:.{decimals}f}±{twice:.{decimals}f}"
