"""The turbulence level and its class."""

import math

import numpy as np
import pytest

from station.conventions import to_si
from station.numerics.turbulence import Turbulence, classified, gust_sigma, in_band

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


def dryden_in_band(speed):
    """Standard deviation in 2-7 Hz over all, by integration of MIL-F-8785C's spectrum of the vertical gust."""
    length = to_si(1750, "ft")
    f = np.linspace(2, 7, 2001)
    x = 2 * np.pi * f * length / speed
    density = 2 * length / speed * (1 + 3 * x**2) / (1 + x**2) ** 2
    return math.sqrt(np.trapezoid(density, f))


@pytest.mark.parametrize("speed", [20.0, 56.6, 210.0])
def test_the_share_of_dryden_gusts_in_the_band_at_any_speed(speed):
    assert in_band(speed) == pytest.approx(dryden_in_band(speed), rel=0.03)
    assert gust_sigma(1.5 * in_band(speed), speed, 0.0, DT) == pytest.approx(1.5, rel=1e-9)


@pytest.mark.parametrize("speed", [20.0, 56.6, 210.0])
@pytest.mark.parametrize(("sigma_ft_s", "name"), [(0.0, "calm"), (1.0, "calm"), (3.0, "light"), (5.0, "light"),
                                                  (13.0, "moderate"), (22.0, "severe")])  # fmt: skip
@pytest.mark.parametrize("noise_deg", [0.05, 0.15])
def test_the_same_gusts_are_of_the_same_class_at_any_speed(speed, sigma_ft_s, name, noise_deg):
    noise = to_si(noise_deg, "deg")
    # White noise up to 25 Hz has a fifth of its variance between 2 and 7 Hz.
    level = math.hypot(dryden_in_band(speed) * to_si(sigma_ft_s, "ft/s"), speed * noise * math.sqrt(0.2))
    assert classified(level, speed, noise, DT) == name
