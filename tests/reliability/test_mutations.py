"""Whatever comes in, a codec counts it and a reader refuses it or reads it; nothing raises, hangs or grows."""

from __future__ import annotations

import pytest

from drivers.codec import Codec, Reading, TimeReply
from drivers.protocols import PROTOCOLS
from drivers.serial_boombox import BoomboxCodec
from tests.reliability.mutations import LINKS, NAMES, Flown, Link, fly, fly_link, links


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("inputs", [60, pytest.param(20_000, marks=pytest.mark.slow)])
def test_mutated_inputs(name: str, inputs: int) -> None:
    flown = fly(name, inputs, seconds=600.0)
    assert flown.is_sound, flown.words()
    assert flown.inputs == inputs
    assert flown.read < inputs


class Raising(Codec):
    """Trips over what the boom box's own counts as bad."""

    def __init__(self) -> None:
        self.bad = self.resyncs = 0
        self._codec = BoomboxCodec()

    def feed(self, data: bytes) -> list[Reading | TimeReply]:
        found = self._codec.feed(data)
        if self._codec.bad > self.bad:
            self.bad = self._codec.bad
            raise ValueError("bad")
        return found

    def reset(self) -> None:
        self._codec.reset()


def test_each_link_is_there() -> None:
    assert tuple(links()) == LINKS
    assert set(PROTOCOLS) < set(LINKS)


def test_a_codec_that_raises_is_seen() -> None:
    flown = Flown("raising")
    flight = fly_link("raising", Link(Raising, links()["boombox"].sound), flown, seed=1)
    for _ in range(50):
        next(flight)
    assert flown.raised > 10
    assert "ValueError: bad" in flown.first
    assert not flown.is_sound
