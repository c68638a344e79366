"""A second-order instrument against its step, ramp and frequency response in closed form."""

import math

import numpy as np
import pytest

from station.numerics.second_order import (
    follow,
    inverse_terms,
    second_order,
    second_order_inverse,
    second_order_response,
    shown,
    vane_lag,
)

HZ, ZETA, DT = 9.0, 0.35, 0.02
OMEGA = 2 * math.pi * HZ


def step_response(t):
    damped = OMEGA * math.sqrt(1 - ZETA**2)
    return 1 - np.exp(-ZETA * OMEGA * t) * (np.cos(damped * t) + ZETA / math.sqrt(1 - ZETA**2) * np.sin(damped * t))


def test_step_response():
    m, s = second_order(HZ, ZETA, DT), np.array([0.0, 0.0, 1.0])
    got = [follow(m, s, 1.0) for _ in range(50)]
    np.testing.assert_allclose(got, step_response(DT * np.arange(1, 51)), atol=1e-12)


def test_a_ramp_is_shown_late_by_the_lag():
    t = DT * np.arange(200)
    np.testing.assert_allclose(shown(3.0 * t, HZ, ZETA, DT)[100:], 3.0 * (t[100:] - vane_lag(HZ, ZETA)), atol=1e-12)
    assert vane_lag(HZ, ZETA) == pytest.approx(2 * ZETA / OMEGA)


def test_it_begins_settled():
    np.testing.assert_allclose(shown(np.full(20, 0.1), HZ, ZETA, DT), 0.1, rtol=1e-12)


def test_frequency_response_at_resonance_and_at_rest():
    """At wn: 1/(2 j zeta)."""
    assert second_order_response(HZ, ZETA, 1j * OMEGA) == pytest.approx(1 / (2j * ZETA))
    assert second_order_response(HZ, ZETA, 0j) == 1.0
    s = 1j * np.array([1.0, 30.0, 200.0])
    a, b = inverse_terms(HZ, ZETA)
    np.testing.assert_allclose(second_order_inverse(HZ, ZETA, s), 1 + a * s + b * s * s, rtol=1e-12)
    np.testing.assert_allclose(second_order_response(HZ, ZETA, s) * second_order_inverse(HZ, ZETA, s), 1.0)
