"""Sound bytes made bad: flipped, overwritten, cut out, doubled, cut off."""

from __future__ import annotations

import random
from typing import Final

LONGEST: Final = 64
"""Bytes that are cut out or doubled at most, and of what is short a quarter: a message is to remain one."""


def mutated(data: bytes, noise: random.Random) -> bytes:
    """Flipped bits, bytes of all ones and noughts, stretches cut out or doubled, an end cut off; most often one."""
    out = bytearray(data)
    for _ in range(noise.choice((1, 1, 2, 8))):
        if not out:
            break
        at, kind = noise.randrange(len(out)), noise.randrange(6)
        stretch = noise.randrange(1, max(2, min(LONGEST, len(out) // 4)))
        if kind <= 1:
            out[at] ^= 1 << noise.randrange(8)
        elif kind == 2:
            out[at : at + 4] = noise.choice((b"\xff", b"\0", b"\x7f")) * len(out[at : at + 4])
        elif kind == 3:
            del out[at : at + stretch]
        elif kind == 4:
            out[at:at] = out[at : at + stretch]
        else:
            del out[at:]
    return bytes(out)
