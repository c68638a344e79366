"""Sensor channels: each error alone, and independence of how the record is cut."""

from __future__ import annotations

import math

import numpy as np
import pytest

from station.conventions import SIGNALS
from station.simulation.sensors import STANDARD, Channel, Sensor

DT = 0.005


def shown(sensor: Sensor, truth: np.ndarray, every: int = 1, seed: int = 1) -> np.ndarray:
    return Channel("q", sensor, DT, every, seed).measure(truth)


def test_a_perfect_sensor_shows_the_truth_at_its_own_rate() -> None:
    truth = np.arange(20.0)
    np.testing.assert_array_equal(shown(Sensor(), truth, every=4), truth[::4])


def test_noise_has_its_standard_deviation_and_is_white() -> None:
    x = shown(Sensor(noise=0.2), np.zeros(100_000))
    assert x.std() == pytest.approx(0.2, rel=0.01)
    assert abs(np.corrcoef(x[1:], x[:-1])[0, 1]) < 0.01


def test_gain_bias_quantum() -> None:
    np.testing.assert_allclose(shown(Sensor(gain=2.0, bias=1.0), np.array([0.0, 3.0])), [1.0, 7.0])
    x = shown(Sensor(quantum=0.25), np.linspace(-1, 1, 101))
    np.testing.assert_array_equal(x, np.round(x * 4) / 4)
    assert np.abs(x - np.linspace(-1, 1, 101)).max() <= 0.125


def test_latency_shows_what_was_true_earlier() -> None:
    t = np.arange(400) * DT
    x = shown(Sensor(latency=0.0323), 3 * t)
    np.testing.assert_allclose(x[10:], 3 * (t[10:] - 0.0323), atol=1e-12)
    assert x[0] == 0.0


def test_lag_is_first_order() -> None:
    t = np.arange(400) * DT
    x = shown(Sensor(lag=0.1), t)
    np.testing.assert_allclose(x, t - 0.1 + 0.1 * np.exp(-t / 0.1), atol=1e-12)


@pytest.mark.parametrize(("share", "length"), [(0.05, 0.0), (0.2, 0.0), (0.1, 0.2)])
def test_dropout_loses_its_share_in_gaps_of_its_length(share: float, length: float) -> None:
    lost = np.isnan(shown(Sensor(dropout=share, dropout_length=length), np.zeros(200_000)))
    gaps = int((lost[1:] & ~lost[:-1]).sum())
    mean = max(length / DT, 1 / (1 - share))
    assert lost.sum() / gaps == pytest.approx(mean, rel=0.08)
    # A gap's length and the way to the next one are both geometric: the share is known to sqrt(2/gaps) of itself.
    assert lost.mean() == pytest.approx(share, rel=4 * math.sqrt(2 / gaps))


def test_signals_of_one_stream_are_lost_together() -> None:
    one, other, apart = (
        np.isnan(Channel(n, Sensor(dropout=0.2, stream=s), DT, 4, 3).measure(np.zeros(4000)))
        for n, s in (("p", 1), ("q", 1), ("r", 2))
    )
    np.testing.assert_array_equal(one, other)
    assert not np.array_equal(one, apart)


def test_the_same_bits_however_the_record_is_cut() -> None:
    truth = np.sin(np.arange(1000) * 0.01)
    sensor = Sensor(noise=0.1, bias=0.01, gain=1.02, quantum=1e-3, lag=0.03, latency=0.0171, dropout=0.1)
    whole = shown(sensor, truth, every=4, seed=7)
    channel = Channel("q", sensor, DT, 4, 7)
    cuts = np.split(truth, [0, 1, 2, 7, 7, 100, 333, 998])
    np.testing.assert_array_equal(np.concatenate([channel.measure(part) for part in cuts]), whole)
    assert not np.array_equal(whole, shown(sensor, truth, every=4, seed=8))


def test_two_signals_have_independent_noise() -> None:
    a, b = (Channel(name, Sensor(noise=1.0), DT, 1, 3).measure(np.zeros(10_000)) for name in ("p", "q"))
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.05


def test_the_standard_installation() -> None:
    assert set(STANDARD) <= set(SIGNALS)
    assert STANDARD["alpha_vane"].noise == pytest.approx(math.radians(0.05))
    assert STANDARD["az"].noise == pytest.approx(0.004 * 9.80665)
