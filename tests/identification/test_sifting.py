"""Sifted lines carry the input and not the gusts."""

import numpy as np
import pytest

from station.identification.sifting import sift
from station.numerics.regression import NotIdentifiable

DT, PERIOD, BAND = 0.02, 10.0, (0.1, 2.0)
TRUTH = np.array([-1.3, -35.0, -1.7])


def _flight(seed: int, gusts: float = 0.02, periods: int = 6) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Periodic answers to a multisine; a gust that adds to the coefficient and is no regressor."""
    rng = np.random.default_rng(seed)
    n = round(periods * PERIOD / DT)
    t = np.arange(n) * DT
    columns = [np.zeros(n) for _ in range(3)]
    for k in range(1, 21):
        phase, w = rng.uniform(0, 6.28), 2 * np.pi * k / PERIOD
        answer = 1 / (3.0**2 - w**2 + 2j * 0.6 * 3.0 * w)
        columns[2] += 0.01 * np.sin(w * t + phase)
        columns[0] += 0.06 * abs(answer) * np.sin(w * t + phase + np.angle(answer))
        columns[1] += 0.0005 * w * abs(answer) * np.cos(w * t + phase + np.angle(answer) + 0.4)
    gust = np.zeros(n)
    white = rng.standard_normal(n)
    for k in range(1, n):
        gust[k] = 0.98 * gust[k - 1] + 0.2 * white[k]
    z = sum(p * x for p, x in zip(TRUTH, columns, strict=True)) + gusts * gust
    return columns, np.asarray(z), columns[2] + 1e-5 * rng.standard_normal(n)


def test_forced_lines_give_the_parameters_in_spite_of_gusts() -> None:
    inside = 0
    for seed in range(20):
        columns, z, surface = _flight(seed)
        made = sift(columns, z, [surface], DT, PERIOD, BAND)
        assert made.periods == 6
        assert made.lines_hz == pytest.approx(np.arange(1, 21) / PERIOD)
        inside += int(np.sum(np.abs(made.estimate - TRUTH) < 1.96 * made.std_error))
    assert inside >= 50


def test_a_gust_that_acts_otherwise_than_alpha_biases_all_lines_and_not_the_forced() -> None:
    """Alpha holds the gust, but the moment answers it half as much: the usual fit mixes both, sifting does not."""
    sifted, plain, disagree = [], [], 0
    for seed in range(10):
        columns, z, surface = _flight(seed, gusts=0.0)
        gust = (_flight(seed, gusts=0.01)[1] - z) / 1.0
        alpha = columns[0] + gust
        z = z + 0.5 * TRUTH[0] * gust
        made = sift([alpha, *columns[1:]], z, [surface], DT, PERIOD, BAND)
        every = np.linalg.lstsq(np.column_stack([alpha, *columns[1:], np.ones(len(z))]), z)[0]
        sifted.append(made.estimate[0])
        plain.append(every[0])
        disagree += not made.agree
    assert abs(np.mean(plain) - TRUTH[0]) > 3 * abs(np.mean(sifted) - TRUTH[0])
    assert disagree >= 8


def test_without_gusts_the_parameters_are_exact() -> None:
    columns, z, surface = _flight(1, gusts=0.0)
    made = sift(columns, z + 0.3, [surface], DT, PERIOD, BAND)
    assert made.estimate == pytest.approx(TRUTH, rel=1e-3)


def test_too_few_periods_no_lines_and_collinear_regressors_are_refused() -> None:
    columns, z, surface = _flight(1, periods=2)
    with pytest.raises(NotIdentifiable, match="fewer than 2 periods"):
        sift(columns, z, [surface], DT, 15.0, BAND)
    noise = 1e-3 * np.random.default_rng(1).standard_normal(len(z))
    with pytest.raises(NotIdentifiable, match="no distinct lines"):
        sift(columns, z, [noise], DT, PERIOD, BAND)
