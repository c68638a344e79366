"""What a record's rounding and its rate do to noise, groups of bins, and rates."""

from __future__ import annotations

import math

import numpy as np
import pytest

from station.diagnosis.manoeuvre import groups_of, quantum
from station.diagnosis.processing import Setting, bridge_of, integral, rate


def test_the_step_of_a_rounded_signal_is_told_and_of_a_noisy_one_none() -> None:
    """The error of rounding is step/sqrt(12), whose step a recorder chose."""
    rng = np.random.default_rng(4)
    slow = np.sin(np.arange(3000) / 200) + 0.02 * rng.standard_normal(3000)
    assert quantum(0.06 * np.round(slow / 0.06)) == pytest.approx(0.06)
    assert quantum(slow) == 0.0
    assert quantum(np.zeros(100)) == 0.0


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
