"""Derivatives against closed forms: exact polynomials, and what each rule loses of a sine."""

import numpy as np
import pytest

from station.numerics.differentiation import backward, central, derivative, differentiate, differentiate_factor
from station.numerics.spectra import central_difference_factor

DT = 0.02
T = np.arange(200) * DT


def test_the_parabola_s_slope_is_exact_for_parabolas_up_to_the_ends():
    x = 3 - 2 * T + 5 * T**2
    np.testing.assert_allclose(differentiate(x, DT), -2 + 10 * T, atol=1e-9)


def test_fourth_order_is_exact_for_quartics_inside():
    x = np.stack([1 + T - T**3 + 0.3 * T**4, 2 * T])
    np.testing.assert_allclose(derivative(x, DT)[0, 2:-2], (1 - 3 * T**2 + 1.2 * T**3)[2:-2], atol=1e-10)
    np.testing.assert_allclose(derivative(x, DT)[1], 2.0, atol=1e-10)


@pytest.mark.parametrize("n", [2, 3, 4])
def test_few_samples_still_have_the_slope_of_a_line(n):
    np.testing.assert_allclose(derivative(2.0 * np.arange(n), 1.0), 2.0)


def test_the_parabola_wants_five_samples():
    with pytest.raises(ValueError, match="5 samples"):
        differentiate(np.zeros(4), DT)


@pytest.mark.parametrize("hz", [0.3, 1.0, 3.0])
def test_what_a_sine_loses(hz):
    """sin(w t) gives cos(w t) times w and the rule's gain, whatever t: fourth order (8 sin x - sin 2x)/6x, central
    sin x/x, the parabola as its factor says."""
    w = 2 * np.pi * hz
    x, inside = w * DT, slice(2, -2)
    cosine = w * np.cos(w * T)[inside]
    sine = np.sin(w * T)
    np.testing.assert_allclose(
        derivative(sine, DT)[inside], cosine * (8 * np.sin(x) - np.sin(2 * x)) / (6 * x), atol=1e-11
    )
    np.testing.assert_allclose(differentiate(sine, DT)[inside] * differentiate_factor(np.array(x)), cosine, atol=1e-11)
    three = central(sine[3:-1], sine[1:-3], DT)
    np.testing.assert_allclose(three * central_difference_factor(np.array([hz]), DT), cosine, atol=1e-11)


def test_backward_is_exact_for_a_parabola():
    x = 4 + 3 * T - 7 * T**2
    np.testing.assert_allclose(backward(x[2:], x[1:-1], x[:-2], DT), (3 - 14 * T)[2:], atol=1e-10)
