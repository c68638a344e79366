"""What recording costs a tick: 25 rows of a busy flight. Printed, not asserted."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.clock import ManualClock
from station.conventions import SIGNALS, TICK_NS, Stream
from station.log import About, LogWriter, read_rows, write_log
from station.profile import load_aircraft
from station.rows import (
    AlphaEstimate,
    Frame,
    MethodEstimate,
    ParamEstimate,
    RawBlock,
    Rows,
    Sample,
    Status,
    Tick,
)

STREAMS = (
    Stream("boom.vanes", ("alpha_vane", "beta_vane", "elevator"), 200.0, 0.1, "boom"),
    Stream("can.gyro", ("p", "q", "r"), 200.0, 0.1, "can"),
    Stream("can.accel", ("ax", "ay", "az"), 200.0, 0.1, "can"),
)
DERIVATIVES = ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")


def tick_rows(k: int, rng: np.random.Generator) -> list[Rows]:
    t = k * TICK_NS
    rows: list[Rows] = [RawBlock(t, "boom", rng.bytes(60)), RawBlock(t, "can", rng.bytes(200))]
    for stream in STREAMS:
        for i in range(4):
            at = t + i * 5_000_000
            values = tuple(rng.normal(size=3).tolist())
            rows.append(Sample(at, stream.name, at + 10**12, (4 * k + i) % 256, values))
    frame = [*rng.normal(size=24).tolist(), *[math.nan] * (len(SIGNALS) - 24)]
    rows.append(Tick(t, k, t - 60_000_000))
    rows.append(Frame(t, k, tuple(frame), (0.0,) * len(SIGNALS), (0,) * len(SIGNALS)))
    x = rng.normal(size=15).tolist()
    rows.append(AlphaEstimate(t, *x[:12], "light", *x[12:], True, ""))
    for method in ("II", "III", "V", "split", "split+gust"):
        values = rng.normal(size=(6, 2)).tolist()
        parameters = tuple(
            ParamEstimate(n, v, sd, Status.ESTIMATED) for n, (v, sd) in zip(DERIVATIVES, values, strict=True)
        )
        rows.append(MethodEstimate(t, method, parameters))
    return rows


@pytest.fixture(scope="module")
def ticks() -> list[list[Rows]]:
    rng = np.random.default_rng(1)
    return [tick_rows(k, rng) for k in range(500)]


def test_cost_of_recording_a_tick(benchmark: Any, tmp_path: Path, ticks: list[list[Rows]]) -> None:
    clock = ManualClock()
    writer = LogWriter(tmp_path, About(load_aircraft("twin_otter"), STREAMS), clock, lambda event: None, "flight")
    k = 0

    def tick() -> None:
        nonlocal k
        writer.append(ticks[k % len(ticks)])
        writer.flush()
        clock.advance_s(0.02)
        k += 1

    benchmark.pedantic(tick, rounds=1500, warmup_rounds=100)
    writer.close()
    benchmark.extra_info["rows"] = len(ticks[0])
    benchmark.extra_info["bytes_per_tick"] = round(writer.path.stat().st_size / k)


def test_cost_of_reading_rows(benchmark: Any, tmp_path: Path, ticks: list[list[Rows]]) -> None:
    rows = [row for tick in ticks for row in tick]
    write_log(tmp_path / "flight.mcap", About(load_aircraft("twin_otter"), STREAMS), rows)
    count = benchmark(lambda: sum(1 for _ in read_rows(tmp_path / "flight.mcap")))
    assert count == len(rows)
