"""After the search: whether a residual remains that no effect explains, what is confounded, and the gain on held-out
data."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import windows
from scipy.special import betainc

from station.diagnosis.diagnosis_result import Gain
from station.diagnosis.effects import BY_ID
from station.diagnosis.fit import (
    INDEPENDENT,
    Fit,
    Problem,
    gust_variance,
    independent_values,
    turbulent_share,
    whitened,
)
from station.diagnosis.reference import Reference
from station.diagnosis.residuals import DOWN, DRAG, LIFT, MOMENT, NORTH, SERIES, TAPER, THETA, VANE, Spectra
from station.diagnosis.search import Found
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

FALSE_ALARM: Final = 2e-4
"""Chance of a false alarm of a residual test, over everything that it looks at."""
LEVEL_DOF: Final = 200
"""Independent values that a sensor's noise level is estimated from, which is as uncertain as that."""
RIDGE: Final = 0.01
ORDER: Final = (VANE, THETA, DOWN, NORTH, DRAG, LIFT, MOMENT)
"""Each series is judged given those before it."""
BANDS: Final = 6
SD_FACTOR: Final = 1.15
"""Standard deviations of the linear fit to those found in repeated flights."""
BLOCK: Final = 8
RESAMPLES: Final = 400
INTERVAL_FACTOR: Final = 1.5
SIGNALS_OF: Final = {
    THETA: ("theta", "q"), DOWN: ("v_down", "az"), NORTH: ("v_north", "ax"), VANE: ("alpha_vane",), LIFT: ("az",),
    MOMENT: ("q", "elevator"), DRAG: ("ax",),
}  # fmt: skip
"""The measured signals that a series is about."""


@dataclass(frozen=True, slots=True)
class RemainingResidual:
    """What no effect explains: the most unlikely band and the strongest coherence with the motion."""

    log_p: float
    score: float
    series: str
    signals: tuple[str, ...]
    band_hz: tuple[float, float]
    like: str
    """The signal that it is coherent with, or empty."""
    by_series: tuple[tuple[str, float], ...]
    """log p of each series as a whole."""
    log_p_limit: float
    score_limit: float
    """Beyond which a residual remains unexplained: the more tests, the further out."""

    @property
    def coherent(self) -> bool:
        return self.score > self.score_limit

    @property
    def present(self) -> bool:
        return self.log_p < self.log_p_limit or self.coherent


def remaining_residual(problem: Problem, found: Found) -> RemainingResidual:
    """The residual tests after the accepted effects."""
    fit = found.accepted
    aircraft = problem.complete(fit)
    residuals = [r.differences(aircraft, problem.drift(fit, k)) for k, r in enumerate(problem.references)]
    worst = (0.0, 0, (0.0, 0.0))
    totals: dict[int, tuple[float, float]] = {}
    looks = 0
    for reference, gust, z in zip(problem.references, fit.gust, residuals, strict=True):
        power, order = _sequential(reference, gust, z)
        f = reference.setting.frequencies
        edges = np.linspace(0, len(f), min(BANDS, len(f)) + 1).round().astype(int)
        for row, j in enumerate(order):
            x = power[row]
            looks += len(edges)
            for a, b in itertools.pairwise(edges):
                log_p = _log_p(float(x[a:b].sum()), b - a)
                worst = min(worst, (log_p, j, (float(f[a]), float(f[b - 1]))))
            k = int(np.argmax(x))
            single = math.log(len(x)) - 0.5 * LEVEL_DOF * math.log1p(2 * float(x[k]) / LEVEL_DOF)
            worst = min(worst, (single, j, (float(f[max(k - 1, 0)]), float(f[min(k + 1, len(f) - 1)]))))
            total, count = totals.get(j, (0.0, 0.0))
            totals[j] = (total + float(x.sum()), count + len(x))
    score, like, at = _coherence(problem, fit, residuals)
    log_p_limit = math.log(FALSE_ALARM / looks)
    score_limit = 2 * math.log(len(problem.references[0].setting.judged) * len(_LIKE) / FALSE_ALARM)
    band = worst[2]
    row = worst[1]
    if worst[0] >= log_p_limit and score > score_limit:
        row, f = at, problem.references[0].setting.frequencies
        band = (float(f[0]), float(f[-1]))
    by_series = tuple((SERIES[j], _log_p(t, c)) for j, (t, c) in sorted(totals.items()))
    return RemainingResidual(
        worst[0], score, SERIES[row], SIGNALS_OF[row], band, like, by_series, log_p_limit, score_limit
    )


def _log_p(total: float, count: float) -> float:
    """log probability that `count` powers of mean 1, by an estimated level, sum to more: Fisher's distribution."""
    values = 2 * count * INDEPENDENT
    share = float(betainc(0.5 * LEVEL_DOF, 0.5 * values, LEVEL_DOF / (LEVEL_DOF + values * total / count)))
    return math.log(share) if share > 0 else -math.inf


def _sequential(reference: Reference, gust: float, z: Spectra) -> tuple[Array, list[int]]:
    """Powers (k, m), of mean 1, of each series given those before it in ORDER; and that order."""
    inverse = np.linalg.inv(reference.bins.rotate)
    scale = 1 + gust**2 * reference.bins.turbulent
    covariance = np.einsum("mij,mj,mkj->mik", inverse, scale, np.conj(inverse))
    judged = reference.setting.judged
    order = [j for j in ORDER if j in judged]
    pick = np.array([judged.index(j) for j in order])
    root = np.linalg.cholesky(covariance[:, pick[:, None], pick])
    x = np.linalg.solve(root, z.bins[pick].T[..., None])[..., 0]
    return np.asarray((np.abs(x) ** 2).T), order


_LIKE: Final = ("q", "az", "ax", "alpha", "airspeed", "elevator", "alpha2", "alpha3")


def _coherence(problem: Problem, fit: Fit, residuals: Sequence[Spectra]) -> tuple[float, str, int]:
    """The largest score (chi2 of two) of a signal of the motion and its integral in one series, the signal, the series.

    The motion is the noiseless simulation's: a measured signal shares its noise with the residual.
    """
    y = [whitened(r, z) for r, z in zip(problem.references, residuals, strict=True)]
    here = problem.at(fit.values)
    weights = [
        independent_values(r) / (1 + g**2 * turbulent_share(r))
        for r, g in zip(problem.references, fit.gust, strict=True)
    ]
    base = problem.slopes([BY_ID[i] for i in fit.values], fit.values, here)
    size = len(base[0])
    inner = np.diag(np.concatenate([np.zeros(len(fit.values)), np.ones(size - len(fit.values))]))
    right = np.zeros(size)
    for b, w, data in zip(base, weights, y, strict=True):
        inner += (b * w) @ b.T
        right += (b * w) @ data
    best = (0.0, "", 0)
    motion = [_motion(r) for r in problem.references]
    for j in problem.references[0].setting.judged:
        for name in _LIKE:
            columns = []
            for r, m in zip(problem.references, motion, strict=True):
                bins = np.zeros((2, len(r.setting.judged), len(r.setting.bins)), dtype=complex)
                bins[:, r.setting.judged.index(j)] = m[name]
                columns.append(whitened(r, Spectra(bins, np.zeros(bins.shape[:2]))))
            cross, normal, slope = np.zeros((2, size)), np.zeros((2, 2)), np.zeros(2)
            for c, b, w, data in zip(columns, base, weights, y, strict=True):
                cross += (c * w) @ b.T
                normal += (c * w) @ c.T
                slope += (c * w) @ data
            normal += RIDGE * np.diag(np.diag(normal)) + 1e-12 * np.eye(2)
            free = normal - cross @ np.linalg.solve(inner, cross.T)
            slope = slope - cross @ np.linalg.solve(inner, right)
            score = float(slope @ np.linalg.solve(free, slope))
            best = max(best, (score, name, j))
    return best


def _motion(reference: Reference) -> dict[str, Complex]:
    """Transforms (2, m) of each signal of _LIKE in the noiseless flight, and of its integral."""
    s, x = reference.setting, reference.nominal
    alpha = x["theta"] + np.arcsin(np.clip(x.get("v_down", np.zeros(s.n)) / x["airspeed"], -1, 1))
    if s.rebuilt:
        alpha = x["alpha_vane"]
    signals = {
        "q": x["q"], "az": x["az"], "ax": x["ax"], "alpha": alpha, "airspeed": x["airspeed"],
        "elevator": x["elevator"], "alpha2": alpha**2, "alpha3": alpha**3,
    }  # fmt: skip
    out = {}
    c = s.cut
    w = 2 * np.pi * s.frequencies
    for name, values in signals.items():
        y = np.stack([values[c : s.n - c]])
        t = np.linspace(-0.5, 0.5, y.shape[-1])
        y = y - y.mean(-1, keepdims=True) - (y * t).sum(-1, keepdims=True) / (t * t).sum() * t
        window = windows.tukey(y.shape[-1], TAPER)
        spectrum = np.fft.rfft(y * window, axis=-1)[0, s.bins] / math.sqrt(float((window**2).sum()))
        out[name] = np.stack([spectrum, spectrum / (1j * w)])
    return out


def gain(before_aircraft: Aircraft, after_aircraft: Aircraft, held_out: Sequence[Reference]) -> Gain | None:
    """Held-out error without and with the effects, both aircraft as fitted; None with nothing held out."""
    if not held_out:
        return None
    blocks: list[tuple[float, float, float]] = []
    by_record = []
    for r in held_out:
        drift = _drift(r, after_aircraft)
        before = whitened(r, r.differences(before_aircraft, drift))
        y = {"before": before, "after": whitened(r, r.differences(after_aircraft, drift))}
        u = _gust(r, y["after"])
        scale = 1 + u * turbulent_share(r)
        m, k = r.bins.turbulent.shape
        powers = {n: (v * v / scale)[: 2 * m * k].reshape(2, m, k).sum((0, 2)) for n, v in y.items()}
        for a in range(0, m, BLOCK):
            part = slice(a, min(a + BLOCK, m))
            count = 2.0 * k * (part.stop - part.start)
            blocks.append((float(powers["before"][part].sum()), float(powers["after"][part].sum()), count))
        total = 2.0 * k * m
        by_record.append(
            (r.record.name, math.sqrt(powers["before"].sum() / total), math.sqrt(powers["after"].sum() / total))
        )
    table = np.array(blocks)

    def reduction(rows: Array) -> float:
        total = rows.sum(0)
        return 1 - math.sqrt(total[1] / total[0])

    rng = np.random.default_rng(2)
    draws = [reduction(table[rng.integers(0, len(table), len(table))]) for _ in range(RESAMPLES)]
    middle = reduction(table)
    low, high = np.quantile(draws, [0.025, 0.975])
    total = table.sum(0)
    return Gain(
        math.sqrt(total[0] / total[2]),
        math.sqrt(total[1] / total[2]),
        middle,
        middle - INTERVAL_FACTOR * (middle - float(low)),
        middle + INTERVAL_FACTOR * (float(high) - middle),
        tuple(by_record),
    )


def _gust(reference: Reference, y: Array) -> float:
    return gust_variance(y, turbulent_share(reference), independent_values(reference), reference.gust_guess**2)


def _drift(reference: Reference, aircraft: Aircraft) -> float:
    """The most likely drift of a manoeuvre, everything else frozen, m/s: it is of the air, not of the model."""
    y = whitened(reference, reference.differences(aircraft))
    column = whitened(reference, reference.differences(aircraft, reference.drift_sd)) - y
    weighted = column * independent_values(reference) / (1 + _gust(reference, y) * turbulent_share(reference))
    return -reference.drift_sd * float(weighted @ y) / (1 + float(weighted @ column))


def alternatives_of(found: Found, effect: str) -> tuple[str, ...]:
    """Effects that could stand in this one's place."""
    out: dict[str, None] = {}
    accepted = set(found.accepted.values)
    for alternative in found.alternatives:
        others = set(alternative.values)
        if effect not in others:
            for name in sorted(others - accepted):
                out[name] = None
    return tuple(out)


def channel_error(reference: Reference, aircraft: Aircraft) -> dict[str, float]:
    """Rms of each series over the standard deviation of its own noise, correlation with the others not regarded."""
    z = reference.differences(aircraft)
    inverse = np.linalg.inv(reference.bins.rotate)
    calm = np.einsum("mij,mkj->mik", inverse, np.conj(inverse))
    out = {}
    for row, j in enumerate(reference.setting.judged):
        out[SERIES[j]] = math.sqrt(float((np.abs(z.bins[row]) ** 2 / calm[:, row, row].real).mean()))
    return out


class SeriesError(NamedTuple):
    """One series of the fitted records: rms over its own noise before and after, and whether the residual is white."""

    name: str
    before: float
    after: float
    white: bool


def series_errors(
    problem: Problem, remaining: RemainingResidual, before: Aircraft, after: Aircraft
) -> list[SeriesError]:
    """The errors of each series judged, over all records."""

    def rms(name: str, aircraft: Aircraft) -> float:
        errors = [channel_error(r, aircraft).get(name, math.nan) for r in problem.references]
        return math.sqrt(float(np.nanmean(np.square(errors))))

    return [
        SeriesError(name, rms(name, before), rms(name, after), log_p > remaining.log_p_limit)
        for name, log_p in remaining.by_series
    ]
