"""A stream slower than the ticks: identify gives what the live estimator gave, with values at their own times."""

from __future__ import annotations

import functools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.clock import ManualClock
from station.conventions import STREAMS, TICK_HZ, TICK_NS, Stream
from station.estimation.flight_record import FlightRecord
from station.estimation.instrument_errors import corrector
from station.estimation.methods import Estimator
from station.flight.alignment import Aligner
from station.flight.loop import Chain, recorded_beats, run
from station.identification.analysis import identify
from station.identification.request import Request
from station.log import About, LogWriter, Table, table
from station.profile import Aircraft, Card, Doublet, Flight, Instrument, load_aircraft, load_rig
from station.rows import AlphaEstimate, Frame, Quality, Sample, Tick
from station.simulation.sortie import fly

RIG, AIRCRAFT = load_rig("bench"), load_aircraft("twin_otter")
VELOCITY = ("v_north", "v_east", "v_down")
SECONDS, START = 40.0, 25.0
LATE_NS = 60_000_000
"""Of a tick after its frame."""
STATED = AIRCRAFT.model_copy(
    update={"instruments": {"v_down": Instrument.model_validate({"gain": 1.05}, context="si")}}
)


def streams() -> tuple[Stream, ...]:
    """The rig's signals at 50 Hz, but for the velocity, which comes once a second."""
    sensed = [name for stream in RIG.streams() for name in stream.signals]
    made = []
    for s in STREAMS.values():
        signals = tuple(n for n in s.signals if n in sensed)
        for part in (tuple(n for n in signals if n not in VELOCITY), tuple(n for n in signals if n in VELOCITY)):
            if part:
                slow = part[0] in VELOCITY
                made.append(Stream(f"test.{part[0]}", part, 1.0 if slow else float(TICK_HZ), 2.5 if slow else 0.5))
    return tuple(made)


def card() -> Card:
    doublet = Doublet.model_validate({"kind": "doublet", "start": "28 s", "amplitude": "3.5 deg", "width": "0.9 s"})
    flight = Flight.model_validate({"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": "3 ft/s", "seed": 8})
    return Card(name="t", aircraft="twin_otter", rig="bench", warm_up="20 s", flight=flight, manoeuvres=(doublet,))


@functools.cache
def shown() -> dict[str, np.ndarray]:
    return fly(AIRCRAFT, RIG, card(), SECONDS, 8)[0]


def recorded(aircraft: Aircraft, folder: Path) -> tuple[Table, list[AlphaEstimate]]:
    """A recording by the loop, and the live angles of attack in it."""
    columns, flown = shown(), streams()
    rows: list[Any] = []
    for k in range(len(columns["q"])):
        t_ns = 10**10 + k * TICK_NS
        for s in flown:
            if s.rate_hz == TICK_HZ or k % TICK_HZ == 0:
                rows.append(Sample(t_ns, s.name, None, k, tuple(float(columns[n][k]) for n in s.signals)))
        rows += [Tick(t_ns + LATE_NS, k, t_ns), Frame(t_ns, k, (), (), ())]
    about = About(aircraft, flown, RIG, card())
    writer = LogWriter(folder, about, ManualClock(10**10), lambda _: None, "flight")
    noise, made = RIG.frame_noise_si(), []
    estimator = Estimator(aircraft, card(), RIG.imu_position, noise, ("split",))
    chain = Chain(estimator, None, corrector(aircraft, noise, RIG.imu_position))
    run(
        recorded_beats(rows),
        Aligner(flown, RIG.noise_si()),
        lambda: chain,
        writer,
        None,
        lambda _, rows: made.extend(r for r in rows if isinstance(r, AlphaEstimate)),
    )
    writer.close()
    return table(writer.path), made


@pytest.mark.parametrize("aircraft", [AIRCRAFT, STATED], ids=["sound", "with an instrument error undone"])
def test_identify_s_angles_of_attack_are_those_recorded_live(aircraft: Aircraft, tmp_path: Path) -> None:
    """The velocity's age in the recording is that of the flight: the same filters on the same frames, bit for bit."""
    flown, live = recorded(aircraft, tmp_path)
    held = flown.quality["v_down"] == Quality.HELD
    assert held.mean() > 0.9
    assert np.nanmax(flown.ages["v_down"][held]) > 0.9
    request = Request(("split",), START, card=card(), imu_position=RIG.imu_position, noise=RIG.frame_noise_si())
    found = identify(flown, aircraft, request).flown
    assert found is not None
    t0 = 10**10
    again = {a.t_ns: a for a in found.alphas}
    both = [(a, again[a.t_ns]) for a in live if a.t_ns in again]
    assert len(both) > (SECONDS - START - 1) * TICK_HZ
    assert both[0][0].t_ns - t0 == round(START * 1e9)
    for name in ("alpha", "alpha_inertial", "alpha_gust", "wind_down"):
        was, now = (np.array([getattr(pair[i], name) for pair in both]) for i in (0, 1))
        np.testing.assert_array_equal(now, was, err_msg=name)


def test_a_record_has_a_held_signal_at_the_times_it_was_measured() -> None:
    """A ramp known once a second is a ramp, not stairs; after the last value there is none but that."""
    columns = {n: c[:500] for n, c in shown().items()}
    t = np.arange(500) / TICK_HZ
    fix = np.floor(t + 1e-9)
    columns["v_down"] = 0.5 * fix
    psi = 3.0 + 0.2 * fix
    columns["psi"] = (psi + math.pi) % (2 * math.pi) - math.pi
    marks = np.where(t > fix + 1e-9, np.uint8(Quality.HELD), np.uint8(Quality.FRESH))
    record = FlightRecord.of(
        t,
        columns,
        AIRCRAFT,
        quality={"v_down": marks, "psi": marks},
        ages={"v_down": t - fix, "psi": t - fix},
    )
    until = t <= 9.0
    np.testing.assert_allclose(record.motion["v_down"][until], 0.5 * t[until], atol=1e-9)
    np.testing.assert_array_equal(record.motion["v_down"][~until], 4.5)
    heading = np.unwrap(record.motion["psi"][until])
    np.testing.assert_allclose(heading, 3.0 + 0.2 * t[until], atol=1e-9)
