"""The recursive transform against a whole-record filter and a matrix of exponentials."""

import numpy as np
import pytest
from scipy.signal import butter, sosfilt, sosfilt_zi

from station.numerics.spectra import Transform, central_difference_factor, grid
from station.numerics.thin_aerofoil import sears_magnitude

DT = 0.02


def test_equals_the_batch_transform():
    rng = np.random.default_rng(2)
    x = rng.normal(size=(3, 2000)).cumsum(axis=1) + 5.0
    frequencies = grid(0.1, 2.0, 0.04)
    transform = Transform(3, frequencies, DT)
    for k in range(2000):
        transform.step(x[:, k], k >= 700)
    sos = butter(4, 0.02, "highpass", fs=50, output="sos")
    rest = sosfilt_zi(sos)
    high = np.array([sosfilt(sos, row, zi=rest * row[0])[0] for row in x])
    kernel = np.exp(-2j * np.pi * np.outer(np.arange(1300) * DT, frequencies))
    assert transform.spectrum == pytest.approx(high[:, 700:] @ kernel, rel=1e-9, abs=1e-9)
    assert transform.samples == 1300
    assert transform.filtered == 2000


def test_clearing_keeps_the_filters_warm():
    frequencies = grid(0.1, 2.0, 0.04)
    one, two = Transform(1, frequencies, DT), Transform(1, frequencies, DT)
    x = np.random.default_rng(3).normal(size=(1500, 1))
    for k, row in enumerate(x):
        one.step(row, True)
        if k == 999:
            one.clear()
        two.step(row, k >= 1000)
    assert np.array_equal(one.spectrum, two.spectrum)


def test_grid_ends_at_its_upper_limit():
    assert grid(0.1, 2.0, 0.01)[[0, -1]] == pytest.approx([0.1, 2.0])
    assert len(grid(0.1, 2.0, 0.04)) == 48


def test_central_difference_is_undone():
    f = np.array([0.5, 1.9])
    t = np.arange(3) * DT
    for hertz, factor in zip(f, central_difference_factor(f, DT), strict=True):
        x = np.sin(2 * np.pi * hertz * (t - DT))
        assert factor * (x[2] - x[0]) / (2 * DT) == pytest.approx(2 * np.pi * hertz, rel=1e-12)


def test_sears_against_published_values():
    """Magnitudes at k = 0.011 ... 0.547 (Sears 1941 with exact Bessel functions, tabulated to three digits)."""
    k = np.array([0.011, 0.055, 0.109, 0.219, 0.547])
    assert sears_magnitude(k) == pytest.approx([0.982, 0.907, 0.824, 0.702, 0.508], abs=0.0015)
