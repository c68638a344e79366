"""A static port's error of synthetic flights: by closed form, and its interval counted."""

from __future__ import annotations

import numpy as np
import pytest

from station.conventions import G0, GAS_CONSTANT
from station.model.static_port import StaticPort, static_port
from station.numerics.regression import NotIdentifiable

ERROR = 0.03


def flight(seed: int | None, speeds: tuple[float, ...] = (57.0, 57.0, 70.0, 70.0, 44.0, 44.0)) -> StaticPort:
    """Ten blocks of 4 s at each speed, heights off by 60 m; `seed`: of noise, GNSS wander and weather, or none."""
    speed = np.repeat(speeds, 10)
    time = 4.0 * np.arange(len(speed))
    height = 760 + 60 * np.sin(time / 37)
    temperature = 283.0
    pressure = 92_500 * np.exp(-G0 * (height - 760) / (GAS_CONSTANT * temperature))
    q = 0.5 * 1.13 * speed**2
    if seed is not None:
        rng = np.random.default_rng(seed)
        wander = np.zeros(len(time))
        for k in range(1, len(time)):
            wander[k] = np.exp(-4 / 60) * wander[k - 1] + np.sqrt(1 - np.exp(-8 / 60)) * rng.normal()
        pressure = pressure + rng.normal(0, 3, len(time)) + 8 * wander + np.cumsum(rng.normal(0, 0.6, len(time)))
    return static_port(time, pressure + ERROR * q, height, np.full(len(time), temperature), q)


def test_exact_without_noise() -> None:
    assert flight(None).error == pytest.approx(ERROR, abs=2e-5)


def test_its_interval_covers_as_it_says() -> None:
    """Of 40 flights at most 5 lie outside of 95 % (by chance 2; 6 and more one time in 70)."""
    found = [flight(seed) for seed in range(40)]
    outside = [abs(f.error - ERROR) > 1.96 * f.sd for f in found]
    assert sum(outside) <= 5
    assert np.mean([f.sd for f in found]) < 0.01


def test_air_that_is_colder_above() -> None:
    """The standard atmosphere's pressure (ICAO Doc 7488) over 400 m: of air as warm throughout, 12 Pa would be left at
    its ends, which is as much as half a per cent of the dynamic pressure."""
    height = np.linspace(400.0, 800.0, 60)
    warm = 288.15 - 0.0065 * height
    pressure = 101_325 * (warm / 288.15) ** 5.25588
    q = 1000 + 2000 * ((height - 600) / 200) ** 2
    found = static_port(4.0 * np.arange(60), pressure + ERROR * q, height, warm, q)
    assert found.error == pytest.approx(ERROR, abs=5e-5)


def test_one_speed_tells_nothing() -> None:
    with pytest.raises(NotIdentifiable, match="flown at one speed"):
        flight(1, (57.0, 57.5, 57.0))
