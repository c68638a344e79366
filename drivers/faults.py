"""What an emulated device does wrong, as a pure function of flight time.

A device works on blocks of messages; each block goes through `MessageFaults.apply`, which says what becomes of every
message. Unplugging and clock steps belong to the device rather than to a message: `unplugged` and `clock_steps`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.profile import Fault

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


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


class Block(NamedTuple):
    """The messages that a fault acts on."""

    on: Flags
    """(n,) whether the fault lasts."""
    k: NDArray[np.int64]
    """(n,) their numbers."""
    luck: Floats
    """(n, 2) in [0, 1): one for being lost, one for being garbage."""
    signal: int
    """Column of the signal that is wrong; -1 where none is named."""
    held: Floats
    """(m,) the values before the fault began."""


class FaultKind(NamedTuple):
    """One row of FAULTS."""

    sentence: str
    value: str
    """What `value` means; empty: nothing."""
    usual: float
    """The value where the card gives none."""
    act: Callable[[Fate, Block, float], None] | None
    """What it does to a block of messages and a value; None: it is the device's."""


def _off(fate: Fate, block: Block, _: float) -> None:
    np.logical_or(fate.silent, block.on, out=fate.silent)


def _stuck(fate: Fate, block: Block, _: float) -> None:
    fate.values[block.on] = block.held


def _garbage(fate: Fate, block: Block, share: float) -> None:
    np.logical_or(fate.garbage, block.on & (block.luck[:, 1] < share), out=fate.garbage)


def _wrong(fate: Fate, block: Block, offset: float) -> None:
    fate.values[block.on, block.signal] += offset


def _slow(fate: Fate, block: Block, divisor: float) -> None:
    by = max(1.0, divisor)
    skipped = np.floor(block.k / by) == np.floor((block.k - 1) / by)
    np.logical_or(fate.silent, block.on & skipped, out=fate.silent)


def _delayed(fate: Fate, block: Block, seconds: float) -> None:
    fate.delay[block.on] += max(0.0, seconds)


def _intermittent(fate: Fate, block: Block, share: float) -> None:
    np.logical_or(fate.lost, block.on & (block.luck[:, 0] < share), out=fate.lost)


FAULTS: Final[Mapping[str, FaultKind]] = {
    "off": FaultKind("silent; no number is used up", "", 0.0, _off),
    "stuck": FaultKind("repeats the values it had", "", 0.0, _stuck),
    "garbage": FaultKind("random bytes in place of messages", "share of the messages", 0.5, _garbage),
    "wrong": FaultKind("an offset on one `signal`", "offset, SI", 0.0, _wrong),
    "slow": FaultKind("fewer messages", "divisor of the rate", 4.0, _slow),
    "delayed": FaultKind("messages come late, in order, with their old stamps", "s", 0.0, _delayed),
    "intermittent": FaultKind("messages are lost on the way", "share of the messages", 0.5, _intermittent),
    "clock_step": FaultKind("the device's clock jumps, and back at the end", "s", 0.0, None),
    "unplug": FaultKind("the link is taken away", "", 0.0, None),
}
"""What a card's faults may be."""


class MessageFaults:
    """The faults of one message of a device; keeps what a stuck sensor last reported.

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
        self._faults = [(f, kind, act) for f in faults if (act := (kind := FAULTS[f.kind]).act) is not None]
        self._signals = signals
        self._rng = rng
        self._last: Floats | None = None
        self._held: dict[int, Floats] = {}

    def apply(self, k: NDArray[np.int64], t: Floats, values: Floats) -> Fate:
        """Message numbers k (n,), flight times t (n,) s, values (n, m) SI -> their fate. Blocks must come in order."""
        n = len(t)
        luck = self._rng.random((n, 2))
        silent, garbage = (np.zeros(n, dtype=np.bool_) for _ in range(2))
        fate = Fate(values.copy(), silent, self._lost(n), garbage, np.zeros(n))
        for number, (fault, kind, act) in enumerate(self._faults):
            on = (t >= fault.start) & (t < fault.start + fault.duration)
            if not on.any():
                continue
            if number not in self._held:
                first = int(np.argmax(on))
                before = values[first - 1] if first else self._last
                self._held[number] = (values[first] if before is None else before).copy()
            signal = self._signals.index(fault.signal) if fault.signal in self._signals else -1
            act(fate, Block(on, k, luck, signal, self._held[number]), fault.value or kind.usual)
        if n:
            self._last = values[-1].copy()
        return fate

    def _lost(self, n: int) -> Flags:
        """Which of the next n messages the link loses, whatever the faults."""
        lost = np.zeros(n, dtype=np.bool_)
        if self._share:
            begins = self._share / (1.0 - self._share) * (1.0 - self._stays)
            for i, u in enumerate(self._luck.random(n).tolist()):
                lost[i] = self._inside
                self._inside = u < (self._stays if self._inside else begins)
        return lost


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
