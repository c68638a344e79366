"""What a rig lacks for estimates, and what a recording's columns say of themselves before anything is estimated."""

from __future__ import annotations

from typing import Final

import numpy as np

from station.conventions import SIGNALS
from station.log import Table
from station.profile import Aircraft, Rig

REPEATING: Final = 0.6
"""Share of rows that repeat the value before, above which a signal that noise moves is held between its samples."""
MOVING: Final = ("alpha_vane", "q", "az")


def about_air(rig: Rig, aircraft: Aircraft) -> list[str]:
    """Where nothing tells the dynamic pressure: then there are no derivatives in flight."""
    has = {name for stream in rig.streams() for name in stream.signals}
    known = "dynamic_pressure" in has or {"static_pressure", "air_temperature"} <= has or "altitude" in has
    if known or aircraft.air_density is not None:
        return []
    return [
        f"rig {rig.name}: neither dynamic_pressure, static_pressure with air_temperature, nor altitude: no\n"
        "derivatives with no air density; give one of them, or air_density in the aircraft's profile"
    ]


def about_columns(table: Table) -> list[str]:
    """Signals beyond what can be true, which nothing is estimated from, and those held between slower samples."""
    told = []
    for name, column in table.columns.items():
        known = column[np.isfinite(column)]
        signal = SIGNALS.get(name)
        if signal is None or len(known) < 2:
            continue
        beyond = int(((known < signal.low) | (known > signal.high)).sum())
        if beyond:
            told.append(
                f"{name}: {beyond} of {len(known)} values are not within {signal.low:.4g} to {signal.high:.4g} "
                f"{signal.unit} and left out: is its unit right?"
            )
        same = float((np.diff(known) == 0).mean())
        if name in MOVING and REPEATING < same < 1.0:
            told.append(
                f"{name} repeats its last value in {same:.0%} of the rows: held between slower samples, it is late, "
                "and no estimate allows for that"
            )
    return told
