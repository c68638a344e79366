"""By how much an error of what is held out is less, and how sure that is."""

from __future__ import annotations

import numpy as np
import pytest

from station.diagnosis.judge import lowered
from station.diagnosis.variances import INDEPENDENT

BINS, SERIES = 120, 7


def noise(rng: np.random.Generator) -> np.ndarray:
    return (rng.standard_normal((BINS, SERIES)) + 1j * rng.standard_normal((BINS, SERIES))) / np.sqrt(2)


@pytest.mark.parametrize("frequencies", [1, 8, BINS])
def test_the_interval_of_a_gain_holds_what_many_flights_have_wherever_it_lies(frequencies: int) -> None:
    """What a model leaves in a few frequencies, or in all, and 400 draws of noise; resampled frequencies had told a
    gain that lies in one as if it might not be there."""
    rng = np.random.default_rng(5)
    left = np.zeros((BINS, SERIES), dtype=complex)
    left[:frequencies, 2] = np.sqrt(60 / frequencies) * np.exp(2j * np.pi * rng.random(frequencies))
    found = np.array([lowered([w + left], [w]) for w in (noise(rng) for _ in range(400))])
    value, sd = found.T
    # Neighbours that a taper makes alike scatter more than these, which are independent.
    z = (value - value.mean()) / (sd * np.sqrt(INDEPENDENT))
    assert np.std(z) == pytest.approx(1.0, abs=0.1)
    assert np.mean(value > 1.96 * sd) > 0.99


def test_what_is_not_there_is_no_gain() -> None:
    """A model that moves the residuals of one series for nothing makes them larger."""
    rng = np.random.default_rng(6)
    moved = np.zeros((BINS, SERIES), dtype=complex)
    moved[:20, 4] = 0.5
    found = np.array([lowered([w], [w + moved]) for w in (noise(rng) for _ in range(400))])
    assert np.mean(found[:, 0] - 1.96 * found[:, 1] > 0) < 0.05


def test_residuals_larger_than_noise_make_a_gain_as_much_less_sure() -> None:
    rng = np.random.default_rng(7)
    w, left = noise(rng), np.zeros((BINS, SERIES), dtype=complex)
    left[:8] = 1.0
    sure, doubtful = (lowered([size * w + left], [size * w])[1] for size in (1.0, 3.0))
    count = w.size
    assert doubtful * (9 * count) == pytest.approx(3 * sure * count, rel=0.2)
