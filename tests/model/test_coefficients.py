from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from station.model.coefficients import Airframe, at_centre_of_gravity, coefficients, thrust_by_drag_polar
from station.numerics.regression import NotIdentifiable, least_squares

AIRFRAME = Airframe(area=10.0, span=8.0, chord=1.25, mass=500.0, ixx=400.0, iyy=700.0, izz=1000.0, ixz=50.0)
N = 200
DT = 0.02
T = np.arange(N) * DT


def level_flight() -> dict[str, np.ndarray]:
    one = np.ones(N)
    return {
        "airspeed": 50 * one,
        "dynamic_pressure": 1500 * one,
        "q": 0 * one,
        "ax": 0.6 * one,
        "az": -9.80665 * one,
        "thrust": 900 * one,
    }


def test_level_flight_lifts_its_weight() -> None:
    alpha = np.full(N, 0.06)
    c = coefficients(level_flight(), AIRFRAME, alpha, DT)
    weight, axial = 500 * 9.80665 / 15000, (500 * 0.6 - 900) / 15000
    np.testing.assert_allclose(c.CZ, -weight)
    np.testing.assert_allclose(c.CL, weight * np.cos(0.06) + axial * np.sin(0.06))
    np.testing.assert_allclose(c.CD, -axial * np.cos(0.06) + weight * np.sin(0.06))
    np.testing.assert_array_equal(c.Cm, 0.0)


def test_a_raised_thrust_with_an_arm_is_taken_out_of_forces_and_moment() -> None:
    """By hand: 1000 N raised by atan(3/4) push 800 N forward and 600 N up, and an arm of -0.5 m noses down 500 N m."""
    airframe = replace(AIRFRAME, thrust_angle=math.atan2(3, 4), thrust_pitch_arm=-0.5)
    one = np.ones(N)
    motion = level_flight() | {"ax": 1.0 * one, "az": -10.0 * one, "thrust": 1000 * one, "qdot": 0.2 * one}
    c = coefficients(motion, airframe, np.zeros(N), DT)
    np.testing.assert_allclose(c.CX, (500 * 1 - 800) / 15000)
    np.testing.assert_allclose(c.CZ, (-500 * 10 + 600) / 15000)
    np.testing.assert_allclose(c.Cm, (700 * 0.2 + 500) / (15000 * 1.25))


def test_thrust_by_the_drag_polar_is_what_was_flown() -> None:
    """A forward model: drag by the polar at -CZ, thrust along a raised line."""
    force, angle, alpha, thrust = 15000.0, 0.1, 0.05, 800.0
    cz = -0.4
    total = cz - thrust * math.sin(angle) / force
    cd = 0.03 + 0.05 * total**2
    x = -force * (cd * math.cos(alpha) + cz * math.sin(alpha)) + thrust * math.cos(angle)
    found = thrust_by_drag_polar((x, total * force), force, (0.03, 0.05), angle, math.sin(alpha), math.cos(alpha))
    assert found == pytest.approx(thrust, rel=1e-12)


def test_rates_are_normalised_with_the_speed_that_the_profile_says() -> None:
    motion = level_flight() | {"q": 0.2 * np.ones(N)}
    c = coefficients(motion, replace(AIRFRAME, rate_speed=40.0), np.zeros(N), DT)
    np.testing.assert_allclose(c.qhat, 0.2 * 1.25 / (2 * 40))


def test_moments_satisfy_euler_s_equation() -> None:
    rng = np.random.default_rng(3)
    w = rng.normal(size=(N, 3))
    wdot = rng.normal(size=(N, 3))
    motion = level_flight() | {s: w[:, i] for i, s in enumerate("pqr")}
    motion |= {f"{s}dot": wdot[:, i] for i, s in enumerate("pqr")}
    c = coefficients(motion, AIRFRAME, np.zeros(N), DT)
    inertia = np.array([[400.0, 0, -50], [0, 700, 0], [-50, 0, 1000]])
    moment = wdot @ inertia + np.cross(w, w @ inertia)
    measured = np.column_stack([c.Cl * 8, c.Cm * 1.25, c.Cn * 8]) * 15000
    np.testing.assert_allclose(measured, moment, rtol=1e-12, atol=1e-9)


def test_accelerometer_ahead_of_the_cg_feels_pitching() -> None:
    qdot = np.full(N, 0.5)
    motion = level_flight() | {"q": 0.5 * T, "qdot": qdot}
    # An accelerometer 2 m ahead is accelerated upwards by qdot x and inwards by q^2 x.
    felt = motion | {"ax": motion["ax"] - 2 * motion["q"] ** 2, "az": motion["az"] - 2 * qdot}
    moved = at_centre_of_gravity(felt, (2.0, 0.0, 0.0), DT)
    np.testing.assert_allclose(moved["ax"], motion["ax"])
    np.testing.assert_allclose(moved["az"], motion["az"])


def test_unknown_inertia_is_nan_never_zero() -> None:
    airframe = Airframe(10.0, 8.0, 1.25, 500.0, ixx=np.nan, iyy=np.nan, izz=np.nan)
    c = coefficients(level_flight(), airframe, np.zeros(N), DT)
    assert np.isnan(c.Cm).all()
    assert np.isfinite(c.CZ).all()


def test_coloured_errors_cover_where_white_ones_do_not() -> None:
    rng = np.random.default_rng(11)
    covered = {"white": 0, "coloured": 0}
    trials, n = 200, 400
    for _ in range(trials):
        x = np.column_stack([np.sin(2 * np.pi * np.arange(n) / 130), np.ones(n)])
        e = np.zeros(n)
        for i in range(1, n):
            e[i] = 0.9 * e[i - 1] + rng.normal()
        fit = least_squares(x, x @ [2.0, -1.0] + e)
        error = abs(fit.estimate[0] - 2.0)
        covered["white"] += error < 2 * fit.se_white[0]
        covered["coloured"] += error < 2 * fit.se_coloured[0]
    assert covered["white"] < 0.6 * trials
    # The residual's autocorrelation at all lags falls short of the error's: about 0.8 where 0.95 is meant.
    assert covered["coloured"] > 0.72 * trials


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (lambda x, z: (np.column_stack([x, x[:, 0] * 2]), z), "collinear"),
        (lambda x, z: (x * [0, 1], z), "zero throughout"),
        (lambda x, z: (x, np.where(np.arange(len(z)) == 5, np.nan, z)), "missing"),
        (lambda x, z: (x[:2], z[:2]), "2 samples for 2 parameters"),
    ],
)
def test_refusals(spoil, why: str) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(5)
    x = rng.normal(size=(50, 2))
    with pytest.raises(NotIdentifiable, match=why):
        least_squares(*spoil(x, x @ [1.0, 2.0]))
