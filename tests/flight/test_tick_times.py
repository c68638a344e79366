"""What is told of ticks' timing, and that telling it costs a long flight no memory."""

import statistics
import tracemalloc

import numpy as np

from station.flight.tick_times import TickTimes


def test_the_last_ones_are_told() -> None:
    took_ms = np.random.default_rng(1).exponential(3.0, 2_500)
    times = TickTimes(kept=1_000)
    assert times.words() == ""
    for ms in took_ms:
        times.note(round(ms * 1e6))
    last = sorted(took_ms[-1_000:])
    p99 = last[989] + 0.01 * (last[990] - last[989])  # rank 0.99 (n - 1) from 0
    assert times.ticks == 2_500
    assert times.words() == (
        f"ticks done after {statistics.median(last):.2f} ms (median), {p99:.2f} ms (p99), {last[-1]:.1f} ms (worst)"
    )


def test_a_long_flight_costs_no_memory() -> None:
    times = TickTimes()
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(5_000):  # 100 s
            times.note(3_000_000)
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert grown < 5_000  # a byte a tick would be 0.17 MiB an hour; the issue allows 1 MiB an hour for all
