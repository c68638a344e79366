"""Random effects: a published meta-analysis, and counted coverage."""

import math

import numpy as np
import pytest

from station.numerics.random_effects import pooled

# Thirteen trials of BCG vaccine: log risk ratios and their variances (Colditz et al. 1994, as in R's metafor).
BCG = (
    -0.8893,
    -1.5854,
    -1.3481,
    -1.4416,
    -0.2175,
    -0.7861,
    -1.6209,
    0.0120,
    -0.4694,
    -1.3713,
    -0.3394,
    0.4459,
    -0.0173,
)
BCG_VARIANCE = (0.3256, 0.1946, 0.4154, 0.0200, 0.0512, 0.0069, 0.2230, 0.0040, 0.0564, 0.0730, 0.0124, 0.5325, 0.0714)


def test_a_published_meta_analysis() -> None:
    """Viechtbauer 2010, J. Stat. Softw. 36(3): REML tau2 = 0.3132, mean -0.7145."""
    made = pooled(BCG, np.sqrt(BCG_VARIANCE).tolist())
    assert made.between**2 == pytest.approx(0.3132, abs=2e-4)
    assert made.value == pytest.approx(-0.7145, abs=2e-4)
    # Its error by the usual formula is 0.1798, and Hartung and Knapp's is not below it.
    assert 0.1798 - 2e-4 <= made.error < 0.19
    assert made.number == 13


def test_without_scatter_it_is_the_weighted_mean() -> None:
    made = pooled([1.0, 1.0, 1.0], [0.1, 0.2, 0.2])
    assert made.value == 1.0
    assert made.between == 0.0
    assert made.error == pytest.approx(1 / math.sqrt(100 + 25 + 25))


def test_one_measurement_has_no_scatter_that_is_known() -> None:
    made = pooled([2.0], [0.5])
    assert (made.value, made.error, made.number) == (2.0, 0.5, 1)
    assert math.isnan(made.between)
    assert made.of_another == 0.5


@pytest.mark.parametrize("scatter", [0.0, 0.3, 2.0])
def test_intervals_of_three_points_hold_the_mean(scatter: float) -> None:
    """Of 2000 baselines of three points, own errors 0.2 to 0.4; 95 % less three binomial standard errors (1.5 %)."""
    rng = np.random.default_rng(1)
    errors = [0.2, 0.3, 0.4]
    held = 0
    for _ in range(2000):
        made = pooled((5.0 + scatter * rng.standard_normal(3) + errors * rng.standard_normal(3)).tolist(), errors)
        low, high = made.interval
        held += low <= 5.0 <= high
    assert held / 2000 > 0.95 - 0.015


@pytest.mark.parametrize(("values", "errors"), [([], []), ([1.0], [0.0]), ([1.0, math.nan], [0.1, 0.1])])
def test_what_cannot_be_pooled(values: list[float], errors: list[float]) -> None:
    with pytest.raises(ValueError, match="measurements"):
        pooled(values, errors)
