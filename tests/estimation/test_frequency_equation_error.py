"""Least squares in the frequency domain against numpy, and its standard errors against scatter."""

import numpy as np
import pytest

from station.estimation.equation_error import fit, no_sums, nothing_fitted

LINES = 48
PLACES = 5


def solve(x, z, ridge=None, independent=1.0, past=None, close=False):
    fitted = nothing_fitted((), PLACES)
    past = no_sums((), PLACES) if past is None else past
    return fit(x, z, np.zeros(len(x)) if ridge is None else ridge, independent, past, close, fitted), fitted


def complex_normal(rng, *shape):
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


@pytest.mark.parametrize("n", [3, 5])
def test_equals_real_least_squares_on_stacked_parts(n):
    rng = np.random.default_rng(4)
    x, z = complex_normal(rng, n, LINES), complex_normal(rng, LINES)
    r2, found = solve(x, z)
    stacked = np.concatenate([x.real, x.imag], axis=1).T
    theta, residual, *_ = np.linalg.lstsq(stacked, np.concatenate([z.real, z.imag]), rcond=None)
    assert found.value[:n] == pytest.approx(theta, rel=1e-10)
    assert r2 == pytest.approx(1 - residual[0] / np.vdot(z, z).real, rel=1e-10)


@pytest.mark.parametrize("n", [3, 5])
def test_segments_add_up_to_one_fit(n):
    rng = np.random.default_rng(5)
    x, z = complex_normal(rng, n, 3 * LINES), complex_normal(rng, 3 * LINES)
    past = no_sums((), PLACES)
    for part in range(2):
        cut = slice(part * LINES, (part + 1) * LINES)
        solve(np.ascontiguousarray(x[:, cut]), z[cut], past=past, close=True)
    r2, found = solve(np.ascontiguousarray(x[:, 2 * LINES :]), z[2 * LINES :], past=past)
    of_whole, whole = solve(x, z)
    assert r2 == pytest.approx(of_whole, rel=1e-10)
    assert found.value == pytest.approx(whole.value, rel=1e-10)
    assert found.error == pytest.approx(whole.error, rel=0.15)


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
        _, found = solve(regressors, truth @ regressors + weight * noise, independent=0.04 * seconds)
        hits += np.abs(found.value[:3] - truth) < 2 * found.error[:3]
    assert (hits / 400 > 0.90).all()
    assert (hits / 400 < 0.995).all()


def test_collinear_regressors_are_refused_or_seen():
    rng = np.random.default_rng(7)
    x = complex_normal(rng, 3, LINES)
    x[2] = 2.0 * x[1]
    assert np.isnan(solve(x, complex_normal(rng, LINES))[0])
    x[2] += 1e-2 * complex_normal(rng, LINES)
    r2, found = solve(x, complex_normal(rng, LINES))
    assert np.isfinite(r2)
    assert found.inflation[1] > 1000


def test_silence_has_no_solution():
    assert np.isnan(solve(np.zeros((3, LINES), complex), np.zeros(LINES, complex))[0])
