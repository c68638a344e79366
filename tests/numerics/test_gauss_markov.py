"""Whitening by the filter against the covariance written out."""

import numpy as np
from numpy.testing import assert_allclose
from scipy.linalg import cholesky, solve_triangular

from station.numerics.gauss_markov import whitened


def test_whitened_rows_are_those_of_the_covariance_s_cholesky_factor() -> None:
    rng = np.random.default_rng(5)
    time = np.cumsum(rng.uniform(0.5, 30.0, 60))
    columns = rng.standard_normal((60, 4))
    white, sds, lengths = 0.3, np.array([1.5, 0.7]), np.array([8.0, 60.0])
    apart = np.abs(time[:, None] - time)[..., None]
    covariance = (sds**2 * np.exp(-apart / lengths)).sum(axis=-1) + white**2 * np.eye(60)
    made, size = whitened(time, columns, white, sds, lengths)
    root = cholesky(covariance, lower=True)
    assert_allclose(made, solve_triangular(root, columns, lower=True), rtol=0, atol=1e-12)
    assert_allclose(size, 2 * np.log(np.diag(root)).sum(), rtol=1e-13)
