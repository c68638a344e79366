"""What a record's rounding and its rate do to noise, groups of bins, and rates; fast records thinned."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from blind import Case, aircraft, fly_case
from numpy.typing import NDArray
from scipy.signal import butter, lfilter, sosfiltfilt, welch

from station.diagnosis.manoeuvre import at_rate_judged, groups_of, manoeuvre
from station.diagnosis.measured_record import Record
from station.diagnosis.processing import HIGH_HZ, LOW_HZ, Setting, bridge_of, integral, rate, thinned
from station.diagnosis.recorded_noise import judged_noise, quantum, white_noise
from station.diagnosis.variances import LEVEL_SD, SEEN_SD, prior_levels, stiffness_of

Array = NDArray[np.float64]


def test_the_step_of_a_rounded_signal_is_told_and_of_a_noisy_one_none() -> None:
    """The error of rounding is step/sqrt(12), whose step a recorder chose."""
    rng = np.random.default_rng(4)
    slow = np.sin(np.arange(3000) / 200) + 0.02 * rng.standard_normal(3000)
    assert quantum(0.06 * np.round(slow / 0.06)) == pytest.approx(0.06)
    assert quantum(slow) == 0.0
    assert quantum(np.zeros(100)) == 0.0
    # Put on a grid between its samples, which splits a step in two.
    t = np.arange(3000) + 0.3 * rng.random(3000)
    rounded = 0.06 * np.round(np.sin(t / 200) / 0.06)
    assert quantum(np.interp(np.arange(1, 2999), t, rounded)) == pytest.approx(0.06)


def test_a_simulated_surface_that_stands_still_between_doublets_is_not_rounded() -> None:
    """It has no noise, and repeats the values between which an actuator's lag takes it; or jumps, where it has none."""
    commanded = np.zeros(3000)
    for at, size in ((500, 6.0), (900, 3.0), (1300, -3.0), (1800, 9.0)):
        commanded[at : at + 40], commanded[at + 40 : at + 80] = size, -size
    lagging = lfilter([0.2], [1.0, -0.8], commanded)
    assert quantum(lagging) == 0.0
    assert quantum(np.where(np.abs(commanded) > 3.0, 3.0 * np.sign(commanded), commanded)) == 0.0


def rounded(top: float, steps: float, noise: float, dt: float) -> tuple[Record, Array]:
    """Motion up to `top` Hz by so many steps a standard deviation, and white noise, rounded; and the error of that."""
    rng = np.random.default_rng(6)
    motion = sosfiltfilt(butter(2, top, fs=1 / dt, output="sos"), rng.standard_normal(round(240.0 / dt)))
    motion *= steps / motion.std()
    shown = np.round(motion + noise * rng.standard_normal(len(motion)))
    return Record("rounded", dt, 0.0, {"alpha_vane": shown}, 1.2, 500.0, stated={"alpha_vane": 1e-3}), shown - motion


@pytest.mark.parametrize("top", [0.3, 1.0, 2.0])
@pytest.mark.parametrize("steps", [5.0, 20.0])
@pytest.mark.parametrize("noise", [0.0, 0.2, 0.5, 1.0])
def test_noise_of_a_rounded_signal_is_that_of_its_error(top: float, steps: float, noise: float) -> None:
    """By the median of fourth differences, a whole number of steps, it was 1.8 times as large, or none."""
    record, error = rounded(top, steps, noise, 0.01)
    assert white_noise("alpha_vane", record) == pytest.approx(error.std(), rel=0.2)


@pytest.mark.parametrize("top", [0.3, 1.0, 2.0])
@pytest.mark.parametrize("steps", [0.5, 2.0, 10.0, 50.0])
def test_noise_of_rounding_is_as_dense_as_its_error_at_the_frequencies_judged(top: float, steps: float) -> None:
    """Held against the spectrum of the error itself. As white noise of step/sqrt(12), slow motion by coarse steps had a
    quarter of it."""
    dt = 0.01
    record, error = rounded(top, steps, 0.0, dt)
    f, density = welch(error, fs=1 / dt, nperseg=round(10.0 / dt))
    seen = math.sqrt(density[(f > LOW_HZ) & (f < HIGH_HZ)].mean() / (2 * dt))
    assert judged_noise("alpha_vane", record) == pytest.approx(seen, rel=0.35)


def test_how_rounding_is_spread_over_the_frequencies_is_left_to_the_fit() -> None:
    """Slow motion by coarse steps is no white noise of step/sqrt(12): samples show the step and not the level."""
    record = fly_case(Case(seed=7, sigma=1.5), "3-2-1-1", 0)
    rounded = replace(record, signals={**record.signals, "v_down": 0.3 * np.round(record.signals["v_down"] / 0.3)})
    for of, sd in ((record, SEEN_SD), (rounded, LEVEL_SD)):
        made = manoeuvre(of, aircraft())
        at = made.trim.sensors.index("v_down")
        assert stiffness_of([made], prior_levels([made]))[0, at] == pytest.approx(1 / sd**2)


@pytest.mark.parametrize("seconds", [8.0, 30.0, 60.0, 300.0])
def test_groups_hold_every_bin_once_and_the_one_in_their_middle_stands_for_them(seconds: float) -> None:
    f = np.arange(0.1, 3.0, 1 / seconds)
    groups = groups_of(f)
    assert sorted(groups.members[groups.there > 0].tolist()) == list(range(len(f)))
    shown = np.arange(len(f)) + 0j
    middle = groups.gathered(shown[:, None])[:, 0].sum(-1) / groups.count
    np.testing.assert_allclose(middle.real, groups.pick)


@pytest.mark.parametrize("frequency", [0.5, 1.5, 2.5])
def test_rates_and_integrals_of_ten_samples_a_second_are_exact(frequency: float) -> None:
    """Held against those of a sine that swells and dies away; Euler and Maclaurin's next term is (omega dt)^4/720."""
    dt, n, w = 0.1, 400, 2 * math.pi * frequency
    s = Setting(dt, n, bridge_of(dt, n), (0,), (0.0, 0.0, 0.0), 0.0, 0.0, False, {})
    t = dt * np.arange(n)
    swell = np.exp(-(((t - 20.0) / 5.0) ** 2))
    x = swell * np.sin(w * t)
    turned = swell * (w * np.cos(w * t) - 2 * (t - 20.0) / 25.0 * np.sin(w * t))
    np.testing.assert_allclose(rate(x, s) / w, turned / w, atol=1e-5)
    np.testing.assert_allclose(integral(turned, s), x, atol=1.2 * (w * dt) ** 4 / 720 + 1e-5)


@pytest.mark.parametrize(("dt", "every"), [(0.02, 2), (0.01, 4), (0.004, 10)])
def test_a_thinned_signal_has_what_is_judged_and_none_of_what_would_fold(dt: float, every: int) -> None:
    t = dt * np.arange(round(40.0 / dt))
    inside = slice(round(2.0 / dt / every), -round(2.0 / dt / every))
    slow = np.sin(2 * np.pi * 0.3 * t) + 0.2 * np.cos(2 * np.pi * 3.0 * t)
    kept = thinned(slow + np.sin(2 * np.pi * 23.0 * t), dt, every)
    assert len(kept) == math.ceil(len(t) / every)
    np.testing.assert_allclose(kept[inside], slow[::every][inside], atol=2e-3)


def test_a_record_is_compared_as_at_its_own_rate_and_no_oftener_than_25_times_a_second() -> None:
    """At 50 Hz by a record that repeats a value somewhere, which is not thinned: series, noise, and its prior alike."""
    record = fly_case(Case(seed=7, sigma=1.5), "3-2-1-1", 0)
    made, own = manoeuvre(record, aircraft()), manoeuvre(replace(record, held={"none": np.arange(3)}), aircraft())
    assert (made.record.dt, own.record.dt) == (2 * record.dt, record.dt)
    assert at_rate_judged(made.record) is made.record
    here, there = (m.differences(aircraft()) for m in (made, own))
    for row, at_own_rate in zip(here.bins, there.bins, strict=True):
        size = math.sqrt(float((np.abs(at_own_rate) ** 2).mean()))
        # Noise beyond the rate that is left is not there to be turned into what is judged.
        apart = np.abs(row / made.thinner - at_own_rate)
        assert math.sqrt(float((apart**2).mean())) < 0.02 * size
    assert made.noise("q") == pytest.approx(own.noise("q") * math.sqrt(0.5))
