"""A calibration in the terminal."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table as Grid

from station.conventions import from_si
from station.identification.listing import WIDTH
from station.programme.calibration import Calibration, Constant

WORDS: Final = {
    "airspeed_error": "position error at {speed:.0f} m/s",
    "airspeed_slope": "its slope over speed",
    "pressure_scale": "dynamic pressure, scale - 1",
    "static_position": "static port, error over q",
    "pitot_position": "pitot, error over q",
    "vane_zero": "alpha vane, zero",
    "upwash": "steady upwash, d(vane)/d(alpha) - 1",
    "upwash_slope": "its slope over q, 1/kPa",
    "vane_x": "vane ahead of the CG",
    "vane_delay": "alpha vane, late by",
    "beta_zero": "beta vane, zero",
    "phi_zero": "bank, zero",
    "theta_zero": "pitch attitude, zero",
    "psi_zero": "heading, zero",
    "ax_zero": "ax, zero",
    "ay_zero": "ay, zero",
    "az_zero": "az, zero",
}
"""In the order listed."""
SHOWN_IN: Final = {"rad": "deg", "s": "ms", "1": "%"}
PLAIN: Final = ("upwash", "upwash_slope")
"""Numbers that are no per cent."""


def unit_of(c: Constant) -> str:
    """That a constant is shown in."""
    return "" if c.name in PLAIN else SHOWN_IN.get(c.unit, c.unit)


def shown(c: Constant, x: float) -> float:
    """A value of a constant in that unit."""
    unit = unit_of(c)
    return from_si(x, unit) if unit else x


def named(made: Calibration, c: Constant) -> str:
    return WORDS[c.name].format(speed=made.steady.speed)


def value_of(c: Constant) -> str:
    """With its standard error, to two digits of that."""
    sd = shown(c, c.sd)
    digits = max(0, 1 - math.floor(math.log10(sd))) if 0 < sd < math.inf else 3
    return f"{shown(c, c.value):+.{digits}f} ± {sd:.{digits}f}"


def interval_of(c: Constant) -> str:
    sd = shown(c, c.sd)
    digits = max(0, 1 - math.floor(math.log10(sd))) if 0 < sd < math.inf else 3
    low, high = (shown(c, x) for x in c.ci95)
    return f"{low:+.{digits}f} to {high:+.{digits}f}"


def print_calibration(made: Calibration) -> None:
    """Constants with standard errors and intervals, what is not told and why, and remarks."""
    console = Console()
    console = console if console.is_terminal else Console(width=WIDTH)

    def words(line: str) -> None:
        console.print(line, highlight=False, markup=False)

    low, high = made.speeds
    kinds = {k: [r for r in made.runs if r.kind == k] for k in ("steady", "turn", "input")}
    counts = ", ".join(f"{len(v)} {k}" for k, v in kinds.items() if v)
    words(f"calibration of {made.aircraft.name}: runs {counts}; {low:.0f} to {high:.0f} m/s true airspeed")
    grid = Grid("", "value ± sd", "95 %", "unit", "profile", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in (n for n in WORDS if n in made.constants):
        c = made.constants[name]
        was = f"{shown(c, c.before):+.3g}"
        if c.is_told:
            grid.add_row(named(made, c), value_of(c), interval_of(c), unit_of(c), was)
        else:
            grid.add_row(named(made, c), "not told", "", unit_of(c), was, style="dim")
    console.print(grid)
    error, sd = made.steady.error_at(np.array([low, high]))
    if made.constants["airspeed_error"].is_told:
        words(
            f"position error {error[0]:+.2f} ± {sd[0]:.2f} m/s at {low:.0f} m/s, "
            f"{error[1]:+.2f} ± {sd[1]:.2f} m/s at {high:.0f} m/s: shown less true airspeed"
        )
    north, east = made.steady.wind.mean(axis=0)
    words(f"mean wind {math.hypot(north, east):.1f} m/s towards {math.degrees(math.atan2(east, north)) % 360:.0f} deg")
    for why, names in _reasons(made).items():
        words(f"not told: {', '.join(names)}: {why}")
    for remark in made.remarks:
        words(remark)


def _reasons(made: Calibration) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for name in (n for n in WORDS if n in made.constants):
        c = made.constants[name]
        if c.why:
            found.setdefault(c.why, []).append(named(made, c))
    return found
