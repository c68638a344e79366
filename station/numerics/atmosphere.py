"""The standard atmosphere (ISO 2533, below 20 km), and one rule for the density of the air that is flown in."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from station.conventions import G0, GAS_CONSTANT, SEA_LEVEL_DENSITY

Array = NDArray[np.float64]

SEA_LEVEL_PRESSURE: Final = 101_325.0
SEA_LEVEL_TEMPERATURE: Final = 288.15
LAPSE: Final = 0.0065
"""K/m up to the tropopause."""
TROPOPAUSE: Final = 11_000.0
PRESSURE_POWER: Final = 5.255876
"""g0/(R lapse): of the temperature ratio in the pressure; in the density one less."""
SCALE_HEIGHT: Final = GAS_CONSTANT * 216.65 / G0
"""Over which pressure and density fall by e above the tropopause, m."""


@register_jitable
def atmosphere(height: float) -> tuple[float, float, float]:
    """Pressure (Pa), temperature (K) and density (kg/m3) of the standard atmosphere at a height, m."""
    temperature = SEA_LEVEL_TEMPERATURE - LAPSE * min(height, TROPOPAUSE)
    pressure = SEA_LEVEL_PRESSURE * (temperature / SEA_LEVEL_TEMPERATURE) ** PRESSURE_POWER
    if height > TROPOPAUSE:
        pressure *= math.exp((TROPOPAUSE - height) / SCALE_HEIGHT)
    return pressure, temperature, pressure / (GAS_CONSTANT * temperature)


def height_at_pressure(pressure: float) -> float:
    """m in the standard atmosphere, by its law below the tropopause; Pa."""
    return float((1 - (pressure / SEA_LEVEL_PRESSURE) ** (1 / PRESSURE_POWER)) * SEA_LEVEL_TEMPERATURE / LAPSE)


def height_at_density(density: float) -> float:
    """m in the standard atmosphere, by its law below the tropopause; kg/m3."""
    return float((1 - (density / SEA_LEVEL_DENSITY) ** (1 / (PRESSURE_POWER - 1))) * SEA_LEVEL_TEMPERATURE / LAPSE)


def scale_height(density: float) -> float:
    """m over which the density falls by e, at a density (kg/m3) of the standard atmosphere below the tropopause."""
    temperature = SEA_LEVEL_TEMPERATURE - LAPSE * height_at_density(density)
    return temperature / (LAPSE * (PRESSURE_POWER - 1))


@register_jitable
def air_density(stated: float, pressure: float, temperature: float, altitude: float) -> float:
    """kg/m3, NaN where nothing tells it; each argument is NaN where it is not known. In order of preference:

    1. `stated` by the aircraft's profile, which means this flight's air;
    2. static `pressure` (Pa) and air `temperature` (K) as measured: p/(R T);
    3. the standard atmosphere at the `altitude` (m): a day 10 K warmer is 3.5 % thinner.

    A caller that can do with less says what it takes instead. Dynamic pressure and airspeed give a density too, but the
    forces are normalised with the dynamic pressure itself wherever it is measured.
    """
    if math.isfinite(stated):
        return stated
    if pressure > 0.0 and temperature > 0.0:
        return pressure / (GAS_CONSTANT * temperature)
    if math.isfinite(altitude):
        return atmosphere(altitude)[2]
    return math.nan


@njit(cache=True, error_model="numpy")
def air_densities(stated: float, pressure: Array, temperature: Array, altitude: Array) -> Array:
    """`air_density` of every row, (n,)."""
    out = np.empty(pressure.shape[0])
    for i in range(out.shape[0]):
        out[i] = air_density(stated, pressure[i], temperature[i], altitude[i])
    return out
