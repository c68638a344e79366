"""Interpolation: exact for polynomials of its degree, and its error for a sine."""

import math

import numpy as np
import pytest

from station.numerics.lagrange import cubic, cubic_slope, delayed, quintic, uneven_cubic


def polynomial(x):
    return 2.0 - 3.0 * x + 0.5 * x**2 + 0.7 * x**3


def test_a_cubic_is_met_exactly_with_its_slope():
    f = np.linspace(0.0, 1.0, 11)
    four = [polynomial(x) for x in (-1.0, 0.0, 1.0, 2.0)]
    np.testing.assert_allclose(cubic(*four, f), polynomial(f), atol=1e-14)
    np.testing.assert_allclose(cubic_slope(*four, f), -3.0 + f + 2.1 * f**2, atol=1e-13)


def test_a_quintic_is_met_exactly_wherever_it_is_asked():
    f = np.linspace(-2.0, 3.0, 21)

    def polynomial(x):
        return 2.0 - 3.0 * x + 0.5 * x**2 + 0.7 * x**3 - 0.4 * x**4 + 0.1 * x**5

    six = [polynomial(x) for x in (-2.0, -1.0, 0.0, 1.0, 2.0, 3.0)]
    np.testing.assert_allclose(quintic(*six, f), polynomial(f), atol=1e-12)


def test_a_quintic_loses_a_thousandth_of_three_hertz_at_twenty_five():
    """The remainder of Lagrange's quintic in the middle is 225/46080 (omega dt)^6."""
    turn = 2 * math.pi * 3.0 * 0.04
    six = [math.cos(turn * (k - 0.5)) for k in range(-2, 4)]
    assert abs(quintic(*six, 0.5) - 1.0) < 225 / 46080 * turn**6 < 1e-3


def test_uneven_times():
    times = (-0.3, 0.1, 0.25, 0.9)
    assert uneven_cubic(times, tuple(polynomial(t) for t in times), 0.2) == pytest.approx(polynomial(0.2), abs=1e-14)


@pytest.mark.parametrize("ticks", [0.0, 0.4, 1.0, 2.3, 7.0, 9.75])
def test_a_sine_some_ticks_ago(ticks):
    """The remainder of Lagrange's cubic between the middle two is below 9/384 (omega dt)^4, of the parabola below
    (omega dt)^3/9 sqrt(3); rounding besides."""
    step = 0.1
    newest = 37
    ring = np.zeros(16)
    for k in range(newest + 1):
        ring[k % 16] = math.sin(step * k)
    bound = 9 / 384 * step**4 if ticks > 1.0 else step**3 / (9 * math.sqrt(3))
    assert delayed(ring, newest, ticks) == pytest.approx(math.sin(step * (newest - ticks)), abs=bound + 1e-15)
    if ticks == int(ticks):
        assert delayed(ring, newest, ticks) == ring[(newest - int(ticks)) % 16]


def test_before_the_ring_and_ahead_of_now_the_nearest():
    ring = np.arange(8.0)
    assert delayed(ring, 7, -3.0) == 7.0
    assert delayed(ring, 7, 100.0) == 3.0
