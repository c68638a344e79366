"""The turbulence level and its class."""

import math

import numpy as np
import pytest

from station.conventions import to_si
from station.estimation.turbulence import Turbulence

DT = 0.02


def run(angle, speed=56.6, noise=0.0, seconds=40.0):
    turbulence = Turbulence(DT, noise)
    names = []
    for k in range(round(seconds / DT)):
        turbulence.step(angle(k * DT), speed)
        names.append(turbulence.name)
    return turbulence, names


@pytest.mark.parametrize(
    ("sigma_ft_s", "name"), [(0.1, "calm"), (0.2, "light"), (0.7, "light"), (1.0, "moderate"), (2.0, "severe")]
)
def test_a_sine_in_the_band_has_the_level_of_its_rms(sigma_ft_s, name):
    amplitude = math.sqrt(2) * to_si(sigma_ft_s, "ft/s") / 56.6
    turbulence, _ = run(lambda t: amplitude * math.sin(2 * math.pi * 4 * t))
    assert turbulence.level == pytest.approx(to_si(sigma_ft_s, "ft/s"), rel=0.02)
    assert turbulence.name == name


def test_slow_motion_is_outside_the_band():
    turbulence, _ = run(lambda t: 0.1 * math.sin(2 * math.pi * 0.5 * t))
    assert turbulence.name == "calm"


def test_unknown_until_settled():
    _, names = run(lambda t: 0.0, seconds=6)
    assert names[0] == "unknown"
    assert names[-1] == "calm"


def test_a_noisier_vane_is_not_turbulence():
    rng = np.random.default_rng(1)
    noise = to_si(0.2, "deg")
    samples = rng.normal(0, noise, 2001)
    loud, _ = run(lambda t: samples[round(t / DT)], noise=noise)
    ignorant, _ = run(lambda t: samples[round(t / DT)], noise=0.0)
    assert loud.name == "calm"
    assert ignorant.name == "light"
