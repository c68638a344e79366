"""The vortex lattice against closed forms: Wagner, Kuessner and Sears in two dimensions, Jones for aspect ratio 6."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import hankel2, jv

from station.numerics.vortex_lattice import Lattice, WingResponse, ellipse, trapezoid, wing_response

Array = NDArray[np.float64]

NOWHERE = np.zeros((0, 3))


def theodorsen(k: Array) -> NDArray[np.complex128]:
    return np.asarray(hankel2(1, k) / (hankel2(1, k) + 1j * hankel2(0, k)))


def sears_of_the_edge(k: Array) -> NDArray[np.complex128]:
    """Of a gust seen at the leading edge."""
    return np.asarray(((jv(0, k) - 1j * jv(1, k)) * theodorsen(k) + 1j * jv(1, k)) * np.exp(-1j * k))


def step_of(transfer: NDArray[np.complex128], k: Array, semichords: float, at_once: float) -> float:
    """The step response of a transfer function over reduced frequency, which tends to `at_once`."""
    return at_once + 2 / math.pi * float(np.trapezoid((transfer.real - at_once) / k * np.sin(k * semichords), k))


@pytest.fixture(scope="module")
def flat() -> WingResponse:
    """As in two dimensions: a wing of one strip, 10,000 chords wide. 30 chords travelled."""
    lattices = (trapezoid(1e4, 1.0, 1.0, 0.0, (20, 1)), trapezoid(1e4, 1.0, 1.0, 0.0, (40, 1)))
    return wing_response(lattices, NOWHERE, 30.0)


K = np.linspace(1e-6, 60.0, 60_001)


def test_lift_slope_is_two_pi_in_two_dimensions(flat: WingResponse) -> None:
    assert flat.lift_slope == pytest.approx(2 * math.pi, rel=5e-4)


@pytest.mark.parametrize("chords", [0.5, 1.0, 2.0, 5.0, 10.0])
def test_wagner(flat: WingResponse, chords: float) -> None:
    exact = step_of(theodorsen(K), K, 2 * chords, at_once=0.5)
    assert np.interp(chords, flat.motion.way, flat.motion.lift) == pytest.approx(exact, abs=1e-3)


@pytest.mark.parametrize("chords", [0.25, 0.5, 2.0, 5.0, 10.0])
def test_kuessner(flat: WingResponse, chords: float) -> None:
    exact = step_of(sears_of_the_edge(K), K, 2 * chords, at_once=0.0)
    assert np.interp(chords - 0.25, flat.gust.way, flat.gust.lift) == pytest.approx(exact, abs=1.5e-3)


@pytest.mark.parametrize("k", [0.05, 0.1, 0.2, 0.5])
def test_sears(flat: WingResponse, k: float) -> None:
    """The transform of the response to a sharp edge is Sears' function; what is left to settle after 30 chords decays
    as 1/way, by Kuessner's asymptote."""
    way, lift = flat.gust.way + 0.25, flat.gust.lift
    s = 2j * k
    left = 1 - lift
    transform = 1 - s * np.trapezoid(np.concatenate([[1.0], left]) * np.exp(-s * np.insert(way, 0, 0.0)),
                                     np.insert(way, 0, 0.0))  # fmt: skip
    end = way[-1]
    tail = np.linspace(end, 100 * end, 200_001)
    transform -= s * np.trapezoid(left[-1] * end / tail * np.exp(-s * tail), tail)
    exact = complex(sears_of_the_edge(np.array([k]))[0])
    assert abs(complex(transform) - exact) < 0.01


def test_jones_of_aspect_ratio_six() -> None:
    """R. T. Jones's elliptic wing (NACA report 681), itself an approximation of some per cent: he starts at 0.64 of the
    lift by taking the finite wing's apparent mass for its whole lift at first."""
    span = 6 * math.pi / 4
    lattices = (ellipse(span, 1.0, (6, 10)), ellipse(span, 1.0, (12, 10)))
    made = wing_response(lattices, NOWHERE, 12.0)
    # The lifting line's 2 pi AR/(AR + 2) lies above a lifting surface: Helmbold's is 4.43.
    assert made.lift_slope == pytest.approx(2 * math.pi * 6 / (2 + math.sqrt(4 + 36)), rel=0.03)
    for chords in (1.0, 2.0, 5.0, 10.0):
        s = 2 * chords
        assert np.interp(chords, made.motion.way, made.motion.lift) == pytest.approx(
            1 - 0.361 * math.exp(-0.381 * s), abs=0.025
        )
        gust = 1 - 0.448 * math.exp(-0.290 * s) - 0.272 * math.exp(-0.725 * s) - 0.193 * math.exp(-3 * s)
        assert np.interp(chords - 0.25, made.gust.way, made.gust.lift) == pytest.approx(gust, abs=0.06)


def test_upwash_far_ahead_is_that_of_a_horseshoe() -> None:
    """Ten spans ahead a wing is a point doublet of its lift: w = CL S V / (16 pi x^2), which Biot and Savart say."""

    def wing(panels: tuple[int, int]) -> Lattice:
        return trapezoid(6.0, 1.0, 1.0, 0.0, panels)

    made = wing_response((wing((3, 8)), wing((6, 8))), np.array([[-60.0, 0.0, 0.0]]), 1.0)
    assert made.upwash[0] == pytest.approx(made.lift_slope * 6.0 / (16 * math.pi * 60.0**2), rel=0.02)
