"""The simulated aircraft, air and instruments: pure numerics."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from station.simulation.sortie import fly
    from station.simulation.three_degrees import Simulation

__all__ = ["Simulation", "fly"]
_PLACES = {"Simulation": "three_degrees", "fly": "sortie"}
"""Imported when they are first named: a station that draws a card's inputs flies nothing, and is to record at once."""


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_PLACES[name]}"), name)
