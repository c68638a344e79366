"""Signals that a rig declares, emulated: expressions over the time and what the simulation knows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import SIGNALS, unit_named
from station.profile import DeclaredSignal, Formula, Rig, nearest
from station.rows import ProfileError
from station.simulation.truth import LATERAL_TRUTH, TRUTH

Array = NDArray[np.float64]

KNOWN: Final = ("time", *SIGNALS, *TRUTH, *LATERAL_TRUTH)
"""What an expression may name; a flight that lacks some of it (three degrees of freedom) shows nothing of that."""


class EmulatedSignals:
    """What the devices of a rig that declares signals show of them, before noise, drift and gaps."""

    def __init__(self, declared: Mapping[str, DeclaredSignal], rig: str = "") -> None:
        """Raises ProfileError for an expression that names what no flight has."""
        self._made: list[tuple[str, Formula, float, float]] = []
        for name, signal in declared.items():
            unit = unit_named(signal.unit)
            if name in SIGNALS or unit is None:
                continue
            formula = Formula(signal.emulated)
            for other in formula.names:
                if other not in KNOWN:
                    near = nearest(other, KNOWN) or f"; known: {', '.join(KNOWN)}"
                    raise ProfileError(f"rig {rig}: signals.{name}.emulated: {other}: it names nothing{near}")
            self._made.append((name, formula, unit.factor, unit.offset))

    def rows(self, truth: Mapping[str, Array]) -> dict[str, Array]:
        """Each of them, SI, (n,) as the columns of `truth`; NaN where it has no value."""
        n = len(next(iter(truth.values())))
        lacking = np.full(n, np.nan)
        out = {}
        for name, formula, factor, offset in self._made:
            value = formula.over({other: truth.get(other, lacking) for other in formula.names})
            out[name] = np.broadcast_to(value * factor + offset, (n,)).copy()
        return out


def emulated_signals(rig: Rig) -> EmulatedSignals:
    """Raises ProfileError."""
    return EmulatedSignals(rig.signals, rig.name)
