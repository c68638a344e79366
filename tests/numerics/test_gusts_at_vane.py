"""What a vane leaves of gusts: against gusts flown through one in the time domain."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter, sosfilt

from station.numerics.gusts_at_vane import Shown
from station.numerics.turbulence import Sharp, Turbulence

FINE = 1e-3
TICK = 20
"""Fine steps."""


def gusts(seed: int, seconds: float = 2000.0) -> np.ndarray:
    """A random walk, whose spectrum falls with the square of frequency, forgotten over 10 s."""
    steps = np.random.default_rng(seed).standard_normal(round(seconds / FINE))
    return lfilter([1.0], [1.0, -np.exp(-FINE / 10.0)], steps)


def shown(gust: np.ndarray, frequency: float, damping: float) -> np.ndarray:
    """Newmark's rule in steps that are short to the vane."""
    omega = 2 * np.pi * frequency
    a, b = (omega * FINE) ** 2 / 4, damping * omega * FINE
    return lfilter([a, 2 * a, a], [1 + b + a, -2 + 2 * a, 1 - b + a], gust)


def in_band(x: np.ndarray) -> float:
    return float(sosfilt(butter(4, [2, 7], "bandpass", fs=1 / FINE, output="sos"), x)[20000:].std())


@pytest.mark.parametrize(("frequency", "damping"), [(9.0, 0.35), (6.0, 0.2), (14.0, 0.6)])
@pytest.mark.parametrize("late", [0.0, 0.05, -0.1])
def test_what_is_left_of_gusts(frequency: float, damping: float, late: float) -> None:
    """Ten thousand independent values: within 3 %."""
    gust = gusts(1)
    vane = shown(gust, frequency, damping)
    lag = damping / (np.pi * frequency)
    at = np.arange(1000, len(gust) - 1000)
    moved = np.interp(at + (lag - late) / FINE, np.arange(len(vane)), vane)
    off = (moved - gust[at]).std() / in_band(vane)
    assert Shown(frequency, damping).left(late, 0.0, (0.0, 0.0)) == pytest.approx(off, rel=0.03)


def test_doubt_of_delay_and_dynamics_is_what_a_hundred_of_them_leave() -> None:
    rng, gust = np.random.default_rng(2), gusts(3, 300.0)
    lag, level = 0.35 / (np.pi * 9.0), in_band(shown(gust, 9.0, 0.35))
    at = np.arange(1000, len(gust) - 1000)
    squares = []
    for _ in range(100):
        other = shown(gust, 9.0 * (1 + 0.1 * rng.standard_normal()), 0.35 * (1 + 0.15 * rng.standard_normal()))
        moved = np.interp(at + (lag + 0.008 * rng.standard_normal()) / FINE, np.arange(len(other)), other)
        squares.append(np.mean((moved - gust[at]) ** 2))
    found = Shown(9.0, 0.35).left(0.0, 0.008, (0.1, 0.15))
    assert found == pytest.approx(np.sqrt(np.mean(squares)) / level, rel=0.05)


@pytest.mark.parametrize("every", [0.04, 0.1])
def test_a_slow_recorder_s_spline_leaves_more(every: float) -> None:
    gust = gusts(4)
    vane = shown(gust, 9.0, 0.35)
    step = round(every / FINE)
    spline = CubicSpline(np.arange(0, len(vane), step), vane[::step])
    lag = 0.35 / (np.pi * 9.0)
    at = np.arange(1000, len(gust) - 1000, 7)
    off = (spline(at + lag / FINE) - gust[at]).std() / in_band(vane)
    assert Shown(9.0, 0.35, every).left(0.0, 0.0, (0.0, 0.0)) == pytest.approx(off, rel=0.03)
    noise = CubicSpline(np.arange(40000), np.random.default_rng(5).standard_normal(40000))(np.arange(100, 39000, 0.1))
    second = noise[20:] - 2 * noise[10:-10] + noise[:-20]
    assert Shown(9.0, 0.35, every).white == pytest.approx(np.mean(second**2) / noise.var(), rel=0.03)


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.1])
def test_gusts_and_noise_are_told_apart(noise: float) -> None:
    """Of a vane at 50 m/s with a gust of 0.3 m/s in the band: 10 s have a hundred independent values."""
    vane = shown(gusts(6, 60.0), 9.0, 0.35)
    ticks = 0.3 * vane[::TICK] / in_band(vane) + noise * np.random.default_rng(7).standard_normal(len(vane) // TICK)
    ticks_second = Sharp(1, Shown(9.0, 0.35).sharpness(0.02), 6.0)
    turbulence = Turbulence(0.02, 0.0, sharp=ticks_second)
    found = []
    for x in ticks:
        turbulence.step(x / 50.0, 50.0)
        found.append((turbulence.gust, turbulence.noise_shown))
    gust, told = np.sqrt(np.nanmean(np.square(found[1000:]), axis=0))
    assert gust == pytest.approx(0.3, rel=0.1)
    assert told == pytest.approx(noise, abs=0.03)


def test_a_record_too_slow_for_the_band_has_its_gusts_told_by_how_they_jump() -> None:
    vane = shown(gusts(8, 120.0), 9.0, 0.35)
    step = 100  # fine steps of a recorder at 10 Hz
    ticks = CubicSpline(np.arange(0, len(vane), step), vane[::step])(np.arange(0, len(vane) - step, TICK))
    known = Shown(9.0, 0.35, step * FINE)
    turbulence = Turbulence(0.02, 0.0, sharp=Sharp(5, known.sharpness(0.1), known.white), sees_band=False)
    found = []
    for x in 0.3 * ticks / in_band(vane):
        turbulence.step(x / 50.0, 50.0)
        found.append(turbulence.gust)
    assert turbulence.name == "unknown"
    assert np.isnan(turbulence.level)
    assert np.sqrt(np.nanmean(np.square(found))) == pytest.approx(0.3, rel=0.1)
