"""What is asked of an identification: which methods, of which part of a recording, with what is known of its rig."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from station.estimation.method_table import METHODS
from station.estimation.results import Axes
from station.profile import Card
from station.rows import UsageError

DEFAULT_CARD: Final = Card(name="identify", aircraft="", rig="")
"""Gives the frequencies where a recording has no card of its own."""
ALL: Final = "all"


@dataclass(frozen=True, slots=True)
class Request:
    """`methods`: names of method_table, or "all". `start_s` and `end_s` are on the table's time axis; None is its end.

    `imu_position` (m from the CG, body axes) and `noise` (standard deviations, SI) are the rig's, `card` gives the
    frequencies. `force` applies the methods for turbulence in calm air too. `sift`: II and split from the lines that
    the card's multisine excites, and from no others. `log`: the recording's name, for messages. `on_boom`: columns that
    measure az elsewhere, and where (m from the CG, body axes); `vanes`: likewise alpha_vane.
    """

    methods: Sequence[str] = (ALL,)
    start_s: float | None = None
    end_s: float | None = None
    axes: Axes = "wind"
    card: Card | None = None
    imu_position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    noise: Mapping[str, float] | None = None
    force: bool = False
    sift: bool = False
    log: str = ""
    on_boom: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    vanes: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)

    @property
    def wants_all(self) -> bool:
        return ALL in self.methods

    @property
    def band_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency that the estimates are made of."""
        card = self.card if self.card is not None else DEFAULT_CARD
        return card.low, card.high

    @property
    def subject(self) -> str:
        """What messages are about."""
        return self.log or "log"

    def names(self) -> tuple[str, ...]:
        """The methods asked for, each once. Raises UsageError for an unknown one and names the nearest."""
        if self.wants_all:
            return tuple(METHODS)
        for name in self.methods:
            if name not in METHODS:
                near = difflib.get_close_matches(name, METHODS, n=1, cutoff=0.3)
                hint = f"; did you mean {near[0]}?" if near else ""
                raise UsageError(f"no method named {name}{hint}\nknown: {ALL}, {', '.join(METHODS)}")
        return tuple(dict.fromkeys(self.methods))
