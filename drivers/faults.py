"""What an emulated device does wrong, as a pure function of flight time.

A device works on blocks of messages; each block goes through `MessageFaults.apply`, which says what becomes of every
message. Unplugging and clock steps belong to the device rather than to a message: `unplugged` and `clock_steps`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.profile import Fault

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

SHARE = 0.5
"""Share of messages lost by "intermittent" or replaced by "garbage" when the card gives no value."""
DIVISOR = 4.0
"""Divisor of the rate for "slow" when the card gives none."""


@dataclass(frozen=True, slots=True)
class Fate:
    """What becomes of a block of n messages."""

    values: Floats
    """(n, m) SI, as the device reports them."""
    silent: Flags
    """(n,) never made: no sequence number is used up."""
    lost: Flags
    """(n,) made, numbered and lost on the way."""
    garbage: Flags
    """(n,) replaced by random bytes."""
    delay: Floats
    """(n,) s from stamp to wire."""


class MessageFaults:
    """The faults of one message of a device; keeps what a stuck sensor last said.

    Random draws are made for every message whether used or not, so that a fault never changes what another draws and
    the way a flight is cut into blocks changes nothing.
    """

    def __init__(
        self,
        faults: Sequence[Fault],
        signals: tuple[str, ...],
        rng: np.random.Generator,
        gaps: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """`gaps`: share of the messages that the link loses all the time, and the mean length of a gap in messages (0:
        each message by itself)."""
        share, length = gaps
        self._share = share
        self._stays = 1.0 - 1.0 / max(length, 1.0 / (1.0 - share))
        """Chance that a message after a lost one is lost too."""
        self._luck = rng.spawn(1)[0]
        self._inside = bool(share) and self._luck.random() < share
        self._faults = tuple(f for f in faults if f.kind not in ("unplug", "clock_step"))
        self._signals = signals
        self._rng = rng
        self._last: Floats | None = None
        self._stuck: dict[int, Floats] = {}

    def apply(self, k: NDArray[np.int64], t: Floats, values: Floats) -> Fate:
        """Message numbers k (n,), flight times t (n,) s, values (n, m) SI -> their fate. Blocks must come in order."""
        n = len(t)
        draws = self._rng.random((n, 2))
        healthy, values = values, values.copy()
        silent, lost, garbage = (np.zeros(n, dtype=np.bool_) for _ in range(3))
        delay = np.zeros(n)
        if self._share:
            begins = self._share / (1.0 - self._share) * (1.0 - self._stays)
            for i, u in enumerate(self._luck.random(n).tolist()):
                lost[i] = self._inside
                self._inside = u < (self._stays if self._inside else begins)
        for number, fault in enumerate(self._faults):
            on = (t >= fault.start) & (t < fault.start + fault.duration)
            if not on.any():
                continue
            if fault.kind == "off":
                silent |= on
            elif fault.kind == "slow":
                divisor = max(1.0, fault.value or DIVISOR)
                silent |= on & (np.floor(k / divisor) == np.floor((k - 1) / divisor))
            elif fault.kind == "intermittent":
                lost |= on & (draws[:, 0] < (fault.value or SHARE))
            elif fault.kind == "garbage":
                garbage |= on & (draws[:, 1] < (fault.value or SHARE))
            elif fault.kind == "delayed":
                delay += np.where(on, max(0.0, fault.value), 0.0)
            elif fault.kind == "wrong":
                values[on, self._signals.index(fault.signal or "")] += fault.value
            elif fault.kind == "stuck":
                if number not in self._stuck:
                    first = int(np.argmax(on))
                    before = healthy[first - 1] if first else self._last
                    self._stuck[number] = (healthy[first] if before is None else before).copy()
                values[on] = self._stuck[number]
        if n:
            self._last = healthy[-1].copy()
        return Fate(values, silent, lost, garbage, delay)


def faults_of(
    faults: Sequence[Fault], device: str, streams: Sequence[str], signals: Sequence[str]
) -> tuple[Fault, ...]:
    """Those of the card's faults that touch a device's message carrying these streams and signals."""
    return tuple(
        f
        for f in faults
        if f.device == device
        and (f.stream is None or f.stream in streams)
        and (f.kind != "wrong" or f.signal in signals)
    )


def unplugged(faults: Sequence[Fault], device: str) -> tuple[tuple[float, float], ...]:
    """From and to, flight seconds, of each time that a device is unplugged."""
    return tuple((f.start, f.start + f.duration) for f in faults if f.device == device and f.kind == "unplug")


def clock_steps(faults: Sequence[Fault], device: str) -> tuple[tuple[float, float, float], ...]:
    """From, to (flight seconds) and size (s) of each jump of a device's clock; at the end it jumps back."""
    return tuple(
        (f.start, f.start + f.duration, f.value) for f in faults if f.device == device and f.kind == "clock_step"
    )
