"""What a link may cost: above it bytes go unread and unrecorded, counted, so that none takes the machine from others.

Two allowances, both far above what a link in order brings. Noise: bytes of no sound message, whatever was done to make
them costly. And all bytes: those of the rig's messages, and as much again as a bus or a modem carries besides.
"""

from __future__ import annotations

from typing import Final

NOISE_BYTES_S: Final = 100_000
"""A serial port of 921,600 baud carries 92,000: where a cable is broken all that comes is still looked at."""
OTHER_BYTES_S: Final = 250_000
"""Messages that the rig does not name: a CAN bus of 1 Mbit/s carries 8,000 frames of 23 letters each second."""
MESSAGE_BYTES: Final = 100
"""For each message that the rig names: MAVLink's longest of those that are read has 73 (GPS2_RAW, signed)."""


class Allowance:
    """So many bytes a second, as many at once; when they are spent, none until half of them has come back."""

    def __init__(self, rate: float) -> None:
        self._rate = self._left = rate
        self._t_ns: int | None = None
        self._is_spent = False

    def spend(self, size: int) -> None:
        self._left -= size
        self._is_spent = self._is_spent or self._left < 0

    def is_spent(self, t_ns: int) -> bool:
        passed_s = 0.0 if self._t_ns is None else max(0, t_ns - self._t_ns) * 1e-9
        self._t_ns = t_ns
        self._left = min(self._rate, self._left + passed_s * self._rate)
        self._is_spent = self._is_spent and self._left < 0.5 * self._rate
        return self._is_spent


class Shedding:
    """Which of a link's blocks are taken; counts those that are not."""

    def __init__(self, messages_s: float) -> None:
        """`messages_s`: those of the rig, a second."""
        self.bytes_s = OTHER_BYTES_S + MESSAGE_BYTES * messages_s
        self._all, self._noise = Allowance(self.bytes_s), Allowance(NOISE_BYTES_S)
        self.words = f"blocks of bytes not read or recorded: above {self.bytes_s * 1e-3:.0f} kB/s"
        self.noise_words = f"bytes not read or recorded: above {NOISE_BYTES_S * 1e-3:.0f} kB/s of noise"
        self.blocks = 0
        """Not taken, as the link brings too much."""
        self.noise_bytes = 0
        """In blocks that were not taken, as too much of what came was noise."""

    def takes(self, size: int, t_ns: int) -> bool:
        """Whether a block of so many bytes is to be read and recorded."""
        is_noise, is_much = self._noise.is_spent(t_ns), self._all.is_spent(t_ns)
        if is_noise:
            self.noise_bytes += size
        elif is_much:
            self.blocks += 1
        else:
            self._all.spend(size)
        return not (is_noise or is_much)

    def heard_noise(self, size: int) -> None:
        """Of what was taken so many bytes were noise."""
        self._noise.spend(size)
