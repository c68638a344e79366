"""Samples in rings and their values at an instant, against numpy's interpolation and least squares."""

import math

import numpy as np
import pytest

from station.flight.rings import FRESH, HALF_TICK_NS, HELD, MISSING, SUSPECT, Layout, interpolate, make_rings, take

MS = 1_000_000
BRIDGE, STALE = 50 * MS, 200 * MS
LENGTH = 8


class Stream:
    """One stream of two signals, the second an angle that wraps."""

    def __init__(self):
        self.rings = make_rings(1, LENGTH, 2)
        self.layout = Layout(
            np.array([[BRIDGE, STALE, 2]]), np.array([[1, 0]]), np.array([[0, 1]])
        )  # they stand in the frame the other way round

    def take(self, *samples):
        given = np.zeros((len(samples), 4))
        stamps = given.view(np.int64)
        for row, (t_ms, *values) in enumerate(samples):
            stamps[row, 0], stamps[row, 1] = 0, round(t_ms * MS)
            given[row, 2:] = values
        take(self.rings, given, stamps, len(samples))

    def at(self, t_ms, is_stuck=False):
        """Value, age and quality of both signals."""
        out = np.zeros((3, 3))
        interpolate(self.rings, self.layout, np.array([is_stuck]), round(t_ms * MS), out)
        assert math.isnan(out[0, 2])
        assert out[2, 2] == MISSING
        return out[:, 1], out[:, 0]


def test_late_samples_are_sorted_in_and_a_second_of_one_time_is_dropped():
    s = Stream()
    s.take((0, 1.0, 0.0), (20, 3.0, 0.0), (10, 2.0, 0.0), (20, 9.0, 0.0))
    assert s.rings.kept[0] == 3
    np.testing.assert_array_equal(s.rings.times[0, :3], [0, 10 * MS, 20 * MS])
    np.testing.assert_array_equal(s.rings.values[0, :3, 0], [1.0, 2.0, 3.0])


def test_the_newest_are_kept():
    s = Stream()
    s.take(*((10 * k, float(k), 0.0) for k in range(20)))
    assert sorted(s.rings.values[0, :, 0]) == list(range(12, 20))
    assert s.at(110)[0][2] == MISSING
    assert s.at(120)[0][0] == 12.0


@pytest.mark.parametrize("t", [0.0, 7.5, 40.0, 55.0, 79.9, 80.0])
def test_between_two_samples_the_straight_line(t):
    times, values = [0.0, 40.0, 80.0], [1.0, 3.0, -2.0]
    s = Stream()
    s.take(*((a, b, 0.0) for a, b in zip(times, values, strict=True)))
    value, age, quality = s.at(t)[0]
    assert value == pytest.approx(np.interp(t, times, values), abs=1e-12)
    assert (age, quality) == (0.0, FRESH)


def test_samples_within_half_a_tick_are_smoothed_by_a_least_squares_line():
    rng = np.random.default_rng(1)
    times, values = np.arange(0.0, 40.0, 5.0), rng.normal(size=8)
    s = Stream()
    s.take(*((a, b, 0.0) for a, b in zip(times, values, strict=True)))
    t = 18.0
    near = np.abs(times - t) <= HALF_TICK_NS / MS
    assert near.sum() == 4
    assert s.at(t)[0][0] == pytest.approx(np.polyval(np.polyfit(times[near] - t, values[near], 1), 0.0), abs=1e-12)


def test_an_angle_goes_the_short_way_round():
    s = Stream()
    s.take((0, 0.0, 3.1), (40, 0.0, -3.1))
    middle = s.at(20)[1][0]
    assert math.remainder(middle - math.pi, 2 * math.pi) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("t", "expected"), [(100, (2.0, 0.1, HELD)), (200, (2.0, 0.2, HELD)), (201, None)])
def test_after_the_newest_it_is_held_until_it_is_stale(t, expected):
    s = Stream()
    s.take((-40, 1.0, 0.0), (0, 2.0, 0.0))
    found = s.at(t)[0]
    if expected is None:
        assert math.isnan(found[0])
        assert found[2] == MISSING
    else:
        assert tuple(found) == pytest.approx(expected)


def test_a_gap_is_not_bridged():
    s = Stream()
    s.take((0, 1.0, 0.0), (60, 5.0, 0.0))
    assert tuple(s.at(30)[0]) == pytest.approx((1.0, 0.03, HELD))


def test_nothing_is_known_before_the_first_sample():
    s = Stream()
    s.take((10, 1.0, 0.0))
    assert s.at(9)[0][2] == MISSING


def test_a_stuck_stream_and_a_value_that_is_no_number_are_suspect():
    s = Stream()
    s.take((0, 1.0, 0.0), (20, math.nan, 0.5))
    assert s.at(10, is_stuck=True)[0][2] == SUSPECT
    (a, _, quality), (b, _, other) = s.at(20)
    assert math.isnan(a)
    assert (quality, other) == (SUSPECT, FRESH)
    assert b == 0.5
