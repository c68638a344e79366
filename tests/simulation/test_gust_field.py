"""The Dryden field against the closed forms of MIL-F-8785C and the vortex-free facts of a frozen field."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.signal import welch

from station.profile import Flight
from station.simulation.gusts import STEP, Dryden, GustField, dryden, dryden_of, field_constants, gust_at, sigma_at

FT = 0.3048
SPEED = 185.66 * FT
SIGMA = 5 * FT


def field(metres: float, seed: int = 1, start_s: float = 0.0, sigma: float = SIGMA, model: Dryden | None = None):
    made = GustField(
        field_constants(model or dryden(2500 * FT, sigma), SPEED, start_s), 10.0, np.random.SeedSequence(seed)
    )
    made.cover(-10.0, metres)
    return made


@pytest.fixture(scope="module")
def long() -> np.ndarray:
    """2,000 km of turbulence, light."""
    return field(2e6).now.values


def spectrum_u(omega: np.ndarray, sigma: float, length: float) -> np.ndarray:
    return sigma**2 * 2 * length / math.pi / (1 + (length * omega) ** 2)


def spectrum_w(omega: np.ndarray, sigma: float, length: float) -> np.ndarray:
    x = (length * omega) ** 2
    return sigma**2 * length / math.pi * (1 + 3 * x) / (1 + x) ** 2


def test_scales_at_height() -> None:
    high = dryden(2500 * FT, 1.0)
    np.testing.assert_allclose(high, [1750 * FT] * 3 + [1.0] * 3)
    low = dryden(500 * FT, 1.0)
    shape = 0.177 + 0.000823 * 500
    assert low.length_w == pytest.approx(500 * FT)
    assert low.length_u == pytest.approx(500 * FT / shape**1.2)
    assert low.sigma_u == pytest.approx(1 / shape**0.4)
    assert low.sigma_u > low.sigma_w
    np.testing.assert_allclose(dryden(1000 * FT, 1.0)[:3], [1000 * FT] * 3, rtol=1e-12)
    np.testing.assert_allclose(dryden(1500 * FT, 1.0)[:3], [1375 * FT] * 3, rtol=1e-12)


def test_strength_by_level_and_height() -> None:
    """MIL-F-8785C: a tenth of the wind at 20 ft (15, 30, 45 kt) near the ground, the station's classes above."""
    for level, wind_kt, high in (("light", 15, 5), ("moderate", 30, 10), ("severe", 45, 20)):
        assert sigma_at(300 * FT, level) == pytest.approx(0.1 * wind_kt * 1852 / 3600)
        assert sigma_at(2500 * FT, level) == pytest.approx(high * FT)
        assert sigma_at(1500 * FT, level) == pytest.approx(0.5 * (0.1 * wind_kt * 1852 / 3600 + high * FT))
    flight = Flight.model_validate({"turbulence": "moderate", "altitude": "2500 ft"})
    assert dryden_of(flight) == dryden(2500 * FT, 10 * FT)
    assert dryden_of(Flight.model_validate({"gust_sigma": "3 ft/s", "altitude": "500 ft"})) == dryden(500 * FT, 3 * FT)


def test_spectra_follow_the_closed_forms(long: np.ndarray) -> None:
    f, power = welch(long, fs=1 / STEP, nperseg=2**16, axis=0, detrend=False)
    omega = 2 * math.pi * f
    length = 1750 * FT
    expected = (spectrum_u(omega, SIGMA, length), *(spectrum_w(omega, SIGMA, length) for _ in range(2)))
    edges = np.geomspace(4 / length, 0.5 * math.pi, 9)  # wavelengths of 800 m to 4 m
    for column in range(3):
        for low, high in itertools.pairwise(edges):
            band = (omega >= low) & (omega < high)
            ratio = power[band, column].sum() / (2 * math.pi * expected[column][band]).sum()
            assert ratio == pytest.approx(1.0, abs=0.12)


def test_variance_from_the_first_point_on(long: np.ndarray) -> None:
    """Over 3,000 seeds, the field begins stationary; over one long flight, it stays so."""
    model = dryden(2500 * FT, SIGMA)
    first = np.array([field(0.0, seed).now.values[0] for seed in range(3000)])
    np.testing.assert_allclose(first.std(axis=0), [SIGMA] * 3, rtol=0.045)
    np.testing.assert_allclose(long.std(axis=0), [model.sigma_u, model.sigma_v, model.sigma_w], rtol=0.06)
    assert np.abs(np.corrcoef(long.T) - np.eye(3)).max() < 0.1


def test_vertical_gust_between_2_and_7_hz(long: np.ndarray) -> None:
    """The turbulence detector's scale: 0.0759 sigma_w at 110 kt."""
    f, power = welch(long[:, 2], fs=SPEED / STEP, nperseg=2**16)
    band = (f >= 2) & (f <= 7)
    assert math.sqrt(power[band].sum() * f[1]) == pytest.approx(0.0759 * SIGMA, rel=0.02)


def test_the_same_field_in_any_pieces_and_flat_memory() -> None:
    whole = field(40_000.0)
    pieces = GustField(field_constants(dryden(2500 * FT, SIGMA), SPEED, 0.0), 10.0, np.random.SeedSequence(1))
    most = 0
    for s in np.arange(0.0, 39_000.0, 173.7):
        pieces.cover(s - 10.0, s + 600.0)
        most = max(most, len(pieces.now.values))
        for place in (s - 9.0, s, s + 599.0):
            for component in range(3):
                assert gust_at(pieces.now, place, component) == gust_at(whole.now, place, component)
    assert most < 10_000


def test_turbulence_that_begins_in_flight() -> None:
    late, always = field(3000.0, start_s=16.0), field(3000.0)
    place = (late.now.first + np.arange(len(late.now.values))) * STEP
    assert not late.now.values[place < 16 * SPEED].any()
    after = place >= 17 * SPEED
    np.testing.assert_array_equal(late.now.values[after], always.now.values[after])


def test_calm_air_is_at_rest() -> None:
    assert not field(1000.0, sigma=0.0).now.values.any()
