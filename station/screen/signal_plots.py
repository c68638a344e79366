"""What the operator's page draws of the signals that a rig declares or derives (see plots.py): those of one unit are
lines of one plot, as a browser keeps up with few."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from station.conventions import from_si
from station.profile import Rig
from station.screen import lateral_plots, plots
from station.screen.plots import LINK_COLOURS, Batch, Line, Plot, Points, Setup, times


def signals_of(rig: Rig) -> tuple[tuple[str, int, str], ...]:
    """Name, column in a frame and unit to show, of each."""
    return tuple((n, rig.further.index[n], unit) for n, unit in rig.further.units.items())


def drawn(setup: Setup) -> tuple[Plot, ...]:
    """A plot a unit; none where nothing is declared."""
    return tuple(
        Plot(
            f"{', '.join(names)} [{unit}]",
            tuple(Line(n, LINK_COLOURS[i % len(LINK_COLOURS)]) for i, n in enumerate(names)),
            window_s=120.0,
            legend=len(names) > 1,
        )
        for unit, names in _by_unit(setup).items()
    )


def further(setup: Setup) -> tuple[Plot, ...]:
    """With those of the lateral derivatives, all that not every flight has."""
    return (*lateral_plots.drawn(setup), *drawn(setup))


def every_point(rows: Batch, setup: Setup) -> Iterator[Points]:
    """The new points of all plots of the page."""
    yield from plots.points(rows, setup)
    yield from lateral_plots.points(rows, setup)
    yield from points(rows, setup)


def _by_unit(setup: Setup) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for name, _, unit in setup.signals:
        found.setdefault(unit, []).append(name)
    return found


def points(rows: Batch, setup: Setup) -> Iterator[Points]:
    """The new points of every plot."""
    if not setup.signals or not rows.frames:
        return
    column = {name: i for name, i, _ in setup.signals}
    t = times(rows.frames, rows.start_ns)
    for plot, (unit, names) in zip(drawn(setup), _by_unit(setup).items(), strict=True):
        values = np.array([[frame.values[column[n]] for n in names] for frame in rows.frames])
        zero = from_si(0.0, unit)
        yield Points(plot.path, t, zero + (from_si(1.0, unit) - zero) * values)
