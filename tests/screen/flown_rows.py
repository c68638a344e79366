"""Rows of a flight, as the loop hands them to the page."""

from __future__ import annotations

import math
from collections.abc import Iterator

import msgspec
import numpy as np

from station.conventions import LONGITUDINAL, SIGNALS, TICK_NS
from station.rows import (
    AlphaEstimate,
    Code,
    Event,
    Frame,
    Health,
    MethodEstimate,
    ParamEstimate,
    Rows,
    Status,
    StreamHealth,
    Tick,
    Truth,
)
from station.screen import plots
from station.screen.plots import Setup

BOOK = dict(zip(LONGITUDINAL, (5.64, 20.0, 0.62, -1.05, -34.2, -1.88), strict=True))
BIAS = {"II": 0.85, "III": 1.12, "V": 1.08, "split": 0.98, "split+gust": 1.0}
START_NS = 5_000_000_000_000


def flight(ticks: int, first: int = 0, seed: int = 1) -> Iterator[list[Rows]]:
    """A made-up flight, the rows of one tick at a time: doublets every 20 s, gusts, converging derivatives."""
    rng = np.random.default_rng(seed)
    gust = 0.0
    for k in range(first, first + ticks):
        t = k / 50
        t_ns = START_NS + k * TICK_NS
        phase = t % 20
        elevator = math.radians(3) * ((2 < phase < 3) - (3 < phase < 4))
        q = math.radians(4) * math.exp(-0.5 * max(0.0, phase - 2)) * math.sin(2.5 * max(0.0, phase - 2))
        gust += -0.06 * gust + math.radians(0.12) * rng.standard_normal()
        inertial = math.radians(4) + 0.8 * q
        rate = -0.09 * q
        vane = (inertial + gust) * 1.18 - rate + math.radians(0.05) * rng.standard_normal()
        upwash = -0.15 * vane
        lag = 0.1 * q
        late = -0.2 * gust
        values = [0.0] * len(SIGNALS)
        for name, value in (("elevator", elevator), ("q", q), ("airspeed", 56.6 + 2 * math.sin(t / 9))):
            values[list(SIGNALS).index(name)] = value
        valid = not 31 < t < 34
        rows: list[Rows] = [Tick(t_ns, k, t_ns - 60_000_000)]
        zeros = (0.0,) * len(SIGNALS)
        rows.append(Frame(t_ns, k, tuple(values), zeros, (0,) * len(SIGNALS)))
        rows.append(
            AlphaEstimate(
                t_ns,
                alpha=vane + upwash + rate + lag + late,
                alpha_sd=math.radians(0.12 if valid else 0.6),
                vane=vane,
                zero=0.0,
                upwash=upwash,
                rate=rate,
                lag=lag,
                gust=late,
                alpha_inertial=inertial,
                alpha_gust=gust,
                gust_vertical=56.6 * gust,
                turbulence_level=0.02 + 0.1 * (1 - math.exp(-t / 20)),
                turbulence="unknown" if t < 5 else "calm" if t < 12 else "light",
                wind_north=3.0,
                wind_east=-2.0,
                wind_down=0.1,
                valid=valid,
                why="" if valid else "boom.vanes stale",
            )
        )
        for method, bias in BIAS.items():
            found = t > 6
            share = 1.2 / math.sqrt(max(t, 1))
            parameters = tuple(
                ParamEstimate(
                    name,
                    value * (bias + 0.3 * share * math.sin(t / 5 + i)),
                    abs(value) * share * 0.5,
                    Status.ESTIMATED if found and not (name == "CL_q" and t < 15) else Status.UNESTIMATED,
                    "" if found else "not enough excitation",
                )
                for i, (name, value) in enumerate(BOOK.items())
            )
            rows.append(MethodEstimate(t_ns, method, parameters))
        rows.append(Truth(t_ns, {"alpha": inertial + gust}))
        if k % 50 == 0:
            rows.append(health(t_ns, t))
        if k == 0:
            rows.append(Event(t_ns, "station", Code.START))
        if k % 500 == 250:
            rows.append(Event(t_ns, "boom", Code.CRC, 3, "bad checksum"))
        if k == 1550:
            rows.append(Event(t_ns, "boom.vanes", Code.STALE, 1, "no sample for 0.2 s"))
        if k == 1700:
            rows.append(Event(t_ns, "boom.vanes", Code.FRESH, 1, "STALE over after 3.00 s"))
        if k % 1000 == 100:
            rows.append(Event(t_ns, "operator", Code.POINT_START, k // 1000 + 1, f"test point {k // 1000 + 1}"))
        if k % 1000 == 900:
            rows.append(Event(t_ns, "operator", Code.POINT_END, k // 1000 + 1, f"test point {k // 1000 + 1}"))
        yield rows


STREAMS = (
    ("boom.vanes", 200.0), ("can.gyro", 200.0), ("can.accel", 200.0), ("can.air", 50.0), ("can.pots", 100.0),
    ("autopilot.attitude", 50.0), ("autopilot.velocity", 50.0), ("autopilot.position", 5.0),
)  # fmt: skip


def health(t_ns: int, t: float) -> Health:
    out = 31 < t < 34
    return Health(
        t_ns,
        tuple(
            StreamHealth(
                stream=name,
                device=name.partition(".")[0],
                rate_hz=0.0 if out and name == "boom.vanes" else rate * (1 + 0.004 * math.sin(t + i)),
                age_s=t - 31 if out and name == "boom.vanes" else 0.004 + 0.3 / rate,
                clock="unsynced" if t < 2 else "converging" if t < 8 else "synced",
                offset_s=-3600.0 * (1 + i),
                drift_ppm=30.0 + i,
                samples=int(rate * t),
                gaps=int(t // 30) if i == 0 else 0,
                bad=3 * int(t // 10) if i == 0 else 0,
                alive=not (out and name == "boom.vanes"),
            )
            for i, (name, rate) in enumerate(STREAMS)
        ),
    )


NOMINAL = dict(STREAMS)
SETUP = Setup("test", "none", 0, 0, references=BOOK, nominal_hz=NOMINAL, class_limits=(0.05, 0.2, 0.5))


def lines_of(rows: list[Rows]) -> dict[str, np.ndarray]:
    """Newest point of each plot."""
    made = plots.points(plots.batch(rows, START_NS), SETUP)
    return {"/".join(p.path): p.values[-1] for p in made}


def with_alpha(**changes: object) -> list[Rows]:
    (tick,) = flight(1)
    return [msgspec.structs.replace(r, **changes) if isinstance(r, AlphaEstimate) else r for r in tick]
