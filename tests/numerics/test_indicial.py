"""Indicial responses against their closed forms in time and frequency."""

import numpy as np
import pytest

from station.numerics.indicial import frequency_response, lagged, respond, respond_throughout, response
from station.profile import Indicial
from station.profile.aircraft import MOST_TERMS

WAGNER = Indicial(a=(0.165, 0.335), b=(0.091, 0.6))
"""R. T. Jones 1940, per chord."""


def test_a_step_gives_the_indicial_function_itself():
    """Once the step is done the input is constant, and 1 - sum a exp(-b t) from there on exact."""
    lags = np.zeros(MOST_TERMS)
    chords = 0.25
    a, b = np.array(WAGNER.a), np.array(WAGNER.b)
    for k in range(1, 80):
        got = respond(response(WAGNER), lags, 1.0, 1.0, chords)
        t = k * chords
        assert got == pytest.approx(1.0 - np.sum(a * np.exp(-b * t)), abs=1e-14)


def test_a_lag_of_a_ramp_is_exact():
    """x' = (u - x)/T, u = t: x = t - T (1 - exp(-t/T)), whatever the step."""
    x, steps = 0.0, 0.7
    for k in range(10):
        x = lagged(x, k * steps, (k + 1) * steps, steps)
    t = 10 * steps
    assert x == pytest.approx(t - (1.0 - np.exp(-t)), rel=1e-14)


def test_frequency_response():
    """By hand at one exponential: 1 - a s/(s + b)."""
    s = np.array([0.0j, 0.5j, 1e6j])
    single = Indicial(a=(0.4,), b=(0.5,))
    np.testing.assert_allclose(
        frequency_response(response(single), s), [1.0, 1.0 - 0.4 * 0.5j / (0.5 + 0.5j), 0.6], atol=1e-6
    )
    np.testing.assert_array_equal(frequency_response(response(None), s), np.ones(3))


def test_a_sine_through_time_is_the_frequency_response():
    """Straight lines between 40 samples a period lose (omega dt)^2/12 = 0.2 % of the sine."""
    n, per_period = 4000, 40
    omega_dt = 2 * np.pi / per_period
    chords = np.full(n, 0.2)
    x = np.sin(omega_dt * np.arange(n))
    out = respond_throughout(response(WAGNER), chords, x)
    last = slice(n - 10 * per_period, n)
    phase = np.exp(-1j * omega_dt * np.arange(n)[last])
    ratio = np.sum(out[last] * phase) / np.sum(x[last] * phase)
    expected = frequency_response(response(WAGNER), 1j * omega_dt / 0.2)
    assert abs(ratio - expected) < omega_dt**2 / 12
