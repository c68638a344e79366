"""Inertial angle of attack and wind against motions worked out by hand."""

import math

import numpy as np
import pytest

from station.conventions import G0, ned_from_body
from station.estimation import inertial
from station.estimation.inertial import Air, Motion, Streams
from station.numerics.named_state import blank, packed

DT = 0.02
SPEED = 60.0


class Inertial:
    """The kernel and its state."""

    def __init__(self, arm):
        self.constants = packed(inertial.Constants(DT, np.array(arm)))[0]
        self.state = blank(inertial.State)[0]

    def step(self, t, imu, streams, air):
        inertial.step(self.constants, self.state, t, Motion(*imu.tolist()), Air(*air), Streams(*streams))

    @property
    def flow(self):
        return inertial.Flow(*self.state["flow"].item())

    @property
    def wind(self):
        return self.flow.wind_north, self.flow.wind_east, self.flow.wind_down


def fly(motion, velocity_every=1, late_s=0.0, arm=(0.0, 0.0, 0.0), seconds=40.0, heading=0.7, wind=(0.0, 0.0, 0.0)):
    """Inertial angle of attack and truth, deg, over the last half; `motion(t)` gives theta and alpha.

    Wings level, constant speed through the air along a path of slope theta - alpha. Rates and specific forces come from
    differences of the path over 0.1 ms, the stream from the path itself at the time of its sample.
    """
    filter_ = Inertial(arm)
    wind = np.array(wind)

    def ground_velocity(t):
        theta, alpha = motion(t)
        slope = theta - alpha
        forward, down = SPEED * math.cos(slope), -SPEED * math.sin(slope)
        return np.array([forward * math.cos(heading), forward * math.sin(heading), down]) + wind

    h = 1e-4
    got, true = [], []
    held, held_at = np.full(3, math.nan), 0.0
    for k in range(round(seconds / DT)):
        t = k * DT
        theta, alpha = motion(t)
        q = (motion(t + h)[0] - motion(t - h)[0]) / (2 * h)
        qdot = (motion(t + h)[0] - 2 * theta + motion(t - h)[0]) / h**2
        earth = (ground_velocity(t + h) - ground_velocity(t - h)) / (2 * h) - np.array([0.0, 0.0, G0])
        fx, fy, fz = ned_from_body(0.0, theta, heading).T @ earth
        x, _, z = arm
        imu = np.array([0.0, q, 0.0, fx + qdot * z - q * q * x, fy, fz - qdot * x - q * q * z])
        if k % velocity_every == 0:
            held_at = t - late_s
            held = ground_velocity(held_at)
        attitude = np.array([0.0, theta, heading])
        ages = np.zeros(3)
        air = (SPEED, alpha, 0.0)
        filter_.step(t, imu, (attitude, ages, held, np.full(3, t - held_at)), air)
        if t > seconds / 2:
            got.append(math.degrees(filter_.flow.alpha))
            true.append(math.degrees(alpha))
    return np.array(got), np.array(true), filter_


def porpoise(t):
    """theta and alpha of a pitching motion with a phase between them, rad."""
    return 0.05 + 0.06 * math.sin(2.1 * t), 0.04 + 0.04 * math.sin(2.1 * t - 0.6)


def test_fifty_hertz_streams_give_the_motion():
    got, true, _ = fly(porpoise)
    assert np.abs(got - true).max() < 0.05


def test_a_fast_motion_keeps_its_size():
    """At 2 Hz straight lines between samples would lose (w dt)^2/12 = 0.5 % of it, twice."""
    w = 4 * math.pi
    got, true, _ = fly(lambda t: (0.05 + 0.02 * math.sin(w * t), 0.04 + 0.03 * math.sin(w * t - 0.6)))
    assert np.dot(got - got.mean(), true - true.mean()) / np.dot(true - true.mean(), true) == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize(("every", "late"), [(10, 0.0), (50, 0.0), (50, 0.2), (10, 0.3)])
def test_slow_and_late_velocity_costs_nothing(every, late):
    got, true, _ = fly(porpoise, every, late)
    assert np.std(got - true) < 0.04


def test_a_held_velocity_without_its_age_would_be_far_off():
    """The oracle for the tests above: what the same 1 Hz stream gives where each value is taken as of now."""
    slow = [porpoise(math.floor(t))[0] - porpoise(math.floor(t))[1] for t in np.arange(20, 40, DT)]
    now = [porpoise(t)[0] - porpoise(t)[1] for t in np.arange(20, 40, DT)]
    assert math.degrees(np.std(np.subtract(slow, now))) > 1.0


def test_accelerometer_ahead_of_the_cg():
    got, true, _ = fly(porpoise, 50, arm=(2.0, 0.0, -0.5))
    assert np.std(got - true) < 0.05


def test_mean_wind_is_found_and_taken_out():
    got, true, filter_ = fly(porpoise, wind=(6.0, -9.0, 0.0), seconds=60)
    assert filter_.wind == pytest.approx([6.0, -9.0, 0.0], abs=0.1)
    assert np.std(got - true) < 0.05


def test_without_any_velocity_the_air_data_carry_the_slow_part():
    filter_ = Inertial((0.0, 0.0, 0.0))
    missing, ages = np.full(3, math.nan), np.zeros(3)
    for k in range(2000):
        attitude = np.array([0.0, 0.05, 0.0])
        imu = np.array([0.0, 0.0, 0.0, G0 * math.sin(0.05), 0.0, -G0 * math.cos(0.05)])
        filter_.step(k * DT, imu, (attitude, ages, missing, missing), (SPEED, 0.04, 0.0))
    assert filter_.flow.alpha == pytest.approx(0.04, abs=1e-4)
    assert filter_.wind == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)


def test_level_turn_at_thirty_degrees_of_bank():
    """A level turn: the path is a circle, alpha follows from bank and pitch: no gust, so inertial equals true."""
    bank, alpha, speed = math.radians(30), math.radians(5), SPEED
    rate = G0 * math.tan(bank) / speed
    # Found by solving for pitch and drift of the nose from the track.
    theta, drift = 0.0, 0.0
    for _ in range(50):
        u, v, w = ned_from_body(bank, theta, drift).T @ np.array([speed, 0.0, 0.0])
        theta += alpha - math.atan2(w, u)
        drift += math.atan2(v, speed)
    filter_ = Inertial((0.0, 0.0, 0.0))
    for k in range(1500):
        track = rate * k * DT
        rotation = ned_from_body(bank, theta, track + drift)
        velocity = speed * np.array([math.cos(track), math.sin(track), 0.0])
        centripetal = speed * rate * np.array([-math.sin(track), math.cos(track), 0.0])
        force = rotation.T @ (centripetal - np.array([0.0, 0.0, G0]))
        rates = rotation.T @ np.array([0.0, 0.0, rate])
        attitude = np.array([bank, theta, math.remainder(track + drift, 2 * math.pi)])
        streams = (attitude, np.zeros(3), velocity, np.zeros(3))
        filter_.step(k * DT, np.concatenate([rates, force]), streams, (speed, alpha, 0.0))
    assert math.degrees(filter_.flow.alpha) == pytest.approx(5.0, abs=0.02)
    assert math.degrees(filter_.flow.beta) == pytest.approx(0.0, abs=0.02)
    assert filter_.wind == pytest.approx([0.0, 0.0, 0.0], abs=0.05)
