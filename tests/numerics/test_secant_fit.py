"""Least squares with few evaluations, against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from station.numerics.secant_fit import secant_fit

T = np.linspace(0.0, 20.0, 201)


def swung(x: np.ndarray) -> np.ndarray:
    """An oscillation whose frequency, damping, start and level are moved, strongly curved in the first two."""
    frequency, damping = 1.0 + 0.1 * x[0], 0.1 + 0.05 * x[1]
    return (1 + x[2]) * np.exp(-damping * T) * np.cos(frequency * T + 0.3 * x[3]) + 0.2 * x[4]


class Counted:
    def __init__(self, true: np.ndarray, noise: float) -> None:
        self.shown = swung(true) + noise * np.random.default_rng(5).standard_normal(len(T))
        self.noise, self.n = noise, 0

    def __call__(self, x: np.ndarray) -> np.ndarray:
        self.n += 1
        return np.asarray((swung(x) - self.shown) / self.noise)

    def whole(self, x: np.ndarray) -> np.ndarray:
        return np.concatenate([self(x), x])


@pytest.mark.parametrize("true", [(0.5, -0.5, 0.3, 0.2, 1.0), (1.0, 1.0, -0.5, -1.0, -2.0)])
def test_it_ends_where_scipy_does_with_fewer_evaluations(true: tuple[float, ...]) -> None:
    mine, other = Counted(np.array(true), 0.05), Counted(np.array(true), 0.05)
    known = least_squares(other.whole, np.zeros(5), xtol=1e-10, ftol=1e-10)
    x, slopes = secant_fit(mine, 5)
    assert np.sum(mine.whole(x) ** 2) < 1.01 * 2 * known.cost
    sd = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes + np.eye(5))))
    assert (np.abs(x - known.x) < sd).all()
    assert mine.n < other.n


def test_slopes_of_a_problem_like_it_save_their_making_and_change_nothing() -> None:
    first, second = Counted(np.zeros(5), 0.05), Counted(np.array((0.5, -0.5, 0.3, 0.2, 1.0)), 0.05)
    _, slopes = secant_fit(first, 5)
    alone = Counted(np.array((0.5, -0.5, 0.3, 0.2, 1.0)), 0.05)
    x, _ = secant_fit(second, 5, slopes)
    y, _ = secant_fit(alone, 5)
    assert np.sum(second.whole(x) ** 2) == pytest.approx(np.sum(alone.whole(y) ** 2), rel=0.01)


def test_what_cannot_be_evaluated_is_not_gone_to() -> None:
    def differences(x: np.ndarray) -> np.ndarray:
        return np.where(np.abs(x).max() > 1.0, np.nan, np.ones(3)) * (20.0 * (np.array([3.0, 0.5, -0.5]) - x))

    x, _ = secant_fit(differences, 3)
    assert np.abs(x).max() <= 1.0


def test_slopes_that_promise_nothing_are_made_anew_before_it_ends() -> None:
    true = np.array((0.5, -0.5, 0.3, 0.2, 1.0))
    mine, alone = Counted(true, 0.05), Counted(true, 0.05)
    x, _ = secant_fit(mine, 5, np.zeros((len(T), 5)))
    y, _ = secant_fit(alone, 5)
    assert np.sum(mine.whole(x) ** 2) == pytest.approx(np.sum(alone.whole(y) ** 2), rel=0.01)
