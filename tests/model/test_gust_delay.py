"""Delay and upwash from gusts alone, against the simulation's aircraft, whose vane is 5.3 m ahead and reads 1.177."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from station.estimation.flight_record import FlightRecord
from station.model.gust_delay import GustDelay, gust_delay
from station.model.gust_model import Array, Equation
from station.model.inertial_path import InertialPath, inertial_path
from station.numerics.indicial import frequency_response, response
from station.numerics.regression import NotIdentifiable
from station.profile import Aircraft, Card, Flight, Indicial, Manoeuvre, Multisine, Unsteady, load_aircraft
from station.profile.uncertainty import Uncertainty
from station.simulation.sensors import STANDARD
from station.simulation.sortie import fly

NOISE = {name: sensor.noise for name, sensor in STANDARD.items()}
MULTISINE = Multisine.model_validate(
    {"kind": "multisine", "start": "0 s", "amplitude": "2 deg", "duration": "20 s", "repeat": "20 s"}
)


class Found(NamedTuple):
    made: GustDelay
    delay_s: float
    """True: vane's distance over the speed through the mean air."""


class Minute(NamedTuple):
    record: FlightRecord
    path: InertialPath
    """Of the record's last rows; its wind is that of the whole flight."""
    speed: float
    rows: slice

    def estimate(self) -> GustDelay:
        rows, record = self.rows, self.record
        motion = {name: column[rows] for name, column in record.motion.items()}
        measured: dict[Equation, Array] = {"CL": record.coefficients.CL[rows], "Cm": record.coefficients.Cm[rows]}
        return gust_delay(motion, self.path.between(rows), measured, record.aircraft, NOISE, record.dt)


def _flown(aircraft: Aircraft, seed: int, sigma: str, seconds: float, inputs: tuple[Manoeuvre, ...] = ()) -> Minute:
    """The last `seconds` of four minutes: the wind must be known from longer than the gusts last."""
    flight = Flight.model_validate({"speed": "110 kt", "gust_sigma": sigma, "seed": seed})
    card = Card(name="test", aircraft=aircraft.name, rig="", flight=flight, manoeuvres=inputs)
    shown, truth = fly(aircraft, STANDARD, card, 240.0, seed)
    # No sensor shows angular accelerations.
    shown = {name: column for name, column in shown.items() if name not in ("pdot", "qdot", "rdot")}
    record = FlightRecord.of(truth["time"], {**shown, "thrust": truth["thrust"]}, aircraft)
    path = inertial_path(record.motion, record.alpha, record.beta, record.dt)
    rows = slice(len(path.alpha) - round(seconds / record.dt), len(path.alpha))
    speed = float(np.mean(np.hypot(truth["v_north"], truth["v_down"])[rows]))
    return Minute(record, path, speed, rows)


def _found(seed: int, inputs: tuple[Manoeuvre, ...] = ()) -> Found:
    minute = _flown(load_aircraft("twin_otter"), seed, "5 ft/s", 60.0, inputs)
    return Found(minute.estimate(), 5.3 / minute.speed)


@pytest.mark.parametrize(
    "inputs", [pytest.param((), marks=pytest.mark.slow), (MULTISINE,)], ids=["gusts only", "multisine"]
)
def test_delay_within_5_ms_and_upwash_from_a_minute_of_light_turbulence(inputs: tuple[Manoeuvre, ...]) -> None:
    upwash = []
    for seed in range(1, 6):
        made, delay_s = _found(seed, inputs=inputs)
        for lead in (made.joint, made.apart["CL"], made.apart["Cm"]):
            assert abs(lead.delay_s - delay_s) < 0.005
        assert made.agree
        assert abs(made.joint.delay_s - delay_s) < 3 * made.joint.delay_statistical
        assert abs(made.joint.upwash - 0.177) < 4 * made.joint.upwash_statistical
        upwash.append(made.joint.upwash)
    # Three standard deviations of a mean of five: one is 0.009 without an input, 0.007 with.
    assert abs(np.mean(upwash) - 0.177) < (0.010 if inputs else 0.013)


def test_both_equations_know_more_than_either() -> None:
    """They share the vane's noise, which two equations tell from the gust."""
    made, _ = _found(2)
    for alone in made.apart.values():
        assert made.joint.upwash_statistical < alone.upwash_statistical
        assert made.joint.delay_statistical < alone.delay_statistical


@pytest.mark.slow
@pytest.mark.parametrize(
    ("inputs", "most"),
    [((), 0.010), ((MULTISINE,), 0.009)],
    ids=["gusts only", "multisine"],
)
def test_intervals_cover(inputs: tuple[Manoeuvre, ...], most: float) -> None:
    """Limits three standard deviations of 40 flights above what 80 gave: 0.57 ms; 0.0067 and 0.0064; cover 0.96."""
    off = []
    for seed in range(40):
        made, delay_s = _found(seed, inputs=inputs)
        lead = made.joint
        sds = lead.delay_statistical, lead.upwash_statistical
        off.append((lead.delay_s - delay_s, sds[0], lead.upwash - 0.177, sds[1]))
    delay, delay_sd, upwash, upwash_sd = np.array(off).T
    inside = [int(np.sum(np.abs(x) < 1.96 * sd)) for x, sd in ((delay, delay_sd), (upwash, upwash_sd))]
    rms = np.sqrt(np.mean(delay**2)), np.sqrt(np.mean(upwash**2))
    print(f"delay rms {1e3 * rms[0]:.2f} ms, upwash rms {rms[1]:.4f}, {inside[0]} and {inside[1]} of 40 inside")
    assert rms[0] < 0.001
    assert rms[1] < most
    assert min(inside) >= 34


def test_an_aircraft_without_memory() -> None:
    """A quasi-steady aircraft has neither tail lag nor wing memory: the same delay must come out of it."""
    aircraft = load_aircraft("twin_otter")
    steady = aircraft.model_copy(update={"unsteady": Unsteady(memory=False)})
    minute = _flown(steady, 3, "5 ft/s", 60.0)
    assert abs(minute.estimate().apart["CL"].delay_s - 5.3 / minute.speed) < 0.005


@pytest.mark.slow
def test_a_tail_other_than_the_profile_s_is_in_the_intervals() -> None:
    """A third larger: as likely as its uncertainty of 20 % allows."""
    aircraft = load_aircraft("twin_otter")
    tail = aircraft.unsteady.model_copy(update={"tail_lift_slope": 1.33 * aircraft.unsteady.tail_lift_slope})
    minute = _flown(aircraft.model_copy(update={"unsteady": tail}), 4, "5 ft/s", 60.0)
    lead = minute._replace(record=replace(minute.record, aircraft=aircraft)).estimate().joint
    assert abs(lead.upwash - 0.177) < 1.96 * lead.upwash_sd
    assert abs(lead.delay_s - 5.3 / minute.speed) < 1.96 * lead.delay_sd
    exact = dict.fromkeys(Uncertainty.model_fields, 0.0)
    known = aircraft.model_copy(update={"uncertainty": Uncertainty.model_construct(**exact)})
    lead = minute._replace(record=replace(minute.record, aircraft=known)).estimate().joint
    assert lead.upwash_sd == pytest.approx(lead.upwash_statistical)


def test_calm_air_is_refused() -> None:
    aircraft = load_aircraft("twin_otter")
    minute = _flown(aircraft, 1, "0 ft/s", 30.0, (MULTISINE,))
    with pytest.raises(NotIdentifiable, match="no gusts"):
        minute.estimate()


def test_short_record_and_missing_boom_are_refused() -> None:
    aircraft = load_aircraft("twin_otter")
    with pytest.raises(NotIdentifiable, match="needs 20 s"):
        _flown(aircraft, 1, "5 ft/s", 10.0).estimate()
    bare = aircraft.model_copy(update={"boom": None})
    with pytest.raises(NotIdentifiable, match="no boom"):
        _flown(bare, 1, "5 ft/s", 25.0).estimate()


def test_response_is_the_transform_of_the_indicial_function() -> None:
    """Against the step response integrated numerically: H = phi(0) + integral of dphi/dt exp(-jwt)."""
    indicial, speed, chord, omega = Indicial(a=(0.3, 0.2), b=(0.1, 1.5)), 50.0, 2.0, 3.0
    t = np.linspace(0.0, 60.0, 600_001)
    rates = np.array(indicial.b) * speed / chord
    slope = sum(a * b * np.exp(-b * t) for a, b in zip(indicial.a, rates, strict=True))
    expected = 1 - sum(indicial.a) + np.trapezoid(slope * np.exp(-1j * omega * t), t)
    made = frequency_response(response(indicial), np.array([1j * omega * chord / speed]))[0]
    assert math.isclose(abs(made - expected), 0.0, abs_tol=1e-6)
