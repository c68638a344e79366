"""Which model structure the data want in turbulence: one angle of attack, or motion and gust apart.

    split       C = C_a (a_i + a_g) + C_q qhat + C_de de
    eq65        C = C_s a_i + C_g a_g + C_q qhat + C_de de                       (Martos 2013, equations 65a and 65b)
    split+gust  C = C_a (a_i + a_g) + C_d (a_g(t) - a_g(t - l_t/V)) + C_q qhat + C_de de
    S5          C = C_s a_i + C_g a_g + C_t a_g(t - l_t/V) + C_q qhat + C_de de

a_i is the angle of attack of the motion, a_g the gust's at the CG. Fitted to tapered spectra, whose lines are
independent, so that an F-test of nested structures means what it says; and fitted on either half of the record to
predict the other. A structure is preferred that the F-test needs (against every one within it) and that predicts
clearly better; of those the one that predicts best. Per radian; SI.

Sources: Martos 2013, chapter III; Klein and Morelli 2006, sections 5.1 (F-test) and 5.4 (prediction); Thomson 1982.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal.windows import dpss
from scipy.stats import f as f_distribution

from station.numerics.regression import NotIdentifiable

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

STRUCTURES: Final[Mapping[str, tuple[str, ...]]] = {
    "split": ("alpha", "q", "de"),
    "eq65": ("alpha_i", "alpha_g", "q", "de"),
    "split+gust": ("alpha", "d", "q", "de"),
    "S5": ("alpha_i", "alpha_g", "alpha_g_tail", "q", "de"),
}
"""Regressors of each, simple before complex. Each spans those of `split`; S5 spans all."""
WITHIN: Final[Mapping[str, tuple[str, ...]]] = {
    "split": (),
    "eq65": ("split",),
    "split+gust": ("split",),
    "S5": ("split", "eq65", "split+gust"),
}
BAND_HZ: Final = (0.1, 2.0)
TIME_BANDWIDTH: Final = 2.5
TAPERS: Final = 4
MIN_HALF_S: Final = 10.0
SIGNIFICANT: Final = 0.01
BETTER: Final = 0.95
"""Of the error on held-out data, what a larger structure may leave. The F-test takes residuals for white: on made-up
flights it finds need for a larger structure in a third of those without one, and these predict at most 2.5 % better;
a tail that meets the gust later makes it a third."""
GUST_SHARE: Final = 0.02
"""Gust energy in the band over that of the motion, below which nothing can be said."""


@dataclass(frozen=True, slots=True)
class Structure:
    """One structure fitted to one equation."""

    estimate: Mapping[str, float]
    std_error: Mapping[str, float]
    residual: float
    """Residual over measured, root of the energies, on all of the record."""
    held_out: float
    """The same where it was predicted by the other half."""
    p_values: Mapping[str, float]
    """Of the F-tests against the structures within it: small where the larger one is needed."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """Of one equation: every structure, and the one that F-test and prediction prefer."""

    structures: Mapping[str, Structure]
    preferred: str


def compare_structures(regressors: Mapping[str, Array], measured: Array, dt: float) -> Comparison:
    """Fit and compare all structures.

    `regressors` (n,) each: alpha_i, alpha_g, alpha_g_tail, q (normalised), de; `measured` (n,) the coefficient; uniform
    grid, all finite. Raises NotIdentifiable for a record too short, without gusts, or with collinear regressors.
    """
    n = len(measured)
    if n * dt < 2 * MIN_HALF_S:
        raise NotIdentifiable(f"{n * dt:.0f} s of record: comparing structures needs {2 * MIN_HALF_S:g} s")
    columns = {
        **regressors,
        "alpha": regressors["alpha_i"] + regressors["alpha_g"],
        "d": regressors["alpha_g"] - regressors["alpha_g_tail"],
    }
    whole = {name: _lines(x, dt) for name, x in columns.items()}
    z = _lines(measured, dt)
    if np.sum(np.abs(whole["alpha_g"]) ** 2) < GUST_SHARE * np.sum(np.abs(whole["alpha_i"]) ** 2):
        raise NotIdentifiable("no gust energy: motion and gust cannot be told apart")
    halves = [slice(0, n // 2), slice(n // 2, n)]
    parts = [({m: _lines(x[h], dt) for m, x in columns.items()}, _lines(measured[h], dt)) for h in halves]
    fits = {name: _solve(whole, z, names) for name, names in STRUCTURES.items()}
    found = {}
    for name, names in STRUCTURES.items():
        estimate, error, left = fits[name]
        missed = total = 0.0
        for (train, target), (test, truth) in (parts, parts[::-1]):
            values = _solve(train, target, names)[0]
            missed += float(np.sum(np.abs(truth - _stack(test, names).T @ values) ** 2))
            total += float(np.sum(np.abs(truth) ** 2))
        p_values = {}
        for other in WITHIN[name]:
            more = len(names) - len(STRUCTURES[other])
            free = 2 * len(z) - len(names)
            ratio = (fits[other][2] - left) / more / (left / free)
            p_values[other] = float(f_distribution.sf(max(ratio, 0.0), more, free))
        found[name] = Structure(
            estimate=dict(zip(names, estimate.tolist(), strict=True)),
            std_error=dict(zip(names, error.tolist(), strict=True)),
            residual=math.sqrt(left / float(np.sum(np.abs(z) ** 2))),
            held_out=math.sqrt(missed / total),
            p_values=p_values,
        )
    return Comparison(found, _preferred(found))


def _preferred(found: Mapping[str, Structure]) -> str:
    needed = [
        name
        for name, made in found.items()
        if all(p < SIGNIFICANT and made.held_out < BETTER * found[other].held_out for other, p in made.p_values.items())
    ]
    return min(needed, key=lambda name: found[name].held_out)


def _lines(x: Array, dt: float) -> Complex:
    """Independent spectral lines in the band, of the differenced series, (lines,)."""
    moved = np.diff(x)
    moved = moved - moved.mean()
    count = len(moved)
    frequencies = np.fft.rfftfreq(count, dt)
    step = round(2 * TIME_BANDWIDTH)
    bins = np.arange(step, len(frequencies), step)
    bins = bins[(frequencies[bins] >= BAND_HZ[0]) & (frequencies[bins] <= BAND_HZ[1])]
    tapered = np.asarray(dpss(count, TIME_BANDWIDTH, TAPERS)) * moved
    return np.asarray(np.fft.rfft(tapered, axis=1)[:, bins].ravel())


def _stack(columns: Mapping[str, Complex], names: Sequence[str]) -> Complex:
    return np.array([columns[name] for name in names])


def _solve(columns: Mapping[str, Complex], z: Complex, names: Sequence[str]) -> tuple[Array, Array, float]:
    """Real parameters, their standard errors, residual energy."""
    x = _stack(columns, names)
    normal = (x.conj() @ x.T).real
    scale = np.sqrt(np.diag(normal))
    if (scale == 0).any() or np.linalg.cond(normal / np.outer(scale, scale)) > 1e10:
        raise NotIdentifiable("the regressors cannot be told apart")
    inverse = np.linalg.inv(normal)
    estimate = inverse @ (x.conj() @ z).real
    left = float(np.sum(np.abs(z - x.T @ estimate) ** 2))
    error = np.sqrt(np.diag(inverse) * left / (2 * len(z) - len(names)))
    return estimate, error, left
