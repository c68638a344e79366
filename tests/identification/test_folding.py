"""What lies above half a record's rate, and folds into the lines."""

from __future__ import annotations

import numpy as np
import pytest

from station.identification.folding import folded_share

FINE_HZ, SECONDS, BAND = 400.0, 120.0, (0.1, 1.0)


def falling(power: float, rng: np.random.Generator) -> np.ndarray:
    """A signal at FINE_HZ whose spectrum falls by a power of frequency above 0.3 Hz."""
    n = round(FINE_HZ * SECONDS)
    f = np.fft.rfftfreq(n, 1 / FINE_HZ)
    z = rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f))
    return np.fft.irfft(z * (1 + (f / 0.3) ** 2) ** (power / 4), n)


def lines(x: np.ndarray, hz: float) -> np.ndarray:
    t = np.arange(len(x)) / hz
    x = x - np.polyval(np.polyfit(t, x, 1), t)
    f = np.arange(*BAND, 1 / SECONDS)
    return np.exp(-2j * np.pi * f[:, None] * t) @ (x * np.hanning(len(x))) / hz


@pytest.mark.parametrize(
    ("power", "hz"), [(-3.0, 10), *(pytest.param(p, 5, marks=pytest.mark.slow) for p in (-2.5, -3.0, -3.5))]
)
def test_the_share_is_what_sampling_adds_to_the_lines(power: float, hz: int) -> None:
    """Against the same lines of the signal before it was sampled, 20 signals; a spectrum that falls otherwise by half a
    power makes it wrong by a third at most."""
    rng = np.random.default_rng(7)
    found, true = [], []
    for _ in range(20):
        x = falling(power, rng)
        sampled = x[:: round(FINE_HZ / hz)]
        all_of_it, whole = lines(sampled, hz), lines(x, FINE_HZ)
        true.append((np.abs(all_of_it - whole) ** 2).sum() / (np.abs(whole) ** 2).sum())
        found.append(folded_share(sampled, 1 / hz, BAND, 0.0) ** 2)
    # Of 20 signals the mean is known to 5 %.
    rel = 0.15 if power == -3.0 else 0.75
    assert np.mean(found) == pytest.approx(np.mean(true), rel=rel)


def test_noise_is_not_folded_motion() -> None:
    """Of a stated size: its mean power differs from that by three standard errors once in some hundred times."""
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 120.0, 0.1)
    found = [
        folded_share(np.sin(2 * np.pi * 0.4 * t) + 0.1 * rng.standard_normal(len(t)), 0.1, BAND, 0.1) for _ in range(40)
    ]
    assert sum(share > 0.0 for share in found) <= 2
    assert folded_share(np.sin(t[:10]), 0.1, BAND, 0.1) == 0.0
