"""Which model structure the data support in turbulence: one angle of attack, or motion and gust apart.

    split       C = C_a (a_i + a_g) + C_q qhat + C_de de
    eq65        C = C_s a_i + C_g a_g + C_q qhat + C_de de                       (Martos 2013, equations 65a and 65b)
    split+gust  C = C_a (a_i + a_g) + C_d (a_g(t) - a_g(t - l_t/V)) + C_q qhat + C_de de
    S5          C = C_s a_i + C_g a_g + C_t a_g(t - l_t/V) + C_q qhat + C_de de

a_i is the angle of attack of the motion, a_g the gust's at the CG. Fitted to tapered spectra, whose lines are
independent, so that an F-test of nested structures is valid; and fitted to either half of the record to predict the
other. A structure is preferred if the F-test finds it significant against every structure nested in it and it predicts
clearly better than these; of several, the one that predicts best. Per radian; SI.

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

from station.estimation.flight_record import FlightRecord
from station.numerics.regression import NotIdentifiable
from station.rows import AlphaEstimate

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
"""Share of the prediction error of the nested structure that a larger one may have. The F-test assumes white residuals:
on simulated flights it finds a larger structure significant in a third of those without one, and these predict at most
2.5 % better; a tail that meets the gust later reduces the error to a third."""
SINGULAR: Final = 1e10
"""Condition number of the scaled normal matrix above which regressors are collinear."""
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
    """The same where each half is predicted by the other."""
    p_values: Mapping[str, float]
    """Of the F-tests against the structures nested in it: small where the larger one is significant."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """Of one equation: every structure, and the one that F-test and prediction select."""

    structures: Mapping[str, Structure]
    preferred: str


def structures(record: FlightRecord, t_s: Array, alphas: Sequence[AlphaEstimate]) -> Mapping[str, Comparison] | str:
    """Compare the structures of CL and of Cm, by equation; or why they cannot be compared.

    `alphas` at `t_s` (n,): the angles of attack of motion and gust that the live estimator found.
    """
    arm = record.aircraft.unsteady.tail_arm
    if arm <= 0:
        return "the aircraft profile gives no tail arm"
    if not record.has("theta", "v_down"):
        return "no attitude or vertical velocity"
    if not alphas:
        return "the live estimator did not run"
    motion, gust = (np.array([getattr(a, n) for a in alphas]) for n in ("alpha_inertial", "alpha_gust"))
    good = np.isfinite(motion) & np.isfinite(gust)
    # From the first angles on: before, the filters settle.
    first = int(np.argmax(good)) if good.any() else len(good)
    inside = record.t_s >= (t_s[first] if first < len(t_s) else np.inf)
    t = record.t_s[inside]
    if not len(t) or not good[first:].all() or not record.usable[inside].all():
        return "no inertial angle of attack throughout"
    late = arm / record.motion["airspeed"][inside]
    t_s, motion, gust = t_s[first:], motion[first:], gust[first:]
    regressors = {
        "alpha_i": np.interp(t, t_s, motion),
        "alpha_g": np.interp(t, t_s, gust),
        "alpha_g_tail": np.interp(t - late, t_s, gust),
        "q": record.coefficients.qhat[inside],
        "de": record.motion["elevator"][inside],
    }
    found: dict[str, Comparison] = {}
    for equation in ("CL", "Cm"):
        measured = record.coefficients.named(equation)[inside]
        if not np.isfinite(measured).all():
            continue
        try:
            found[equation] = compare_structures(regressors, measured, record.dt)
        except NotIdentifiable as refusal:
            return str(refusal)
    return found


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
        raise NotIdentifiable("no gust energy: motion and gust cannot be separated")
    halves = [slice(0, n // 2), slice(n // 2, n)]
    parts = [({m: _lines(x[h], dt) for m, x in columns.items()}, _lines(measured[h], dt)) for h in halves]
    fits = {name: _solve(whole, z, names) for name, names in STRUCTURES.items()}
    found = {}
    for name, names in STRUCTURES.items():
        estimate, error, rest = fits[name]
        missed = total = 0.0
        for (train, target), (test, truth) in (parts, parts[::-1]):
            values = _solve(train, target, names)[0]
            missed += float(np.sum(np.abs(truth - _stack(test, names).T @ values) ** 2))
            total += float(np.sum(np.abs(truth) ** 2))
        p_values = {}
        for other in WITHIN[name]:
            more = len(names) - len(STRUCTURES[other])
            free = 2 * len(z) - len(names)
            ratio = (fits[other][2] - rest) / more / (rest / free)
            p_values[other] = float(f_distribution.sf(max(ratio, 0.0), more, free))
        found[name] = Structure(
            estimate=dict(zip(names, estimate.tolist(), strict=True)),
            std_error=dict(zip(names, error.tolist(), strict=True)),
            residual=math.sqrt(rest / float(np.sum(np.abs(z) ** 2))),
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
    if (scale == 0).any() or np.linalg.cond(normal / np.outer(scale, scale)) > SINGULAR:
        raise NotIdentifiable("the regressors are collinear")
    inverse = np.linalg.inv(normal)
    estimate = inverse @ (x.conj() @ z).real
    rest = float(np.sum(np.abs(z - x.T @ estimate) ** 2))
    error = np.sqrt(np.diag(inverse) * rest / (2 * len(z) - len(names)))
    return estimate, error, rest
