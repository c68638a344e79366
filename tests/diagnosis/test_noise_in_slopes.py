"""Noise in slopes and in levels: what it does to a value, and to how unlikely a leftover is."""

from __future__ import annotations

import numpy as np
import pytest
from blind import Case, aircraft, prepared

from station.diagnosis.fit import INDEPENDENT, Problem
from station.diagnosis.judge import LEVEL_DOF, _log_p
from station.diagnosis.procedure import SD_FACTOR, significant

NAME = "aero.downwash_lag"
"""Its slope is the rate of the flow angle, much of which is noise in calm air."""


def test_noise_in_the_slopes_draws_no_value():
    # The same noise under either sign: half the difference is the value without the noise's chance.
    planted = 0.048
    found, plain, sds = [], [], []
    for sign in (-1, 1):
        case = Case(seed=661, effects={NAME: sign * planted}, fit_on=("multisine",))
        problem = Problem(prepared(case)[0], aircraft())
        fit = problem.refit((NAME,), {}, problem.null().gust)
        better = problem.noise_corrected(fit)
        plain.append(sign * fit.values[NAME])
        found.append(sign * better.values[NAME])
        sds.append(better.sds[NAME])
    assert sum(plain) / 2 < 0.85 * planted
    assert sum(found) / 2 == pytest.approx(planted, rel=0.1)
    assert all(abs(x - planted) < 2 * SD_FACTOR * sd for x, sd in zip(found, sds, strict=True))


@pytest.mark.parametrize("count", [5, 20, 100])
def test_leftovers_are_as_unlikely_as_told_with_an_estimated_level(count):
    rng = np.random.default_rng(count)
    shape = count * INDEPENDENT
    level = rng.chisquare(LEVEL_DOF, 20000) / LEVEL_DOF
    totals = rng.gamma(shape, 1 / INDEPENDENT, 20000) / level
    reported = np.exp([_log_p(float(t), count) for t in totals])
    for chance in (0.5, 0.01):
        assert np.mean(reported < chance) == pytest.approx(chance, abs=4 * np.sqrt(chance / 20000))


def test_an_effect_that_is_not_there_is_not_kept_beside_one_that_is():
    made, _ = prepared(Case(seed=3, effects={"alpha_vane.delay": 0.03}))
    problem = Problem(made, aircraft())
    both = problem.refit(("aero.downwash_lag", "alpha_vane.delay"), {}, [r.gust_guess for r in made])
    assert set(both.values) == {"aero.downwash_lag", "alpha_vane.delay"}
    kept = significant(problem, both)
    assert set(kept.values) == {"alpha_vane.delay"}
    nothing, _ = prepared(Case(seed=4))
    clean = Problem(nothing, aircraft())
    assert significant(clean, clean.refit(("q.scale",), {}, [r.gust_guess for r in nothing])).values == {}
