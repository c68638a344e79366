"""Units against their published definitions; every sign of the table in words and numbers."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from station.conventions import SIGNALS, STREAMS, UNIT_ALIASES, UNITS, from_si, ned_from_body, to_si, unit_named

# NIST SP 811 (2008), appendix B; slug and psf from the pound-force and foot.
PUBLISHED = [
    (1.0, "kt", 0.514444444, 1e-9),
    (1.0, "ft", 0.3048, 0),
    (1.0, "slug", 14.5939029, 1e-7),
    (1.0, "slug ft2", 1.35581795, 1e-8),
    (1.0, "psf", 47.8802590, 1e-7),
    (1.0, "psi", 6894.75729, 1e-5),
    (1.0, "lbf", 4.44822162, 1e-8),
    (1.0, "lb", 0.45359237, 0),
    (1.0, "inHg", 3386.389, 1e-3),
    (1.0, "slug/ft3", 515.378818, 1e-6),
    (180.0, "deg", math.pi, 1e-15),
    (1.0, "g", 9.80665, 0),
    (15.0, "degC", 288.15, 1e-12),
    (59.0, "degF", 288.15, 1e-9),
    (1.0, "nmi", 1852.0, 0),
    (1.0, "mph", 0.44704, 1e-12),
]


@pytest.mark.parametrize(("value", "unit", "si", "tolerance"), PUBLISHED)
def test_units_are_the_published_ones(value, unit, si, tolerance):
    assert to_si(value, unit) == pytest.approx(si, abs=max(tolerance, 1e-12))


@pytest.mark.parametrize("unit", UNITS)
def test_there_and_back(unit):
    assert from_si(to_si(3.7, unit), unit) == pytest.approx(3.7, rel=1e-12)


def test_aliases_name_known_units():
    assert all(name in UNITS for name in UNIT_ALIASES.values())
    assert unit_named("knots") is UNITS["kt"]
    assert unit_named("furlong") is None


def test_every_stream_carries_known_signals_and_no_signal_twice():
    names = [name for stream in STREAMS.values() for name in stream.signals]
    assert sorted(names) == sorted(SIGNALS)


def test_signs_of_attitude():
    """Nose up: the body's x axis points up (negative down). Right wing down: the y axis points down. Yaw: clockwise."""
    up = ned_from_body(0.0, 0.1, 0.0) @ [1, 0, 0]
    assert up[2] == pytest.approx(-math.sin(0.1))
    right = ned_from_body(0.2, 0.0, 0.0) @ [0, 1, 0]
    assert right[2] == pytest.approx(math.sin(0.2))
    east = ned_from_body(0.0, 0.0, math.pi / 2) @ [1, 0, 0]
    np.testing.assert_allclose(east, [0, 1, 0], atol=1e-15)


def test_three_angles_at_once_turn_as_scipy_turns_them():
    phi, theta, psi = np.random.default_rng(1).uniform(-1.5, 1.5, (3, 20))
    expected = Rotation.from_euler("ZYX", np.column_stack([psi, theta, phi])).as_matrix()
    np.testing.assert_allclose(ned_from_body(phi, theta, psi), expected, atol=1e-15)
    np.testing.assert_allclose(ned_from_body(phi[3], theta[3], psi[3]), expected[3], atol=1e-15)


def test_level_flight_feels_minus_one_g_down():
    """The accelerometer feels what holds the aircraft up: -g along body z in level flight."""
    gravity = np.array([0, 0, 9.80665])
    felt = ned_from_body(0.0, 0.0, 1.0).T @ (np.zeros(3) - gravity)
    assert felt[2] == pytest.approx(-9.80665)
    assert SIGNALS["az"].low < felt[2] < SIGNALS["az"].high


def test_nose_up_two_degrees_on_a_level_path_reads_plus_0_0349():
    velocity_ned = np.array([60.0, 0.0, 0.0])
    u, _, w = ned_from_body(0.0, math.radians(2), 0.0).T @ velocity_ned
    assert math.atan2(w, u) == pytest.approx(0.0349, abs=5e-5)
