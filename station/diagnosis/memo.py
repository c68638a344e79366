"""Stages of a computation that several ask for, the latest few of each kept."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, Final, TypeVar

T = TypeVar("T")

_KEPT: Final = {
    "signal": 48, "motion": 8, "path": 8, "shown": 8, "flow": 8, "spectra": 8, "span": 16, "trim": 4,
    "freed": 1,
}  # fmt: skip
"""How many of each stage."""


class Memo:
    """Of residuals, those that candidates for one manoeuvre share; of a diagnosis, those that its steps share."""

    def __init__(self) -> None:
        self._kept: dict[str, dict[Hashable, Any]] = {}

    def get(self, stage: str, key: Hashable, make: Callable[[], T]) -> T:
        """The stage for a key, made where it is not there; of a key with columns in it (stacked.py), each time."""
        kept = self._kept.setdefault(stage, {})
        try:
            there = key in kept
        except TypeError:
            return make()
        if not there:
            if len(kept) >= _KEPT.get(stage, len(kept) + 1):
                del kept[next(iter(kept))]
            kept[key] = make()
        found: T = kept[key]
        return found
