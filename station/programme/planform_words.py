"""What `station planform` found, in the terminal and as station.planform/1: SI and radians."""

from __future__ import annotations

import math
from typing import Any, Final

from rich import box
from rich.console import Console
from rich.table import Table as Grid

from station.identification.listing import WIDTH
from station.model.outline_responses import FittedResponse, Number, PlanformAnswer
from station.profile.aircraft import Indicial

SCHEMA: Final = "station.planform/1"
RESPONSES: Final = {
    "lift_motion": "lift after a step of alpha",
    "lift_gust": "lift after a gust's edge",
    "upwash_motion": "upwash at the vane, step of alpha",
    "upwash_gust": "upwash at the vane, gust's edge",
}
"""By key of [unsteady]."""


def heading(made: PlanformAnswer) -> str:
    """One line: wing, lift slope, speed."""
    own = f", {made.wing_lift_slope:.2f} by the profile's CL_alpha" if made.wing_lift_slope else ""
    return (
        f"{made.aircraft.name}: aspect ratio {made.aspect_ratio:.2f}; lift slope of the wing {made.lift_slope:.2f} per "
        f"rad thin and flat{own}; times at {made.speed:.1f} m/s"
    )


def shown(n: Number, x: float | None) -> str:
    if x is None:
        return "none"
    return f"{1e3 * x:+.0f} ms" if n.unit == "s" else f"{x:.4f}"


def beside(difference: float) -> str:
    """The profile's from the outline's."""
    return f"{100 * difference:+.1f} %" if math.isfinite(difference) else ""


def sums(of: Indicial) -> str:
    a = ", ".join(f"{x:.4f}" for x in of.a)
    b = ", ".join(f"{x:.4f}" for x in of.b)
    return f"a {a}; b {b}"


def response_difference(fit: FittedResponse) -> str:
    return f"{100 * fit.difference:.1f} %" if math.isfinite(fit.difference) else "none"


def print_planform(made: PlanformAnswer) -> None:
    """Numbers and responses beside the profile's, and remarks."""
    console = Console()
    console = console if console.is_terminal else Console(width=WIDTH)

    def words(line: str) -> None:
        console.print(line, highlight=False, markup=False)

    words(heading(made))
    grid = Grid("", "outline", "profile", "differs", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for n in made.numbers:
        grid.add_row(n.key, shown(n, n.value), shown(n, n.profile), beside(n.difference))
    console.print(grid)
    grid = Grid(
        "response, t in chords", "1 - sum a exp(-b t)", "profile's differs", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0)
    )
    for name, fit in made.responses.items():
        grid.add_row(name, sums(fit.indicial), response_difference(fit))
    console.print(grid)
    words("differs: at worst between 0.1 and 2 Hz, magnitude and phase together")
    for remark in made.remarks:
        words(remark)


def as_json(made: PlanformAnswer) -> dict[str, Any]:
    """None for what is not known."""

    def number(x: float) -> float | None:
        return x if math.isfinite(x) else None

    return {
        "schema": SCHEMA,
        "aircraft": made.aircraft.name,
        "speed_mps": made.speed,
        "aspect_ratio": made.aspect_ratio,
        "wing_lift_slope": {"thin_wing": made.lift_slope, "profile": made.wing_lift_slope},
        "numbers": {
            n.key: {"value": n.value, "unit": n.unit or "1", "profile": n.profile, "difference": number(n.difference)}
            for n in made.numbers
        },
        "responses": {
            name: {
                "a": list(fit.indicial.a),
                "b": list(fit.indicial.b),
                "worst_fit": fit.worst,
                "profile_differs": number(fit.difference),
            }
            for name, fit in made.responses.items()
        },
        "remarks": list(made.remarks),
    }
