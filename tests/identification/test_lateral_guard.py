"""Lateral instruments that are wrong are named, and no others; none is on sound flights. Planted errors are known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from station.conventions import LATERAL
from station.estimation.flight_record import FlightRecord
from station.identification.analysis import identify
from station.identification.by_input import by_input
from station.identification.identified import Identification
from station.identification.instrument_bias import biases, contradicted, out_of_time
from station.identification.instrument_table import SEGMENTS, Instrument, InstrumentTable, _spans, instrument_table
from station.identification.preparation import prepare
from station.identification.request import Request
from station.log import Table
from station.model.instrument_lags import Value
from station.profile import Card, load_aircraft
from station.rows import Status
from station.simulation.sensors import STANDARD, Sensor
from station.simulation.sortie import fly

Planted = Mapping[str, Mapping[str, float]]
VANE: Planted = {"beta_vane": {"gain": 1.25, "latency": 0.06}}
EXAMPLE: Planted = {**VANE, "p": {"gain": 1.1}, "r": {"latency": 0.05}, "aileron": {"gain": 0.8}}
ALONE: tuple[Planted, ...] = (
    {"beta_vane": {"gain": 1.25}}, {"beta_vane": {"latency": 0.06}}, {"p": {"gain": 1.1}}, {"r": {"latency": 0.05}},
    {"aileron": {"gain": 0.8}}, {"rudder": {"gain": 0.8}}, {"p": {"latency": 0.05}}, {"r": {"gain": 1.1}},
    {"ay": {"gain": 1.1}}, {"aileron": {"latency": 0.08}}, {"rudder": {"latency": 0.08}}, {"phi": {"latency": 0.1}},
)  # fmt: skip
AIRCRAFT = load_aircraft("twin_otter")
START, END = 30.0, 90.0
SHAPE = {"kind": "multisine", "start": "30 s", "duration": "20 s", "repeat": "20 s", "high": "1.5 Hz"}
INPUTS = [{**SHAPE, "surface": surface, "amplitude": "4 deg"} for surface in ("aileron", "rudder")]


def flown(planted: Planted, sigma: float, field: str, seed: int) -> tuple[Table, Request]:
    flight = {"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": f"{sigma} ft/s", "field": field}
    card = Card.model_validate(
        {"name": "t", "aircraft": "twin_otter", "rig": "", "flight": flight, "manoeuvres": INPUTS, "lateral": True}
    )
    sensors = {**STANDARD, **{n: replace(STANDARD.get(n, Sensor()), **e) for n, e in planted.items()}}
    shown, truth = fly(AIRCRAFT, sensors, card, END, seed)
    columns = {**shown, "thrust": truth["thrust"]}
    return Table(truth["time"], columns, AIRCRAFT, 0), Request(("II", "split", "split+gust"), START, card=card)


def words(planted: Planted, sigma: float, field: str, seed: int) -> str:
    """What is said, before any method."""
    table, request = flown(planted, sigma, field, seed)
    record = prepare(table, AIRCRAFT, request).record
    return biases(record, instrument_table(record), "wind", by_input(record, "wind", longitudinal=False)).words


def named(said: str) -> set[str]:
    return {part.split()[0] for part in said.split("; ")} if said else set()


def test_the_errors_planted_are_found_and_no_others() -> None:
    """A wrong vane and a wrong gyro make pitch rate, airspeed and the other vane look wrong, of which none is."""
    table, request = flown(EXAMPLE, 0.0, "line", 1)
    record = prepare(table, AIRCRAFT, request).record
    instruments = instrument_table(record)
    assert not isinstance(instruments, str)
    errors = contradicted(record, instruments)
    assert errors.keys() == {"beta_vane", "p", "r"}
    assert errors["beta_vane"].scale == pytest.approx(1.25, rel=0.02)
    assert errors["beta_vane"].late == pytest.approx(0.06, abs=0.015)
    assert errors["p"].scale == pytest.approx(1.1, rel=0.005)
    assert errors["r"].late == pytest.approx(0.05, abs=0.01)
    assert named(words(EXAMPLE, 0.0, "line", 1)) == EXAMPLE.keys()


@pytest.mark.slow
@pytest.mark.parametrize(("sigma", "field"), [(0.0, "line"), (5.0, "plane")])
def test_a_late_roll_angle_is_not_taken_for_early_gyros(sigma: float, field: str) -> None:
    """Roll rate alone cannot tell: side force and the vane do, which gravity moves by the roll angle."""
    table, request = flown({"phi": {"latency": 0.1}}, sigma, field, 1)
    record = prepare(table, AIRCRAFT, request).record
    instruments = instrument_table(record)
    assert not isinstance(instruments, str)
    errors = contradicted(record, instruments)
    assert errors.keys() == {"phi"}
    assert errors["phi"].late == pytest.approx(0.1, abs=0.015)


def test_a_scale_above_one_is_named_no_sooner_than_one_below() -> None:
    """Its logarithm is what is estimated, here 2.9 standard deviations from none: a sound flight's at 10 ft/s."""
    record = cast(FlightRecord, SimpleNamespace(aircraft=AIRCRAFT))
    unknown = Value(np.nan, np.nan, "hardly moves")
    for sd, named in ((0.039, False), (0.030, True)):
        for scale in (1.12, 1 / 1.12):
            row = Instrument("beta_vane", (), unknown, Value(scale, scale * sd), unknown, {})
            assert (contradicted(record, InstrumentTable((row,), np.nan, 60.0, 2.5)) != {}) is named


def test_a_long_record_is_compared_where_it_pitched_and_where_it_rolled() -> None:
    """Twenty minutes: pitching in the third to the sixth, rolling from the eleventh to the fourteenth."""
    t = np.arange(0.0, 1200.0, 0.1)
    shaken = np.sin(2.0 * t)
    q, p = (np.where((t >= 60 * a) & (t < 60 * b), 0.1 * shaken, 0.001 * shaken) for a, b in ((2, 6), (10, 14)))
    for motions, minutes in (([[q]], {(120, 360)}), ([[q], [p, 0 * p]], {(120, 360), (600, 840)})):
        spans = _spans(np.ones(len(t), bool), motions, 0.1)
        assert len(spans) == SEGMENTS
        for a, b in minutes:
            inside = [s for s in spans if s.start * 0.1 < b and s.stop * 0.1 > a]
            assert len(inside) >= 4, (spans, a, b)


@pytest.mark.parametrize(("sigma", "field"), [(0.0, "line"), (5.0, "plane")])
def test_a_sound_flight_is_not_doubted(sigma: float, field: str) -> None:
    """Nor an elevator that keeps still, nor an aileron where gusts roll the aircraft, nor an airspeed that turns."""
    assert words({}, sigma, field, 2) == ""


def test_a_surface_s_lag_is_told_from_its_moment() -> None:
    table, request = flown({"aileron": {"latency": 0.08}}, 0.0, "line", 1)
    record = prepare(table, AIRCRAFT, request).record
    late = out_of_time(record, "wind")
    assert late.keys() == {"aileron"}
    assert late["aileron"].late == pytest.approx(0.08, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("planted", ALONE, ids=lambda p: " ".join(f"{n} {next(iter(e))}" for n, e in p.items()))
def test_each_error_alone_is_named_alone(planted: Planted) -> None:
    """In still air; in gusts, whose errors are wider, nothing else is."""
    assert named(words(planted, 0.0, "line", 3)) == planted.keys()
    assert named(words(planted, 5.0, "plane", 4)) <= planted.keys()


@pytest.mark.slow
def test_of_forty_sound_flights_few_are_doubted() -> None:
    """None in still air. In gusts some twenty lags and scales are held to three standard errors each, which one flight
    in twenty exceeds by chance: of twenty flights more than four are 1 in 400."""
    seeds = range(1, 11)
    still, gusts = (
        [w for field in ("line", "plane") for seed in seeds if (w := words({}, sigma, field, seed))]
        for sigma in (0.0, 5.0)
    )
    assert still == []
    assert len(gusts) <= 4, gusts


@pytest.mark.slow
def test_intervals_hold_what_the_errors_do_to_derivatives() -> None:
    """Of five flights each, in still air and in gusts; at two standard errors 95 % are expected of intervals that are
    no wider than they must be, and these hold the whole error."""
    for sigma, field in ((0.0, "line"), (5.0, "plane")):
        flights = [flown(EXAMPLE, sigma, field, seed) for seed in range(1, 6)]
        held = [h for table, request in flights for h in _held(identify(table, AIRCRAFT, request))]
        assert np.mean(held) > 0.95, (sigma, field)


def _held(found: Identification) -> list[bool]:
    estimates = [p for result in found.methods.values() if result.status == "ok" for p in result.parameters]
    called = [p for p in estimates if p.name in LATERAL and p.status is Status.ESTIMATED]
    return [abs(p.value - AIRCRAFT.value(p.name)) <= 1.96 * p.sd for p in called]
