"""Device clocks and links as they are made up, for the tests and the table: the truth is known."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from station.conventions import CLOCK_LAW
from station.flight.timebase import ClockMap, Exchange

S = 1_000_000_000
Times = NDArray[np.int64]
BUSY = "a busy device's queue"
DELAYS_S = {
    "an adapter's millisecond": lambda rng, n: rng.uniform(0.0, 0.001, n),
    "a bus of 5 ms": lambda rng, n: rng.uniform(0.0, 0.005, n),
    "a network's 1 ms, exponential": lambda rng, n: rng.exponential(0.001, n),
    BUSY: lambda rng, n: rng.exponential(0.002, n) + np.abs(_wander(rng, n)),
}
EXCHANGE_S = 0.25
"""Between two-way exchanges, as MAVLink's TIMESYNC is asked for."""


def _wander(rng: np.random.Generator, n: int) -> NDArray[np.float64]:
    """3 ms, changing over 50 messages: what waits before a message is sent."""
    step = 1.0 / 50
    made: NDArray[np.float64] = lfilter([0.003 * np.sqrt(2 * step)], [1.0, step - 1.0], rng.normal(size=n))
    return made


@dataclass(frozen=True, slots=True)
class Messages:
    """When each was measured, by the station's clock and the device's, and when it came."""

    true: Times
    device: Times
    arrival: Times
    rate_hz: int


def sent(rate_hz: int, seconds: float, delay: str, rng: np.random.Generator, drift_ppm: float = 40.0) -> Messages:
    count = int(rate_hz * seconds)
    true = 5 * S + (np.arange(count) * (S / rate_hz)).astype(np.int64)
    device = (true * (1.0 + 1e-6 * drift_ppm)).astype(np.int64) + 3600 * S
    late = (DELAYS_S[delay](rng, count) * S).astype(np.int64)
    return Messages(true, device, np.maximum.accumulate(true + late), rate_hz)


def jumped(messages: Messages, at_s: float, by_s: float) -> tuple[Messages, int]:
    """The same with a device clock that jumps, and the first message after it."""
    first = int(np.searchsorted(messages.true, messages.true[0] + at_s * S))
    device = messages.device.copy()
    device[first:] += round(by_s * S)
    return Messages(messages.true, device, messages.arrival, messages.rate_hz), first


def stalled(messages: Messages, rng: np.random.Generator, *, is_lossy: bool) -> Messages:
    """A station that stands still for 50 ms to 2 s, each 2 s of work, then takes all that waited at one moment; with
    `is_lossy`, only the third of it that its buffers held."""
    arrival, kept = messages.arrival.copy(), np.ones(len(messages.arrival), dtype=bool)
    at = int(messages.true[0])
    while at < messages.true[-1]:
        at += int(rng.exponential(2.0) * S)
        until = at + int(rng.choice([0.05, 0.1, 0.3, 0.8, 2.0]) * S)
        held = (messages.arrival >= at) & (messages.arrival < until)
        arrival[held] = until
        if is_lossy:
            waiting = np.flatnonzero(held)
            kept[waiting[max(1, len(waiting) // 3) :]] = False
        at = until
    arrival = np.maximum.accumulate(arrival)
    return Messages(messages.true[kept], messages.device[kept], arrival[kept], messages.rate_hz)


def starved(messages: Messages, rng: np.random.Generator) -> Messages:
    """A reader that gets the processor now and then: each 60 ms in the mean."""
    seconds = (messages.true[-1] - messages.true[0]) / S
    wakes = messages.true[0] + np.cumsum((rng.gamma(2.0, 0.03, int(seconds / 0.03)) * S).astype(np.int64))
    arrival = wakes[np.minimum(np.searchsorted(wakes, messages.arrival), len(wakes) - 1)]
    return Messages(messages.true, messages.device, arrival, messages.rate_hz)


@dataclass(frozen=True, slots=True)
class Mapping:
    """What a ClockMap made of it: at which messages it told a change, and how far off it was at each, s."""

    told: list[int]
    error_s: NDArray[np.float64]


def exchanged(messages: Messages, delay: str, rng: np.random.Generator) -> Iterator[Exchange]:
    """Station minus device clock as both ways' delays let it be seen: the middle of sending and arrival is taken for
    the moment of the answer."""
    asked = np.arange(messages.true[0], messages.true[-1], EXCHANGE_S * S).astype(np.int64)
    there, back = ((DELAYS_S[delay](rng, len(asked)) * S).astype(np.int64) for _ in range(2))
    last = np.searchsorted(messages.true, asked + there, side="right") - 1
    answered = messages.device[last] + asked + there - messages.true[last]
    yield from map(Exchange, ((2 * asked + there + back) // 2 - answered).tolist(), (there + back).tolist(),
                   (asked + there + back).tolist())  # fmt: skip


def mapped(messages: Messages, law: int = CLOCK_LAW, exchanges: Iterable[Exchange] = ()) -> Mapping:
    clock = ClockMap(round(S / messages.rate_hz), 0, law)
    told, at = [], []
    waiting = deque(sorted(exchanges, key=lambda e: e.t_ns))
    for n, (device, arrival) in enumerate(zip(messages.device.tolist(), messages.arrival.tolist(), strict=True)):
        while waiting and waiting[0].t_ns <= arrival:
            clock.exchange(*waiting.popleft())
        found = clock.update(device, arrival)
        at.append(found.t_ns)
        if found.stepped or found.jump_ns:
            told.append(n)
    return Mapping(told, (np.array(at) - messages.true) / S)
