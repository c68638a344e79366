"""What may not be named on the word of one other instrument, and the estimate of the gust that all names rest on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blind import Case, aircraft, fly_case

from station.diagnosis.effects import BY_ID
from station.diagnosis.fit import gust_variance
from station.diagnosis.procedure import diagnosis_of
from station.diagnosis.reference import reference


def test_an_accelerometers_scale_is_not_told_from_the_lift_slope_without_a_velocity():
    case = Case(seed=971, effects={"accelerometer.scale": 0.12})
    profile = aircraft().model_copy(update={"boom": None})
    made = []
    for k, kind in enumerate(case.fit_on):
        record = fly_case(case, kind, k)
        kept = {n: x for n, x in record.signals.items() if n not in ("v_down", "v_along")}
        made.append(reference(replace(record, signals=kept), profile))
    found = {e.term.id: e for e in diagnosis_of(made, [], profile).effects}
    assert found["accelerometer.scale"].value == pytest.approx(0.12, abs=0.03)
    assert set(BY_ID["accelerometer.scale"].without_velocity) <= set(found["accelerometer.scale"].alternatives)


def minus_log_likelihood(u, y, share, counts):
    return float((counts * (np.log1p(u * share) + y * y / (1 + u * share))).sum())


@pytest.mark.parametrize("start", [0.01, 0.2, 1.0])
def test_values_that_misfit_do_not_throw_the_gust_from_side_to_side(start):
    # Twenty values that a gust reaches, larger than any gust makes all of, against many that see none.
    share = np.concatenate([np.full(20, 1e4), np.full(256, 1.0)])
    y = np.concatenate([np.full(20, np.sqrt(7500.0)), np.zeros(256)])
    counts = np.ones(276)
    least = min(minus_log_likelihood(u, y, share, counts) for u in np.linspace(0.01, 2, 4000))
    found = gust_variance(y, share, counts, start)
    assert minus_log_likelihood(found, y, share, counts) < least + 0.1


def test_the_gust_is_the_most_likely_one():
    rng = np.random.default_rng(5)
    share = np.exp(rng.uniform(-3, 5, 4000))
    y = rng.standard_normal(4000) * np.sqrt(1 + 0.25 * share)
    found = gust_variance(y, share, np.ones(4000), 0.01)
    grid = np.linspace(0.15, 0.35, 401)
    best = grid[np.argmin([minus_log_likelihood(u, y, share, np.ones(4000)) for u in grid])]
    assert found == pytest.approx(best, abs=0.001)
