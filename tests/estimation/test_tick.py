"""One tick of all filters against flight worked out by hand: steady and level in still air, then what is missing."""

import math

import numpy as np
import pytest

from station.conventions import G0
from station.estimation import conditioning as cond
from station.estimation import tick
from station.estimation.equation_error import Sides
from station.numerics.named_state import blank
from station.profile import load_aircraft

DT = 0.02
AIRCRAFT = load_aircraft("twin_otter")
BOOM = AIRCRAFT.boom
SPEED, ALPHA, PRESSURE, MASS = 56.0, 0.07, 1700.0, 5000.0
HEADING = 0.6


def level() -> np.ndarray:
    """Inputs of steady level flight: pitch is the angle of attack, and the accelerometers feel gravity alone."""
    u = np.full(len(cond.INPUTS), math.nan)
    u[cond.VANE] = BOOM.zero + (1.0 + BOOM.upwash_body + BOOM.upwash_wing) * ALPHA
    u[[cond.P, cond.Q, cond.R, cond.AY, cond.ELEVATOR, cond.THRUST]] = 0.0, 0.0, 0.0, 0.0, 0.03, 0.0
    u[cond.AX], u[cond.AZ] = G0 * math.sin(ALPHA), -G0 * math.cos(ALPHA)
    u[cond.AIRSPEED], u[cond.QBAR], u[cond.MASS] = SPEED, PRESSURE, MASS
    u[cond.ATTITUDE : cond.VELOCITY] = 0.0, ALPHA, HEADING
    u[cond.VELOCITY :] = SPEED * math.cos(HEADING), SPEED * math.sin(HEADING), 0.0
    return u


class Flight:
    """Constants and state of some ticks."""

    def __init__(self, has_signals: bool = True) -> None:
        self.constants = tick.constants(AIRCRAFT, (0.0, 0.0, 0.0), DT, has_signals=has_signals)
        self.state, self.sides, self.k = blank(tick.State), Sides(AIRCRAFT, (0.0, 0.0, 0.0), DT, False), 0
        tick.restart(self.state)

    def step(self, u: np.ndarray) -> int:
        self.k += 1
        return tick.advance(self.constants, self.state, self.sides.arrays, self.k * DT, u, np.zeros(len(u)))

    def seen(self, name: str) -> float:
        return float(self.state["vane"]["seen"][name][0])


def test_steady_level_flight_is_all_motion_and_its_lift_is_the_weight() -> None:
    flight = Flight()
    done = [flight.step(level()) for _ in range(400)]
    assert done[-1] == tick.MADE + tick.SPLIT
    # The split needs the inertial filter's two seconds and one of its own.
    assert done.index(tick.MADE + tick.SPLIT) == pytest.approx(150, abs=2)
    assert flight.seen("steady") == pytest.approx(ALPHA, abs=1e-12)
    assert flight.seen("split") == pytest.approx(ALPHA, abs=1e-9)
    assert flight.seen("gust") == pytest.approx(0.0, abs=1e-9)
    assert flight.state["inertial"]["flow"]["alpha"][0] == pytest.approx(ALPHA, abs=1e-9)
    assert flight.state["unexplained"][0] == pytest.approx(0.0, abs=1e-15)
    rate, elevator, lift, moment = flight.sides.out[:4]
    assert (rate, elevator, moment) == (0.0, 0.03, 0.0)
    assert lift == pytest.approx(MASS * G0 / (PRESSURE * AIRCRAFT.geometry.wing_area), rel=1e-9)


def test_a_gust_at_the_vane_is_at_the_cg_when_it_has_flown_there() -> None:
    """A step of 0.02 rad, slower than the vane: all of it at the boom first, none at the CG until x/V later."""
    flight = Flight()
    for _ in range(400):
        flight.step(level())
    ticks = (BOOM.gust_x / SPEED - BOOM.vane_damping / (math.pi * BOOM.vane_frequency)) / DT
    gusty = level()
    gusty[cond.VANE] += (1.0 + BOOM.upwash_body) * 0.02
    arrived = []
    for _ in range(math.floor(ticks) + 4):
        flight.step(gusty)
        arrived.append(flight.seen("gust"))
    # The cubic between ticks reaches two samples ahead of the step.
    assert np.abs(arrived[: math.floor(ticks) - 2]).max() < 1e-9
    assert arrived[-1] > 0.015


def test_a_pitch_rate_that_is_missing_ends_the_split_and_makes_no_sample() -> None:
    flight = Flight()
    for _ in range(400):
        flight.step(level())
    broken = level()
    broken[cond.Q] = math.nan
    assert flight.step(broken) == 0
    assert not flight.state["inertial"]["flow"]["is_ready"][0]
    assert flight.step(level()) & tick.SPLIT == 0


def test_without_attitude_there_are_samples_but_no_split() -> None:
    flight, u = Flight(), level()
    u[cond.ATTITUDE :] = math.nan
    assert [flight.step(u) for _ in range(300)][-1] == tick.MADE
    assert math.isnan(flight.seen("split"))
    assert flight.sides.out[4] == pytest.approx(ALPHA, abs=1e-12)


def test_rates_and_side_force_that_are_missing_count_as_none() -> None:
    constants, u = Flight().constants[0], level()
    u[[cond.P, cond.R, cond.AY]] = math.nan
    u[cond.Q], u[cond.BETA] = 0.1, math.nan
    motion, air = tick.prepare(constants, u)
    assert (motion.p, motion.q, motion.r, motion.ay) == (0.0, 0.1, 0.0, 0.0)
    assert air.alpha == pytest.approx(ALPHA + BOOM.vane_x * 0.1 / SPEED)
    assert air.beta == 0.0


def test_the_wind_s_standard_error_needs_no_signals_of_wing_and_tail() -> None:
    rng = np.random.default_rng(1)
    both = Flight(True), Flight(False)
    for _ in range(600):
        u = level()
        u[cond.AIRSPEED] += rng.normal()
        for flight in both:
            flight.step(u)
    assert both[0].state["wind_sd"][0] == both[1].state["wind_sd"][0] > 0.0
