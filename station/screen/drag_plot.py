"""What the operator's page draws of drag: CD_0 by the power that the flight shows, over the whole flight, with the
baseline's beside it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from station.estimation.method_table import METHODS
from station.flight.against_baseline import METHOD, AgainstBaseline, DragNow
from station.profile import Aircraft, from_json
from station.screen.plots import Line, Plot, Points, Setup, band

_COLOUR: Final = METHODS[METHOD].colour
"""Of the method that the baseline's derivatives are held against."""
CD_0: Final = Plot(
    "CD_0 [1]",
    (Line("baseline", METHODS["I"].colour, 1.0), *band(_COLOUR), Line("CD_0", _COLOUR, 2.5)),
    window_s=None,
)


def against(setup: Setup) -> AgainstBaseline | None:
    """Who holds the flight against the baseline; None without one."""
    return AgainstBaseline(from_json(Aircraft, setup.measured)) if setup.measured else None


def drawn(known: AgainstBaseline | None) -> tuple[Plot, ...]:
    """Its axes, where the baseline has drag."""
    return (CD_0,) if known is not None and known.CD_0 is not None else ()


def points(base: float, new: Sequence[DragNow], start_ns: int) -> Iterator[Points]:
    """A point a mean of ten seconds."""
    if new:
        t = np.array([d.t_ns - start_ns for d in new], dtype=np.int64)
        yield Points(CD_0.path, t, np.array([(base, d.value - 2 * d.sd, d.value + 2 * d.sd, d.value) for d in new]))
