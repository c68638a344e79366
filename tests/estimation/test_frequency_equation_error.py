"""Least squares in the frequency domain against numpy, and its standard errors against scatter."""

import numpy as np
import pytest

from station.estimation.equation_error import MAX_PARAMETERS, PAST, fit, past_size

LINES = 48


def solve(x, z, ridge=None, independent=1.0, past=None, close=False):
    n = len(x)
    places = max(n, MAX_PARAMETERS)
    out, inverse = np.zeros((3, n + 1)), np.zeros((places, places))
    past = np.zeros(past_size(places)) if past is None else past
    ok = fit(x, z, np.zeros(n) if ridge is None else ridge, independent, past, close, out, inverse)
    return ok, out


def complex_normal(rng, *shape):
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


@pytest.mark.parametrize("n", [3, 5])
def test_equals_real_least_squares_on_stacked_parts(n):
    rng = np.random.default_rng(4)
    x, z = complex_normal(rng, n, LINES), complex_normal(rng, LINES)
    ok, out = solve(x, z)
    stacked = np.concatenate([x.real, x.imag], axis=1).T
    theta, residual, *_ = np.linalg.lstsq(stacked, np.concatenate([z.real, z.imag]), rcond=None)
    assert ok
    assert out[0, :n] == pytest.approx(theta, rel=1e-10)
    assert out[1, n] == pytest.approx(residual[0], rel=1e-10)


@pytest.mark.parametrize("n", [3, 5])
def test_segments_add_up_to_one_fit(n):
    rng = np.random.default_rng(5)
    x, z = complex_normal(rng, n, 3 * LINES), complex_normal(rng, 3 * LINES)
    past = np.zeros(PAST if n == 3 else past_size(n))
    for part in range(2):
        cut = slice(part * LINES, (part + 1) * LINES)
        solve(np.ascontiguousarray(x[:, cut]), z[cut], past=past, close=True)
    _, out = solve(np.ascontiguousarray(x[:, 2 * LINES :]), z[2 * LINES :], past=past)
    _, whole = solve(x, z)
    assert out[0] == pytest.approx(whole[0], rel=1e-10)
    assert out[1, :n] == pytest.approx(whole[1, :n], rel=0.15)


@pytest.mark.parametrize("colour", ["white", "louder at low frequency", "grid twice too fine"])
def test_two_standard_errors_cover(colour):
    """Between 90 and 99.5 % of 400 seeded records, each parameter."""
    rng = np.random.default_rng(6)
    truth = np.array([5.0, 20.0, 0.6])
    weight = np.linspace(3.0, 0.3, LINES) if colour.startswith("louder") else np.ones(LINES)
    # 12.5 s on lines 0.04 Hz apart: half as many independent lines as there are.
    seconds = 12.5 if colour.startswith("grid") else 25.0
    t = np.arange(0, seconds, 0.02)
    kernel = np.exp(-2j * np.pi * np.outer(t, 0.1 + 0.04 * np.arange(LINES)))
    regressors = (rng.normal(size=(3, len(t))) @ kernel) * np.exp(-np.linspace(0, 2, LINES))
    hits = np.zeros(3)
    for _ in range(400):
        noise = rng.normal(size=len(t)) @ kernel
        ok, out = solve(regressors, truth @ regressors + weight * noise, independent=0.04 * seconds)
        assert ok
        hits += np.abs(out[0, :3] - truth) < 2 * out[1, :3]
    assert (hits / 400 > 0.90).all()
    assert (hits / 400 < 0.995).all()


def test_collinear_regressors_are_refused_or_seen():
    rng = np.random.default_rng(7)
    x = complex_normal(rng, 3, LINES)
    x[2] = 2.0 * x[1]
    ok, _ = solve(x, complex_normal(rng, LINES))
    assert not ok
    x[2] += 1e-2 * complex_normal(rng, LINES)
    ok, out = solve(x, complex_normal(rng, LINES))
    assert ok
    assert out[2, 1] > 1000


def test_silence_has_no_solution():
    ok, _ = solve(np.zeros((3, LINES), complex), np.zeros(LINES, complex))
    assert not ok
