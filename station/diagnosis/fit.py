"""Candidates fitted to all manoeuvres together: effects, nuisances and the gust's strength, by likelihood."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.effects import BY_ID, Term, extended
from station.diagnosis.nuisances import Nuisance, moved_by, nuisance_priors
from station.diagnosis.reference import Reference
from station.diagnosis.residuals import Spectra
from station.profile import Aircraft

Array = NDArray[np.float64]

INDEPENDENT: Final = 0.87
"""Independent values per frequency: the taper makes neighbours alike. (sum w2)2 / (n sum w4) of a 25 % Tukey window."""
STEPS: Final = 6
_DONE: Final = 0.02
"""A Gauss-Newton step is the last when it moves the cost by less."""
_HALVINGS: Final = 4


@dataclass(frozen=True, slots=True)
class Fit:
    """A candidate at its best. `cost` is -2 log likelihood with penalties; lower is better."""

    values: Mapping[str, float]
    sds: Mapping[str, float]
    moved: Array
    """The nuisances, then the drift of each manoeuvre, each in its prior standard deviation, (a,)."""
    gust: tuple[float, ...]
    """Standard deviation of the vertical gust, m/s, by manoeuvre."""
    cost: float

    @property
    def ids(self) -> tuple[str, ...]:
        return tuple(self.values)


def whitened(reference: Reference, z: Spectra) -> Array:
    """(..., N) real, each of variance 1 in calm air: real and imaginary parts by frequency, then the steady parts."""
    bins = np.einsum("mij,...jm->...mi", reference.bins.rotate, z.bins) * math.sqrt(2)
    flat = bins.reshape(*bins.shape[:-2], -1)
    steady = np.einsum("ij,...j->...i", reference.steady.rotate[0].real, z.steady)
    return np.concatenate([flat.real, flat.imag, steady], axis=-1)


def turbulent_share(reference: Reference) -> Array:
    """(N,) variance per (m/s)2 of gust of each whitened value."""
    flat = reference.bins.turbulent.ravel()
    return np.concatenate([flat, flat, reference.steady.turbulent[0]])


def independent_values(reference: Reference) -> Array:
    """(N,) how many independent values each whitened value counts for."""
    flat = np.full(reference.bins.turbulent.size, INDEPENDENT)
    return np.concatenate([flat, flat, np.ones(len(reference.steady.turbulent[0]))])


def gust_variance(y: Array, share: Array, counts: Array, start: float) -> float:
    """The most likely variance of the gust, (m/s)2, by Fisher scoring downhill from a start."""
    power = y * y

    def cost(u: float) -> float:
        scale = 1 + u * share
        return float((counts * (np.log(scale) + power / scale)).sum())

    u, here = start, cost(start)
    for _ in range(12):
        scale = 1 + u * share
        slope = float((counts * (share / scale - power * share / scale**2)).sum())
        curve = float((counts * (share / scale) ** 2).sum())
        step = max(u - slope / curve, 0.0) - u
        there = cost(u + step)
        for _ in range(_HALVINGS):
            if there <= here:
                break
            step *= 0.5
            there = cost(u + step)
        if there > here:
            return u
        u, here = u + step, there
        if abs(step) < 1e-3 * u + 1e-9:
            break
    return u


def price(ids: Iterable[str]) -> float:
    """Of naming effects, besides what their values are worth."""
    return sum(BY_ID[i].price for i in ids)


class Problem:
    """All manoeuvres of a diagnosis and one base aircraft; candidates are effects on top of it."""

    def __init__(
        self,
        references: Sequence[Reference],
        aircraft: Aircraft,
        nuisances: Sequence[Nuisance] | None = None,
        about: Array | None = None,
    ) -> None:
        """`nuisances` in place of those with the profile's priors; the residuals are linear in them about `about` (a,),
        in their standard deviations, in place of about the profile."""
        self.references = tuple(references)
        self.aircraft = aircraft
        self.nuisances: tuple[Nuisance, ...] = nuisance_priors(aircraft) if nuisances is None else tuple(nuisances)
        self._about = np.zeros(len(self.nuisances)) if about is None else about
        self.shares = [turbulent_share(r) for r in self.references]
        self.counts = [independent_values(r) for r in self.references]
        self._columns: dict[str, list[Array]] = {}
        self._drifts: list[Array] = []
        self._centre = moved_by(aircraft, self.nuisances, self._about)
        self._shift = [np.zeros(len(s)) for s in self.shares]
        self._base = self.at({})
        if self._about.any():
            columns = self._nuisance_columns_at({}, self._base, False)
            self._shift = [self._about @ c[: len(self._about)] for c in columns]
            self._base = self.at({})

    def at(self, values: Mapping[str, float]) -> list[Array]:
        """Whitened differences for effects, by manoeuvre, with the nuisances, by their linear model, at zero."""
        return self._differences(extended(self._centre, values))

    def _differences(self, candidate: Aircraft) -> list[Array]:
        return [whitened(r, r.differences(candidate)) - s for r, s in zip(self.references, self._shift, strict=True)]

    def effect_columns(self, term: Term, values: Mapping[str, float], here: list[Array] | None = None) -> list[Array]:
        """Change of the differences per unit of an effect's value, at a candidate, by manoeuvre."""
        if not values and term.id in self._columns:
            return self._columns[term.id]
        here = here if here is not None else (self.at(values) if values else self._base)
        moved = {**values, term.id: values.get(term.id, 0.0) + term.step}
        columns = [(a - b) / term.step for a, b in zip(self.at(moved), here, strict=True)]
        if not values:
            self._columns[term.id] = columns
        return columns

    def nuisance_columns(self, values: Mapping[str, float], here: list[Array]) -> list[Array]:
        """Change per standard deviation of each nuisance, (a, N) by manoeuvre.

        Made anew where an effect changes what the derivatives multiply."""
        relinear = any(BY_ID[n].relinear for n in values)
        base = self._nuisance_columns_at({}, self._base, False)
        return self._nuisance_columns_at(values, here, True) if relinear else base

    def _nuisance_columns_at(self, values: Mapping[str, float], here: list[Array], anew: bool) -> list[Array]:
        rows = []
        for nuisance, x in zip(self.nuisances, self._about, strict=True):
            key = f"nuisance {nuisance.name}"
            if key in self._columns and not (anew and nuisance.relinear):
                rows.append(self._columns[key])
                continue
            step = nuisance.step / (1 + nuisance.sd * float(x)) if nuisance.relative else nuisance.step
            # First the nuisances, then the effects, as in `complete`: a shifted CG leaves little of Cm_alpha
            # to be a share of.
            moved = self._differences(extended(nuisance.extend(self._centre, step * nuisance.sd), values))
            row = [(a - b) / nuisance.step for a, b in zip(moved, here, strict=True)]
            if not anew:
                self._columns[key] = row
            rows.append(row)
        if not self._drifts:
            self._drifts = [
                whitened(r, r.differences(self._centre, r.drift_sd)) - s - y
                for r, s, y in zip(self.references, self._shift, self._base, strict=True)
            ]
        out = []
        for k, drift in enumerate(self._drifts):
            own = np.zeros((len(self.references), *drift.shape))
            own[k] = drift
            out.append(np.concatenate([np.stack([row[k] for row in rows]), own]))
        return out

    def drift(self, fit: Fit, k: int) -> float:
        """The drift that a fit gives to a manoeuvre, m/s."""
        return float(fit.moved[len(self.nuisances) + k]) * self.references[k].drift_sd

    # --- fitting

    def solve(
        self, y: list[Array], effects: list[Array], nuisances: list[Array], gust: Sequence[float], rounds: int = 3
    ) -> tuple[Array, Array, tuple[float, ...], float]:
        """Linear step: y + effects' d + nuisances' a with the gust re-estimated; per manoeuvre y (N,), effects (e, N),
        nuisances (a, N). Returns d with a, their covariance, the gusts' standard deviations and the cost."""
        e = effects[0].shape[0]
        p = e + nuisances[0].shape[0]
        penalty = np.concatenate([np.zeros(e), np.ones(p - e)])
        columns = [np.concatenate(pair) for pair in zip(effects, nuisances, strict=True)]
        u = [g * g for g in gust]
        x, inverse = np.zeros(p), np.eye(p)
        for _ in range(rounds):
            normal, right = np.diag(penalty), np.zeros(p)
            for k, (data, column) in enumerate(zip(y, columns, strict=True)):
                weighted = column * (self.counts[k] / (1 + u[k] * self.shares[k]))
                normal += weighted @ column.T
                right -= weighted @ data
            scale = 1 / np.sqrt(np.maximum(np.diag(normal), 1e-30))
            inverse = np.linalg.pinv(normal * scale[:, None] * scale, rcond=1e-10, hermitian=True)
            inverse = inverse * scale[:, None] * scale
            x = inverse @ right
            u = [
                gust_variance(data + x @ column, self.shares[k], self.counts[k], u[k])
                for k, (data, column) in enumerate(zip(y, columns, strict=True))
            ]
        cost = self.cost([data + x @ column for data, column in zip(y, columns, strict=True)], u, x[e:])
        return x, inverse, tuple(math.sqrt(v) for v in u), cost

    def cost(self, residuals: list[Array], u: Sequence[float], moved: Array) -> float:
        """-2 log likelihood of residuals, with the penalty of the nuisances `moved`."""
        total = float(moved @ moved)
        for k, data in enumerate(residuals):
            scale = 1 + u[k] * self.shares[k]
            total += float((self.counts[k] * (np.log(scale) + data * data / scale)).sum())
        return total

    def null(self) -> Fit:
        """Without effects: the nuisances and the gust fitted."""
        return self.fixed({}, [r.gust_guess for r in self.references])

    def fixed(self, values: Mapping[str, float], gust: Sequence[float]) -> Fit:
        """Effects as given; the nuisances and the gust fitted."""
        here = self.at(values) if values else self._base
        none = [np.zeros((0, len(y))) for y in here]
        x, _, found, cost = self.solve(here, none, self.nuisance_columns(values, here), gust, 5)
        return Fit(dict(values), {}, x, found, cost + price(values))

    def complete(self, fit: Fit) -> Aircraft:
        """The base aircraft with a fit's effects and nuisances."""
        return extended(moved_by(self.aircraft, self.nuisances, fit.moved), fit.values)

    def whole_cost(self, values: Mapping[str, float], moved: Array, gust: Sequence[float]) -> float:
        """-2 log likelihood without linearisation of the nuisances; the determinants of the noise covariances count,
        too."""
        aircraft = extended(moved_by(self.aircraft, self.nuisances, moved), values)
        own = zip(self.references, moved[len(self.nuisances) :], strict=True)
        residuals = [whitened(r, r.differences(aircraft, float(x) * r.drift_sd)) for r, x in own]
        volume = 0.0
        for r in self.references:
            volume -= 2 * INDEPENDENT * float(np.linalg.slogdet(r.bins.rotate)[1].sum())
            volume -= 2 * float(np.linalg.slogdet(r.steady.rotate)[1].sum())
        return self.cost(residuals, [g * g for g in gust], moved) + volume

    def noise_corrected(self, fit: Fit) -> Fit:
        """A fit corrected for the noise in its regressors, and its standard deviations then.

        The regressors (slopes) are made from measured signals: their noise adds to the information matrix, and where it
        is correlated with the noise of the residuals it biases the value, mostly towards zero (errors in variables).
        Further noise of the same kind, added to the measured signals, measures both.
        """
        own = [BY_ID[i] for i in fit.values]
        here = self.at(fit.values)
        slopes = self.slopes(own, fit.values, here)
        noisy = Problem([r.with_more_noise() for r in self.references], self.aircraft, self.nuisances, self._about)
        there = noisy.at(fit.values)
        e, size = len(own), len(slopes[0])
        x = np.concatenate([np.zeros(e), fit.moved])
        normal = np.diag(np.concatenate([np.zeros(e), np.ones(size - e)]))
        noise, drawn = np.zeros((size, size)), np.zeros(size)
        for k, more in enumerate(noisy.slopes(own, fit.values, there)):
            weight = self.counts[k] / (1 + fit.gust[k] ** 2 * self.shares[k])
            slope_noise = more - slopes[k][:, None, :]
            residual_noise = there[k] - here[k] + np.einsum("p,pdn->dn", x, slope_noise)
            normal += (slopes[k] * weight) @ slopes[k].T
            noise += np.einsum("pdn,n,qdn->pq", slope_noise, weight, slope_noise) / len(residual_noise)
            drawn += np.einsum("pdn,n,dn->p", slope_noise, weight, residual_noise) / len(residual_noise)
        inverse = np.linalg.pinv(normal - noise, rcond=1e-10, hermitian=True)
        step, covariance = inverse @ drawn, inverse @ normal @ inverse
        values = {t.id: min(max(fit.values[t.id] + float(step[j]), t.low), t.high) for j, t in enumerate(own)}
        sds = {t.id: math.sqrt(max(covariance[j, j], 0.0)) for j, t in enumerate(own)}
        return Fit(values, sds, fit.moved + step[e:], fit.gust, fit.cost)

    def slopes(self, own: Sequence[Term], values: Mapping[str, float], here: list[Array]) -> list[Array]:
        """Columns of effects, then of nuisances, at a candidate; (p, ..., N) by manoeuvre."""
        columns = [self.effect_columns(t, values, here) for t in own]
        nuisances = self.nuisance_columns(values, here)
        return [
            np.concatenate([np.array([c[k] for c in columns]).reshape(len(own), *a.shape[1:]), a])
            for k, a in enumerate(nuisances)
        ]

    def refit(self, ids: Sequence[str], start: Mapping[str, float], gust: Sequence[float]) -> Fit:
        """Gauss-Newton for these effects together from a start, each within its physical range."""
        terms = [BY_ID[i] for i in ids]
        values = {t.id: min(max(float(start.get(t.id, 0.0)), t.low), t.high) for t in terms}
        here = self.at(values)
        nuisances = self.nuisance_columns(values, here)
        best: Fit | None = None
        asked = price(values)
        for _ in range(STEPS):
            effects = [self.effect_columns(t, values, here) for t in terms]
            stacked = [np.stack([c[k] for c in effects]) for k in range(len(self.references))]
            x, inverse, gust, _ = self.solve(here, stacked, nuisances, gust)
            none = [np.zeros((0, len(y))) for y in here]
            if best is None:
                moved, _, g, cost = self.solve(here, none, nuisances, gust)
                best = Fit(dict(values), {}, moved, g, cost + asked)
            sds = {t.id: math.sqrt(max(inverse[j, j], 0.0)) for j, t in enumerate(terms)}
            best = Fit(best.values, sds, best.moved, best.gust, best.cost)
            step = 1.0
            gained = 0.0
            for _ in range(_HALVINGS):
                trial = {t.id: min(max(values[t.id] + step * float(x[j]), t.low), t.high) for j, t in enumerate(terms)}
                there = self.at(trial)
                moved_columns = self.nuisance_columns(trial, there)
                moved, _, g, cost = self.solve(there, none, moved_columns, gust, 2)
                if cost + asked < best.cost:
                    gained = best.cost - cost - asked
                    best = Fit(trial, sds, moved, g, cost + asked)
                    values, here, nuisances, gust = trial, there, moved_columns, g
                    break
                step *= 0.5
            if gained < _DONE:
                break
        assert best is not None
        return best
