"""A vane on a wing's tip, a second one, a wing that bends and one that is swept: against closed forms."""

from __future__ import annotations

import cmath
import math
from typing import Any

import numpy as np
import pytest
from scipy.special import j1, struve
from simulation.test_gust_plane import AIR, SPAN, TIP, W_WING, L, energy

from station.profile import Aircraft, Card, DiscreteGust, load_aircraft
from station.profile.aircraft import SecondVane
from station.simulation.boom import bending, vane_constants
from station.simulation.gust_plane import in_a_plane, matrix
from station.simulation.gusts import STEP
from station.simulation.six_degrees import LateralSimulation

AIRCRAFT = load_aircraft("twin_otter")
QUICK = {"vane_frequency": 60.0, "vane_damping": 0.7}
"""A vane that follows the flow: within 0.5 % at 1 Hz."""


def with_second(**keys: Any) -> Aircraft:
    """A second vane like the first but for `keys`, both quick."""
    assert AIRCRAFT.boom is not None
    first = AIRCRAFT.boom.model_copy(update=QUICK)
    second = SecondVane.model_construct(**{**dict(first), "averaged": False, **keys})
    return AIRCRAFT.model_copy(update={"boom": first, "second_vane": second})


def rolling(aircraft: Aircraft, **keys: Any) -> dict[str, np.ndarray]:
    """Ten seconds with an aileron doublet."""
    shape = {"kind": "doublet", "surface": "aileron", "start": "2 s", "amplitude": "8 deg", "width": "1 s"}
    flight = {"field": "plane", "speed": "110 kt", "altitude": "2500 ft", **keys}
    card = Card.model_validate({"name": "t", "aircraft": "a", "rig": "r", "flight": flight, "manoeuvres": [shape]})
    return LateralSimulation(aircraft, card.flight, card.manoeuvres).advance(2000)


def test_a_second_vane_in_the_place_of_the_first_shows_the_same() -> None:
    f = rolling(with_second(), gust_sigma="5 ft/s")
    np.testing.assert_allclose(f["alpha_vane_2"], f["alpha_vane"], atol=1e-12)


def test_a_tip_that_rolls_down_meets_p_y_over_v() -> None:
    """In calm air two vanes abreast differ by (1 + k_body + k_roll) p y/V, right wing down positive."""
    y, upwash = 9.9, 0.07
    assert AIRCRAFT.boom is not None
    f = rolling(with_second(vane_y=y, upwash_roll=upwash))
    wanted = (1 + AIRCRAFT.boom.upwash_body + upwash) * f["p"] * y / f["airspeed"]
    late = 2 * 0.7 / (2 * math.pi * 60.0)
    wanted = np.interp(f["time"] - late, f["time"], wanted)
    assert np.abs(wanted).max() > math.radians(2)
    np.testing.assert_allclose(f["alpha_vane_2"] - f["alpha_vane"], wanted, atol=0.02 * np.abs(wanted).max())


def test_two_tips_show_the_gradient_of_the_gusts() -> None:
    """A gust of the right half alone: the right vane shows it, the left one does not."""
    gust = {"component": "up", "start": "3 s", "length": "60 m", "peak": "3 m/s", "half": "right"}
    assert AIRCRAFT.boom is not None
    body = 1 + AIRCRAFT.boom.upwash_body
    right, left = (rolling(with_second(vane_y=side * 9.9, upwash_wing=0.0), gusts=[gust]) for side in (1.0, -1.0))
    shown = right["alpha_vane_2"] - left["alpha_vane_2"] - 2 * body * right["p"] * 9.9 / right["airspeed"]
    at = int(np.argmax(shown))
    assert shown[at] == pytest.approx(body * 3.0 / right["airspeed"][at], rel=0.05)


@pytest.mark.parametrize("turn", [1.0, 0.0, -0.5])
def test_a_wing_that_bends_moves_its_vane_and_turns_it_by_its_sweep(turn: float) -> None:
    """Steady oscillation of the load: (n - i w L/V) H c by complex arithmetic."""
    assert AIRCRAFT.boom is not None
    keys = {"flexure": -0.0015, "mode_frequency": 4.0, "mode_damping": 0.1, "mode_length": 7.0, "mode_turn": turn}
    dt, speed, hertz = 0.005, 56.6, 1.5
    v, state = vane_constants(AIRCRAFT.boom.model_copy(update=keys), dt), np.zeros(3)
    s, wn = 2j * math.pi * hertz, 2 * math.pi * 4.0
    times = dt * np.arange(2000)
    shown = [bending(v, state, k == 0, 3.0 * math.cos(s.imag * x), 0.0, 0.0, speed, 0.0) for k, x in enumerate(times)]
    response = wn**2 / (s**2 + 2 * 0.1 * wn * s + wn**2) * (turn - s * 7.0 / speed) * -0.0015 * 3.0
    wanted = [(response * cmath.exp(s * x)).real for x in times]
    np.testing.assert_allclose(shown[1600:], wanted[1600:], atol=0.01 * abs(response))


def arrival(s: np.ndarray) -> np.ndarray:
    """Share of an elliptic loading within s half spans of the middle."""
    s = np.clip(s, 0.0, 1.0)
    return np.asarray(2 / np.pi * (np.arcsin(s) + s * np.sqrt(1 - s * s)))


def test_a_front_reaches_a_swept_wing_strip_by_strip() -> None:
    """A gust that grows within a metre and lasts, on all of the span: the wing's mean is the elliptic distribution of
    the arrivals, their mean no later than a straight wing's."""
    slope = math.tan(math.radians(35))
    gust = DiscreteGust.model_validate({"component": "up", "start": "1 s", "length": "20 m", "peak": "1 m/s"})
    (laid,) = in_a_plane((gust,), 50.0, TIP._replace(sweep=slope))
    (straight,) = in_a_plane((gust,), 50.0, TIP)
    places = STEP * (laid.first + np.arange(len(laid.values)))
    there = STEP * (straight.first + np.arange(len(straight.values)))
    # The mean of what came earlier, by the density of the arrivals.
    s = np.linspace(0.0, 1.0, 2001)
    share = np.diff(arrival(s))
    later = slope * SPAN / 2 * (0.5 * (s[1:] + s[:-1]) - 4 / (3 * np.pi))
    wanted = np.interp(places[:, None] - later, there, straight.values[:, W_WING], left=0.0, right=0.0) @ share
    np.testing.assert_allclose(laid.values[:, W_WING], wanted, atol=5e-3)
    assert np.abs(laid.values[:, W_WING] - np.interp(places, there, straight.values[:, W_WING])).max() > 1e-2


def swept_gain(kappa: float, across: np.ndarray, slope: float) -> np.ndarray:
    """Of the elliptic mean for a wave of these wavenumbers along and across, by quadrature over the span."""
    angle = (np.arange(4000) + 0.5) * np.pi / 4000
    y, weight = SPAN / 2 * np.cos(angle), np.sin(angle) ** 2 / 2000
    later = slope * (np.abs(y) - 4 / (3 * np.pi) * SPAN / 2)
    return np.array([(weight * np.exp(1j * (k * y - kappa * later))).sum() for k in across])


def test_the_swept_mean_of_one_long_wave_is_struve_s() -> None:
    """Gusts alike along the span: elliptic arrivals make 2 J1(z)/z - 2i H1(z)/z, z = kappa b/2 tan(sweep), as even ones
    make a sinc."""
    slope, kappa = math.tan(math.radians(30)), 0.4
    z = kappa * SPAN / 2 * slope
    mean = cmath.exp(1j * z * 4 / (3 * math.pi))
    wanted = 2 / z * (j1(z) - 1j * struve(1, z)) * mean
    assert swept_gain(kappa, np.zeros(1), slope)[0] == pytest.approx(wanted, abs=1e-4)


@pytest.mark.parametrize("kappa", [4 / L, 0.04, 0.2])
def test_what_a_swept_span_meets_is_etkin_s_integral(kappa: float) -> None:
    """As that of a straight one: isotropic turbulence's spectrum over the wavenumbers across and down (Etkin 1972,
    13.3), seen through the gain of the swept span; and the cross-spectrum with the way of the CG."""
    slope = math.tan(math.radians(40))
    found = matrix(TIP._replace(sweep=slope), AIR, "dryden", np.array([kappa]))[0]
    edges = np.sinh(np.linspace(0, math.asinh(60 * L), 601)) / L
    across, down = np.meshgrid(edges[:390], edges, indexing="ij")
    square = kappa**2 + across**2 + down**2
    density = energy(np.sqrt(square)) / (4 * np.pi * square) * (1 - down**2 / square)
    inner = 2 * np.trapezoid(density, edges, axis=1)
    gain = swept_gain(kappa, edges[:390], slope)
    mean = 4 * np.pi * np.trapezoid(inner * np.abs(gain) ** 2, edges[:390])
    crossed = 4 * np.pi * np.trapezoid(inner * gain, edges[:390])
    assert found[W_WING, W_WING].real == pytest.approx(mean, rel=0.02)
    assert found[W_WING, 2] == pytest.approx(crossed, rel=0.02)
    plain = matrix(TIP, AIR, "dryden", np.array([kappa]))[0]
    assert abs(found[W_WING, W_WING]) < abs(plain[W_WING, W_WING])


def test_the_profile_s_sweep_is_flown() -> None:
    """The same gusts, another wing: what it meets lies closer to its own past."""
    plan = {"sweep": "35 deg"}
    aircraft = Aircraft.model_validate({**AIRCRAFT.model_dump(), "planform": plan}, context="si")
    one, other = (rolling(a, gust_sigma="5 ft/s") for a in (AIRCRAFT, aircraft))
    assert np.std(other["CL"] - one["CL"]) > 0.01 * np.std(one["CL"])
