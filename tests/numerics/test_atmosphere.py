"""The standard atmosphere against ISO 2533's table, and the order of preference of the air's density."""

import math

import numpy as np
import pytest

from station.numerics.atmosphere import (
    air_densities,
    air_density,
    atmosphere,
    height_at_density,
    height_at_pressure,
)

NAN = math.nan


@pytest.mark.parametrize(
    ("height", "pressure", "temperature", "density"),
    [
        (0.0, 101_325.0, 288.15, 1.225),
        (1_000.0, 89_874.6, 281.65, 1.11164),
        (5_000.0, 54_019.9, 255.65, 0.736116),
        (11_000.0, 22_632.0, 216.65, 0.363918),
        (15_000.0, 12_044.6, 216.65, 0.193674),
        (20_000.0, 5_474.87, 216.65, 0.0880346),
    ],
)
def test_iso_2533(height, pressure, temperature, density):
    """The table has six digits, by geopotential height."""
    np.testing.assert_allclose(atmosphere(height), (pressure, temperature, density), rtol=1e-5)


def test_heights_are_the_inverse():
    pressure, _, density = atmosphere(3_000.0)
    assert height_at_pressure(pressure) == pytest.approx(3_000.0, abs=1e-6)
    # The law's own sea-level density is 1.225 to 2e-8.
    assert height_at_density(density) == pytest.approx(3_000.0, abs=1e-2)


def test_the_profile_then_static_air_data_then_the_altitude():
    """By hand: 90,000 Pa at 300 K are 1.045104 kg/m3."""
    assert air_density(1.1, 90_000.0, 300.0, 5_000.0) == 1.1
    assert air_density(NAN, 90_000.0, 300.0, 5_000.0) == pytest.approx(90_000.0 / (287.05287 * 300.0), rel=1e-15)
    assert air_density(NAN, 90_000.0, NAN, 5_000.0) == pytest.approx(0.736116, rel=1e-5)
    assert air_density(NAN, NAN, 300.0, 5_000.0) == pytest.approx(0.736116, rel=1e-5)
    assert math.isnan(air_density(NAN, 90_000.0, NAN, NAN))


def test_each_row_by_what_it_has():
    rows = air_densities(NAN, np.array([90_000.0, NAN, NAN]), np.full(3, 300.0), np.array([NAN, 0.0, NAN]))
    np.testing.assert_allclose(rows, [1.045104, 1.225, NAN], rtol=1e-6)
