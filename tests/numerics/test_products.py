"""Own products against numpy's and scipy's, and that the processor's kernels do not matter to them."""

import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.linalg import expm, lstsq
from scipy.signal import butter, sosfilt_zi

from station.numerics.products import applied, exponential, fitted, product, settled, weighted_squares

EPS = np.finfo(float).eps


def test_products_are_numpys():
    rng = np.random.default_rng(1)
    a, b, w = rng.standard_normal((7, 5)), rng.standard_normal((5, 4)), rng.uniform(0, 2, 5)
    np.testing.assert_allclose(product(a, b), a @ b, rtol=0, atol=50 * EPS)
    np.testing.assert_allclose(weighted_squares(a, w), (a * w) @ a.T, rtol=0, atol=50 * EPS)
    np.testing.assert_allclose(applied(a, w), a @ w, rtol=0, atol=50 * EPS)


@pytest.mark.parametrize("size", [1e-3, 0.2, 3.0, 40.0])
def test_the_exponential_is_scipys(size):
    rng = np.random.default_rng(2)
    matrix = rng.standard_normal((4, 4)) * size / 4
    known = expm(matrix)
    # Squared again as often as it was halved: each doubles the rounding.
    np.testing.assert_allclose(exponential(matrix), known, rtol=0, atol=200 * (1 + size) * EPS * np.abs(known).max())


def test_the_fit_is_scipys():
    rng = np.random.default_rng(3)
    matrix, wanted = rng.standard_normal((60, 9)), rng.standard_normal((60, 3))
    np.testing.assert_allclose(fitted(matrix, wanted), lstsq(matrix, wanted)[0], rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("kind", [("highpass", 0.1), ("bandpass", [0.1, 2.0]), ("lowpass", 3.0)])
def test_settled_sections_are_scipys(kind):
    sections = butter(4, kind[1], kind[0], fs=50.0, output="sos")
    np.testing.assert_allclose(settled(sections), sosfilt_zi(sections), rtol=1e-9, atol=1e-12)


MADE = """
import numpy as np
from station.model.physical_signals import vane_inverse
from station.numerics.products import applied, product, weighted_squares
from station.numerics.second_order import second_order
from station.numerics.spectra import design
x = np.random.default_rng(1).standard_normal((13, 13))
made = [product(x, x), weighted_squares(x, x[0]), applied(x, x[1]), vane_inverse(9.0, 0.35, 0.02)]
made += [second_order(9.0, 0.35, 0.02), design(np.linspace(0.1, 2.0, 20), 0.02).rest, x @ x]
import hashlib
print(*(hashlib.sha256(np.ascontiguousarray(m).tobytes()).hexdigest()[:12] for m in made))
"""


def test_kernels_for_other_processors_give_the_same_bits():
    """OpenBLAS is told which processor it runs on; its own product, the last, shows that it listens."""
    found = []
    for kind in ("Haswell", "Nehalem"):
        environment = {**os.environ, "OPENBLAS_CORETYPE": kind}
        done = subprocess.run([sys.executable, "-c", MADE], env=environment, capture_output=True, text=True, check=True)
        found.append(done.stdout.split())
    one, other = found
    if one[-1] == other[-1]:
        pytest.skip("this OpenBLAS has one kernel for both, or is none")
    assert one[:-1] == other[:-1]
