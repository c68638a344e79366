"""An instrument that is nonlinear: nothing of the catalogue, and said; and the score test by which it is told."""

from __future__ import annotations

import blind
import numpy as np
import pytest

from station.diagnosis import null_fit
from station.diagnosis.judge import remaining_residual
from station.diagnosis.likelihood import Problem
from station.diagnosis.score_test import scores
from station.diagnosis.variances import INDEPENDENT


@pytest.mark.parametrize(
    ("seed", "sigma", "outside", "told"),
    [
        # What it shows is squared, not what is: at 0.05 rad, 4 per rad of it are 20 % of either.
        (3, 1.0, {"vane_quadratic": 4.0}, ("alpha_vane", "square", 2.0, 5.0)),
        pytest.param(4, 0.0, {"vane_quadratic": -3.0}, ("alpha_vane", "square", -4.0, -1.5), marks=pytest.mark.slow),
        pytest.param(5, 1.0, {"elevator_uneven": 0.15}, ("elevator", "size", -0.2, -0.1), marks=pytest.mark.slow),
        (6, 2.0, {"elevator_uneven": -0.2}, ("elevator", "size", 0.14, 0.26)),
        # Half of its play behind while it moves, and on the way to the other end between two motions.
        (9, 1.5, {"vane_stick": 0.008}, ("alpha_vane", "direction", -0.004, -0.0003)),
        (41, 0.0, {"vane_stick": 0.007}, ("alpha_vane", "direction", -0.0035, -0.0003)),
    ],
)
def test_a_nonlinear_instrument_is_told(
    seed: int, sigma: float, outside: dict[str, float], told: tuple[str, str, float, float]
) -> None:
    problem = Problem(blind.prepared(blind.Case(seed=seed, sigma=sigma, outside=outside)), blind.aircraft())
    remaining = remaining_residual(problem, null_fit.null(problem))
    found = remaining.nonlinear
    assert found is not None
    assert found.sensor == told[0]
    assert found.shape.startswith(told[1])
    assert told[2] < found.share < told[3]
    assert remaining.present
    assert any(words.startswith(f"{found.sensor}") and found.shape in words for words in remaining.words(""))
    assert not remaining.not_judged.present


def test_a_score_is_what_one_more_parameter_would_gain() -> None:
    rng = np.random.default_rng(5)
    n, effects, at = 300, 2, np.array([0.4, -1.1, 0.2])
    fitted = rng.standard_normal((effects + len(at), n))
    shares = rng.standard_normal((3, n)) + 0.5 * fitted[:3]
    shares[2] = fitted[1]  # an effect that is fitted shows it whole
    residuals = rng.standard_normal(n) + 0.3 * shares[0]
    # Least squares by QR, the priors as rows: residuals fall by fitted * step, parameters come to lie at at + step.
    weight = np.sqrt(2 * INDEPENDENT)
    prior = np.hstack([np.zeros((len(at), effects)), np.eye(len(at))])
    rows = np.vstack([weight * fitted.T, prior])
    right = np.concatenate([weight * residuals, at])
    gained, share, told = scores((residuals, fitted, shares), effects, at, np.ones(len(at)))
    alone = np.linalg.lstsq(rows, right, rcond=None)[1][0]
    for k in (0, 1):
        with_it = np.hstack([rows, np.concatenate([weight * shares[k], np.zeros(len(at))])[:, None]])
        step, left, *_ = np.linalg.lstsq(with_it, right, rcond=None)
        assert gained[k] == pytest.approx(alone - left[0], rel=1e-6)
        assert share[k] == pytest.approx(step[-1], rel=1e-6)
    assert told.tolist() == [True, True, False]
    assert gained[2] == 0.0
