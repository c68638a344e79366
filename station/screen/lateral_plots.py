"""What the operator's page draws of the lateral derivatives, where the card asks for them (see plots.py).

The five derivatives of an equation are lines of one entity, and each of its plots shows those of one: a browser keeps
up with few entities only.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from station.conventions import LATERAL, SIGNAL_INDEX
from station.estimation.method_table import METHODS
from station.rows import MethodEstimate
from station.screen.plots import Batch, Line, Plot, Points, Setup, band, estimated, times

EQUATIONS: Final = ("CY", "Cl", "Cn")
_GREY, _ORANGE, _BLUE, _PINK = (METHODS[m].colour for m in ("I", "II", "V", "split+gust"))
SURFACES: Final = Plot("aileron, rudder [deg]", (Line("aileron", _ORANGE), Line("rudder", _PINK)))
RATES: Final = Plot("p, r [deg/s]", (Line("p", _ORANGE), Line("r", _PINK)))
SIDESLIP: Final = Plot("beta vane [deg]", (Line("vane", _BLUE),), legend=False)
_SHOWN: Final = {SURFACES: ("aileron", "rudder"), RATES: ("p", "r"), SIDESLIP: ("beta_vane",)}


def drawn(setup: Setup) -> tuple[Plot, ...]:
    """Every entity of the lateral tab; none where nothing asks for it."""
    return (SURFACES, RATES, SIDESLIP, *(_equation(e, setup) for e in EQUATIONS)) if setup.lateral_methods else ()


def _equation(equation: str, setup: Setup) -> Plot:
    lines: list[Line] = []
    believed = setup.lateral_methods[-1]
    for name in LATERAL:
        if name.startswith(equation):
            lines.append(Line("profile", _GREY, 1.0))
            for m in setup.lateral_methods:
                lines += [*band(METHODS[m].colour), Line(m, METHODS[m].colour, 2.5 if m == believed else 1.25)]
    return Plot(f"lateral {equation} [1/rad]", tuple(lines), window_s=None, legend=False)


def views(setup: Setup) -> Iterator[tuple[str, Plot, list[bool]]]:
    """For each derivative the name of its plot, the entity, and which of its lines to show: the bounds of the last
    method only."""
    believed = setup.lateral_methods[-1]
    one = [True, *(line for m in setup.lateral_methods for line in (m == believed, m == believed, True))]
    for equation in EQUATIONS:
        plot = _equation(equation, setup)
        names = [name for name in LATERAL if name.startswith(equation)]
        for name in names:
            yield f"{name} [1/rad]", plot, [shown and other == name for other in names for shown in one]


def points(rows: Batch, setup: Setup) -> Iterator[Points]:
    """The new points of the lateral tab."""
    if not setup.lateral_methods:
        return
    if rows.frames:
        t = times(rows.frames, rows.start_ns)
        for plot, names in _SHOWN.items():
            values = [[frame.values[SIGNAL_INDEX[name]] for name in names] for frame in rows.frames]
            yield Points(plot.path, t, np.degrees(values))
    slots: dict[int, dict[str, MethodEstimate]] = {}
    for row in rows.methods:
        if row.method in setup.lateral_methods:
            slots.setdefault(row.t_ns, {})[row.method] = row
    if not slots:
        return
    t = np.array([t_ns - rows.start_ns for t_ns in slots], dtype=np.int64)
    for equation in EQUATIONS:
        table = []
        for slot in slots.values():
            lines: list[float] = []
            for name in LATERAL:
                if name.startswith(equation):
                    lines.append(setup.references.get(name, np.nan))
                    for m in setup.lateral_methods:
                        value, sd = estimated(slot[m], name) if m in slot else (np.nan, np.nan)
                        lines += [value - 2 * sd, value + 2 * sd, value]
            table.append(lines)
        yield Points(_equation(equation, setup).path, t, np.array(table))
