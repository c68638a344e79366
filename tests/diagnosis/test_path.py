"""Filters along the path: what lags behind by a distance, at speeds that change."""

from __future__ import annotations

import numpy as np
import pytest

from station.diagnosis.processing import Setting, at_places, back, bridge_of, places_of, transform

SPEED, ARM, SECONDS = 50.0, 7.5, 40.0


def setting(dt: float) -> Setting:
    n = round(SECONDS / dt) + 1
    return Setting(dt, n, bridge_of(dt, n), (0,), (0.0, 0.0, 0.0), 0.0, 0.0, False, {})


@pytest.mark.parametrize("dt", [0.01, 0.02, 0.04, 0.1])
def test_what_is_behind_by_a_distance_is_later_while_the_aircraft_is_slow(dt: float) -> None:
    """A wave of 60 m over the ground from an aircraft whose speed changes by 20 % in 10 s: an arm later in closed form.
    By a constant time it would be wrong by up to a sixth of its size."""
    s = setting(dt)
    t = dt * np.arange(s.n)
    turned = 2 * np.pi * 0.1
    speed = SPEED * (1 + 0.2 * np.sin(turned * t))
    way = SPEED * (t + 0.2 * (1 - np.cos(turned * t)) / turned)
    of_way = 2 * np.pi / 60
    there, again = places_of(speed, np.array([SPEED]), s)
    along = transform(at_places(np.sin(of_way * way), there), s)
    behind = at_places(back(along * np.exp(-1j * s.omega * ARM / SPEED), s), again)
    inside = (t > 5) & (t < SECONDS - 5)
    np.testing.assert_allclose(behind[inside], np.sin(of_way * (way - ARM))[inside], atol=5e-3)
    constant = back(transform(np.sin(of_way * way), s) * np.exp(-1j * s.omega * ARM / SPEED), s)
    assert np.abs(constant - np.sin(of_way * (way - ARM)))[inside].max() > 0.1


def test_many_paths_at_once_are_each_their_own() -> None:
    s = setting(0.04)
    t = 0.04 * np.arange(s.n)
    speeds = SPEED * (1 + np.array([[0.1], [0.2]]) * np.sin(0.6 * t))
    x = np.cos(5.0 * t)
    there, _ = places_of(speeds, np.full((2, 1), SPEED), s)
    both = at_places(x, there)
    for row, speed in zip(both, speeds, strict=True):
        np.testing.assert_allclose(row, at_places(x, places_of(speed, np.array([SPEED]), s)[0]), atol=1e-12)


def test_at_a_steady_speed_nothing_is_interpolated() -> None:
    s = setting(0.02)
    assert places_of(np.full(s.n, SPEED), np.array([SPEED]), s) == (None, None)
