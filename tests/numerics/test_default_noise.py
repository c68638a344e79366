"""Noise where a rig states none: of every signal the estimators weigh, in SI, and the same of one sensor."""

import math

import pytest

from station.conventions import SIGNALS
from station.numerics.default_noise import DEFAULT_NOISE


def test_every_signal_is_one_of_conventions_and_noisy():
    assert set(DEFAULT_NOISE) <= set(SIGNALS)
    assert all(sd > 0 for sd in DEFAULT_NOISE.values())


def test_in_si():
    assert DEFAULT_NOISE["alpha_vane"] == pytest.approx(math.radians(0.05))
    assert DEFAULT_NOISE["az"] == pytest.approx(0.004 * 9.80665)


def test_airspeed_and_dynamic_pressure_are_one_sensor_s():
    """dq = rho V dV at 110 kt, 2500 ft: 1.138 kg/m3."""
    speed = 110 * 0.514444
    assert DEFAULT_NOISE["dynamic_pressure"] == pytest.approx(1.138 * speed * DEFAULT_NOISE["airspeed"], rel=0.03)
