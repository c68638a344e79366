"""Derived quantities against published roots, the books' closed forms, and a nonlinear flight that rings down."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from station.conventions import G0, to_si
from station.model.flying_qualities import (
    Coefficients,
    Condition,
    coefficients,
    late_of,
    mixture,
    modes,
    pull_up,
    qualities,
)
from station.model.flying_quality_levels import level, levels_of
from station.numerics.atmosphere import atmosphere
from station.profile import Flight, load_aircraft
from station.simulation.three_degrees import Simulation

NAVION = Coefficients(
    cl=0.41, cl_u=0.0, cl_alpha=4.44, cl_q=0.0, cl_de=0.355, cd=0.05, cd_u=0.0, cd_alpha=0.33, cm=0.0, cm_u=0.0,
    cm_alpha=-0.683, cm_q=-9.96, cm_de=-0.923, thrust_u=0.0, cm_adot=-4.36,
)  # fmt: skip
"""General aviation airplane of Nelson, Flight Stability and Automatic Control, 2nd ed., example 4.3 (no Z_q there)."""
AT = Condition(to_si(176, "ft/s"), 1.225, to_si(2750 / 32.174, "slug"), to_si(3000, "slug ft2"))
AREA, CHORD = to_si(184, "ft2"), to_si(5.7, "ft")
NAMES = ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")


def test_roots_are_those_of_nelsons_navion() -> None:
    """Published: -2.5 +- 2.59 i and -0.0171 +- 0.213 i 1/s; half of the last digit."""
    fast, _, slow, _ = modes(NAVION, AT, AREA, CHORD)
    assert (fast.real, abs(fast.imag)) == pytest.approx((-2.5, 2.59), abs=0.05)
    assert abs(fast.imag) == pytest.approx(2.59, abs=0.005)
    assert (slow.real, abs(slow.imag)) == (pytest.approx(-0.0171, abs=5e-5), pytest.approx(0.213, abs=5e-4))


@pytest.mark.parametrize("scale", [math.inf, 10_000.0, 2_000.0])
def test_a_phugoid_of_lift_alone_is_lanchesters_in_air_that_thins(scale: float) -> None:
    """Kept at its angle of attack, lift goes with density and V2, and height pays for speed: omega2 = 2 g2/V2 + g/H."""
    lift = AT.mass * G0 / (0.5 * AT.density * AT.speed**2 * AREA)
    stiff = NAVION._replace(cl=lift, cd=0.0, cd_alpha=lift, cm_alpha=-500.0, cm_q=0.0, cm_adot=0.0)
    slow = modes(stiff, replace(AT, scale_height=scale), AREA, CHORD)[2]
    assert abs(slow) == pytest.approx(math.sqrt(2 * (G0 / AT.speed) ** 2 + G0 / scale), rel=2e-3)


def test_elevator_per_g_is_etkins() -> None:
    """Etkin and Reid 1996, section 3.1: -CW (2 mu - CLq)/(2 mu det) CL_alpha (h - h_m), which leaves out the drag."""
    c = NAVION._replace(cl_q=3.8, cd=0.0)
    weight = AT.mass * G0 / (0.5 * AT.density * AT.speed**2 * AREA)
    two_mu = 4 * AT.mass / (AT.density * AREA * CHORD)
    determinant = c.cl_alpha * c.cm_de - c.cl_de * c.cm_alpha
    to_manoeuvre_point = c.cm_alpha / c.cl_alpha + c.cm_q / (two_mu - c.cl_q)
    expected = -weight * (two_mu - c.cl_q) / (two_mu * determinant) * c.cl_alpha * to_manoeuvre_point
    assert 1 / pull_up(c, AT, AREA, CHORD).load == pytest.approx(expected, rel=1e-12)


def test_a_wrong_scale_of_the_elevator_s_sensor_shows_in_the_elevator_per_g_alone_which_says_so() -> None:
    """Read a fifth too much, its derivatives come out a fifth too small, and nothing else changes."""
    body = load_aircraft("twin_otter")
    own, none = {n: body.value(n) for n in NAMES}, np.zeros((len(NAMES), len(NAMES)))
    read = {n: v / (1.2 if n.endswith("_de") else 1.0) for n, v in own.items()}
    true, told = (qualities(body, Condition(56.6, 1.1, 4960.0, 33400.0), x, none).quantities for x in (own, read))
    moved = {n: q.estimate / true[n].estimate for n, q in told.items() if q.estimate != pytest.approx(true[n].estimate)}
    assert moved == {"elevator_per_g": pytest.approx(1.2)}
    assert [n for n, q in told.items() if "elevator scale" in q.rests_on] == list(moved)


def test_elevator_per_g_is_no_better_known_than_the_elevator_s_scale() -> None:
    """To the tenth that 1000 draws leave."""
    body = load_aircraft("twin_otter")
    own, none = {n: body.value(n) for n in NAMES}, np.zeros((len(NAMES), len(NAMES)))
    per_g = qualities(body, Condition(56.6, 1.1, 4960.0, 33400.0), own, none).quantities["elevator_per_g"]
    half = 0.5 * abs(per_g.ci95[1] - per_g.ci95[0])
    assert half == pytest.approx(1.96 * body.uncertainty.surface_scale * abs(per_g.estimate), rel=0.1)


def test_short_period_of_an_unsteady_aircraft_is_that_of_its_flight() -> None:
    """The nonlinear simulation, with wake, tail and lags, rings down after a pulse of the elevator as the root of the
    characteristic equation says. The oscillation's fit and the motion's nonlinearity leave 2 %."""
    aircraft = load_aircraft("twin_otter")
    speed, height = 60.0, 1000.0
    flight = Flight().model_copy(update={"speed": speed, "altitude": height, "gust_sigma": 0.0})
    n = 1000
    half_steps = 0.0025 * np.arange(2 * n + 1)
    pulse = np.where((half_steps > 1.0) & (half_steps < 1.3), math.radians(0.3), 0.0)
    flown, still = (
        Simulation(aircraft, flight, hold=False, deflection=d).advance(n)["q"] for d in (pulse, 0.0 * pulse)
    )
    t = 0.005 * np.arange(n) - 1.8
    part = (t > 0) & (t < 2.5)

    def ringing(x: np.ndarray) -> np.ndarray:
        fast = np.exp(x[0] * t) * (x[2] * np.cos(x[1] * t) + x[3] * np.sin(x[1] * t))
        return np.asarray(1e3 * (fast + x[4] + x[5] * t - (flown - still))[part])

    found = least_squares(ringing, [-2.0, 2.0, 0.0, 0.0, 0.0, 0.0]).x
    alpha = Simulation(aircraft, flight, ()).advance(1)["alpha"][0]
    at = Condition(speed, atmosphere(height)[2], aircraft.inertia.mass, aircraft.inertia.iyy, alpha)
    area, chord = aircraft.geometry.wing_area, aircraft.geometry.chord
    root = modes(coefficients(aircraft, at, {}, 1.0, 0.0), at, area, chord, late_of(aircraft))[0]
    assert abs(complex(root.real, abs(root.imag)) - complex(found[0], abs(found[1]))) < 0.02 * abs(root)
    # The lags matter: without them the root is elsewhere.
    steady = modes(coefficients(aircraft, at, {}, 1.0, 0.0), at, area, chord)[0]
    assert abs(steady.real - found[0]) > 0.05 * abs(root)


def _twin_otter(share: float, **changed: float):
    aircraft = load_aircraft("twin_otter")
    at = Condition(60.0, 1.1, aircraft.inertia.mass, aircraft.inertia.iyy)
    found = {n: changed.get(n, aircraft.value(n)) for n in NAMES}
    return qualities(aircraft, at, found, np.diag([(share * found[n]) ** 2 for n in NAMES]))


def test_an_interval_is_that_of_the_propagated_errors() -> None:
    """Of a ratio with 2 % in each of its parts: 1.96 sqrt(2) 2 %, to the tenth that 1000 draws leave (three of their
    standard errors)."""
    margin = _twin_otter(0.02).quantities["static_margin"]
    half = 0.5 * (margin.ci95[1] - margin.ci95[0]) / margin.estimate
    assert half == pytest.approx(1.96 * math.sqrt(2) * 0.02, rel=0.1)
    assert margin.estimate == pytest.approx(1.31 / 5.66)


def test_an_aircraft_that_may_be_one_of_two_has_intervals_that_hold_both() -> None:
    """Each as likely as the other, far apart: the interval ends where each has 5 % of its own outside."""
    one, other = _twin_otter(0.02), _twin_otter(0.02, Cm_alpha=-2.0)
    margin, alone = mixture(one, other).quantities["static_margin"], one.quantities["static_margin"]
    assert margin.estimate == alone.estimate
    sd = math.sqrt(2) * 0.02
    assert margin.ci95[0] == pytest.approx(alone.estimate * (1 - 1.645 * sd), rel=0.005)
    assert margin.ci95[1] == pytest.approx(2.0 / 5.66 * (1 + 1.645 * sd), rel=0.005)


def test_a_doubtful_loading_widens_the_margins_alone() -> None:
    """3 % of mass and 6 % of inertia make 6.7 % of their ratio, to the tenth of 1000 draws; the motion was measured."""
    aircraft = load_aircraft("twin_otter")
    at = Condition(60.0, 1.1, aircraft.inertia.mass, aircraft.inertia.iyy)
    six = {n: aircraft.value(n) for n in NAMES}
    found = qualities(aircraft, at, six, np.zeros((6, 6)), loading=(0.03, 0.06)).quantities
    margin, period = found["static_margin"], found["short_period_frequency"]
    assert 0.5 * (margin.ci95[1] - margin.ci95[0]) / margin.estimate == pytest.approx(1.96 * 0.067, rel=0.1)
    assert period.ci95[1] - period.ci95[0] < 1e-3 * period.estimate


def test_body_axes_say_what_wind_axes_say() -> None:
    """CZ_alpha is -(CL_alpha + CD) at a small angle of attack; the other forces turn sign."""
    aircraft = load_aircraft("twin_otter")
    at = Condition(60.0, 1.1, aircraft.inertia.mass, aircraft.inertia.iyy)
    lift = at.mass * G0 / (0.5 * at.density * at.speed**2 * aircraft.geometry.wing_area)
    drag = 0.04 + 0.045 * lift**2
    wind = {n: aircraft.value(n) for n in NAMES}
    body = {n.replace("CL", "CZ"): -v if n.startswith("CL") else v for n, v in wind.items()}
    body["CZ_alpha"] -= drag
    one, other = (qualities(aircraft, at, f, np.zeros((6, 6))) for f in (wind, body))
    for name, quantity in one.quantities.items():
        assert other.quantities[name].estimate == pytest.approx(quantity.estimate, rel=1e-6), name


def test_what_cannot_be_known_says_why() -> None:
    aircraft = load_aircraft("twin_otter")
    at = Condition(60.0, 1.1, aircraft.inertia.mass, aircraft.inertia.iyy)
    found = qualities(aircraft, at, {"CL_alpha": 5.7, "Cm_alpha": -1.3}, np.diag([0.01, 0.01])).quantities
    assert "Cm_q" in found["short_period_frequency"].why
    assert not found["static_margin"].why
    no_drag = aircraft.model_copy(update={"drag": None})
    six = {n: aircraft.value(n) for n in NAMES}
    assert "drag" in qualities(no_drag, at, six, np.zeros((6, 6))).quantities["phugoid_frequency"].why


def test_an_unstable_aircraft_has_a_margin_but_no_short_period() -> None:
    found = _twin_otter(0.02, Cm_alpha=1.0)
    assert found.quantities["static_margin"].ci95[1] < 0
    assert found.quantities["short_period_frequency"].why
    assert levels_of(found) == {}


def test_levels_end_where_the_specification_ends_them() -> None:
    """MIL-F-8785C figures 2 and 3 and table IV: CAP 0.085 and 3.6 (B), 0.16 and 3.6 with 0.7 rad/s and 2 g/rad (C,
    class II-L), damping 0.30 to 2.0 and 0.35 to 1.30."""
    n = 10.0

    def both(cap: float, zeta: float, n_alpha: float = n) -> tuple[int, int]:
        omega = math.sqrt(cap * n_alpha)
        b, c = (int(level(k, np.array([omega]), np.array([zeta]), np.array([n_alpha]))[0]) for k in "BC")
        return b, c

    assert both(0.5, 0.7) == (1, 1)
    assert both(0.10, 0.7) == (1, 2)
    assert both(0.05, 0.7) == (2, 4)
    assert both(5.0, 0.7) == (2, 2)
    assert both(20.0, 0.7) == (3, 3)
    assert both(0.5, 0.32) == (1, 2)
    assert both(0.5, 1.5) == (1, 2)
    assert both(0.5, 0.1) == (4, 4)
    assert both(0.5, 0.7, 1.5) == (1, 2)
