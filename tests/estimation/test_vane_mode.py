"""A second-order vane's mode of known frequency and damping in coloured gusts and noise; none where there is none."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import signal

from station.estimation.vane_mode import Mode, find_mode
from station.numerics.cross_spectrum import Bins, binned, cross_spectra
from station.numerics.regression import NotIdentifiable

DT = 0.02
SECONDS = 200
GUST = 0.02
"""rad, of the gust's angle."""


def spectrum(seed: int, mode: tuple[float, float] | None, noise: float) -> Bins:
    """Of first-order gusts (0.1 Hz), through scipy's own filter of the mode at 1 kHz, then sampled, noise added:
    nothing of the station's."""
    rng = np.random.default_rng(seed)
    rate = 1000
    n = SECONDS * rate
    pole = math.exp(-2 * math.pi * 0.1 / rate)
    x = signal.lfilter([math.sqrt(1 - pole**2)], [1, -pole], rng.normal(size=n)) * GUST
    if mode is not None:
        w, zeta = 2 * math.pi * mode[0], mode[1]
        x = signal.lfilter(*signal.bilinear([w * w], [1, 2 * zeta * w, w * w], fs=rate), x)
    shown = x[:: round(rate * DT)]
    shown = shown + noise * rng.normal(size=len(shown))
    segment = 500
    found = cross_spectra(shown, shown, np.ones(len(shown), dtype=bool), DT, segment)
    return binned(found, np.geomspace(0.2, 25.0, 90))


@pytest.mark.parametrize(("frequency", "damping"), [(9.0, 0.35), (9.0, 0.05), (6.0, 0.15), (14.0, 0.1)])
def test_frequency_and_damping_are_found_within_their_errors(frequency: float, damping: float) -> None:
    found: list[Mode] = []
    for seed in range(4):
        s = spectrum(seed, (frequency, damping), 1e-4)
        found.append(find_mode(s.frequencies_hz, s.xx, s.own, 25.0))
    away = [(m.frequency_hz - frequency) / m.frequency_sd for m in found]
    off = [(m.damping - damping) / m.damping_sd for m in found]
    # Eight standard normal numbers: their mean square is below 3.27 in 999 of 1000.
    assert np.mean(np.square(away + off)) < 3.27, (away, off)
    assert max(m.frequency_sd for m in found) < 0.08 * frequency
    assert max(m.damping_sd for m in found) < 0.12


def test_a_density_s_interval_holds_it_nineteen_times_in_twenty() -> None:
    """White noise of unit variance has 2 dt everywhere; chi-squared with two degrees of freedom a segment and line."""
    inside = total = 0
    for seed in range(20):
        white = np.random.default_rng(seed).normal(size=6000)
        s = binned(cross_spectra(white, white, np.ones(6000, dtype=bool), DT, 400), np.geomspace(1.0, 25.0, 20))
        low, high = s.band(s.xx)
        inside += int(np.count_nonzero((low < 2 * DT) & (high > 2 * DT)))
        total += len(low)
    # 95 % of 380, by the binomial law to 3 standard deviations.
    assert abs(inside / total - 0.95) < 3 * math.sqrt(0.95 * 0.05 / total)


@pytest.mark.parametrize("noise", [1e-4, 3e-3])
def test_no_mode_is_found_where_there_is_none(noise: float) -> None:
    for seed in range(3):
        s = spectrum(100 + seed, None, noise)
        with pytest.raises(NotIdentifiable, match="no mode"):
            find_mode(s.frequencies_hz, s.xx, s.own, 25.0)


def test_a_mode_below_the_noise_is_not_found() -> None:
    """As in Martos 2013, Figure 19: at 8 and 9 Hz there is noise only."""
    s = spectrum(1, (9.0, 0.35), 3e-2)
    with pytest.raises(NotIdentifiable, match="no mode"):
        find_mode(s.frequencies_hz, s.xx, s.own, 25.0)


def test_a_slow_record_is_refused() -> None:
    f = np.geomspace(0.1, 2.4, 40)
    with pytest.raises(NotIdentifiable, match="too few"):
        find_mode(f, f**-2, np.full(40, 20.0), 2.5)
