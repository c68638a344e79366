"""A card's inputs as a table over time, for whoever flies them: an autopilot, or a pilot's display."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.conventions import SURFACES
from station.profile import Manoeuvre, Multisine
from station.simulation.manoeuvres import duration, surface_input, wave_of
from station.simulation.multisine import Wave

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class InputTable:
    """One round of manoeuvres: what each moved surface adds to its trim, rad, at `t_s` since the first begins. The last
    row, after all have ended, is zero."""

    t_s: Array
    surfaces: dict[str, Array]
    waves: tuple[Wave | None, ...]
    """Of each manoeuvre, where it is a multisine."""

    @property
    def correlation(self) -> Array:
        """Of each surface with each over the round, its last row left out; NaN for one that stands still."""
        with np.errstate(invalid="ignore", divide="ignore"):
            found: Array = np.atleast_2d(np.corrcoef([x[:-1] for x in self.surfaces.values()]))
        return found

    @property
    def relative_peak_factors(self) -> dict[str, float]:
        """(max - min) / (2 sqrt2 rms) of each surface over the round; 1 for a sine."""
        found = {}
        for name, x in self.surfaces.items():
            rms = float(np.std(x[:-1]))
            found[name] = float(np.ptp(x[:-1])) / (2 * np.sqrt(2) * rms) if rms > 0 else np.nan
        return found


def input_table(manoeuvres: Sequence[Manoeuvre], rate_hz: float) -> InputTable:
    """The first run of each manoeuvre, `rate_hz` times a second. Raises ProfileError as surface_input does, and
    ValueError without manoeuvres."""
    if not manoeuvres:
        raise ValueError("no manoeuvres")
    once = [m.model_copy(update={"repeat": None}) for m in manoeuvres]
    first = min(m.start for m in once)
    count = int(np.ceil((max(m.start + duration(m) for m in once) - first) * rate_hz - 1e-6))
    t = np.arange(count + 1) / rate_hz
    moved = [s for s in SURFACES if any(m.surface == s for m in once)]
    waves = tuple(wave_of(m, once) if isinstance(m, Multisine) else None for m in once)
    return InputTable(t, {s: surface_input(once, first + t, s) for s in moved}, waves)
