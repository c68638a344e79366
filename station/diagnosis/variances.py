"""Variances of all that is no motion: sensors' noise, gusts, and the shares that a model misses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import G0, to_si
from station.diagnosis.air_data_noise import air_noise, noise_alone
from station.diagnosis.corrections import AIR_DATA
from station.diagnosis.manoeuvre import Manoeuvre
from station.diagnosis.recorded_noise import (
    FAST_S,
    SLOW_SHARE,
    judged_noise,
    lasting_gust,
    lasting_updraught,
    quantum,
    stated_noise,
    white_noise,
)
from station.diagnosis.residuals import LIFT
from station.diagnosis.series_spectra import Spectra, spectra
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

INDEPENDENT: Final = 0.87
"""Independent values per frequency: the taper makes neighbours alike. (sum w2)2 / (n sum w4) of a 25 % Tukey window."""
THRUST_SHARE: Final = 0.05
"""Where thrust is not recorded: by how much of its trim it changes unseen. A propeller's changes with the speed by
about as much, and so do small corrections by hand."""
SEEN_SD: Final = 0.25
"""Prior standard deviation of the logarithm of the variance of white noise that the samples show."""
LEVEL_SD: Final = 1.5
"""The same where only a rig states it, or a recorder rounds, and of the slow part: half or twice the noise is nothing
unusual."""
LEAST_SLOW: Final = 0.05
"""Of their white variance, slow at least: a fifth of SLOW_SHARE."""
LEAST_GUST: Final = 3e-5
"""rad: below any vane's noise."""
LOOSE_LEVEL: Final = 0.05
"""Stiffness of the logarithms of what nothing states: gusts along the span, from none to those of a storm."""
LOOSE: Final = 1e-3
"""Stiffness of the logarithms of the gust and of what is missed: none, but for finite numbers."""
SCORINGS: Final = 8
DAMPED: Final = (0.0, 0.1, 1.0, 10.0, 100.0)
"""Shares of the information's diagonal added to it, the first by which the likelihood rises."""
LONGEST: Final = 2.0
"""Of a logarithm, in one scoring."""
LOWEST: Final = 6.0
"""Of the logarithm of a variance, below its prior: a twentieth of the noise stated."""
DONE: Final = 0.05
"""Of -2 log likelihood: a scoring that gains less is the last."""
ZERO_SD: Final = (to_si(10 / 3600, "deg/s"), 1e-4 * G0, to_si(0.05, "deg") * G0, to_si(0.05, "deg"))
"""By what zeros wander from one manoeuvre to the next, of gyro, normal and horizontal acceleration and flow angle:
in-run bias stability of industrial MEMS sensors, and what an attitude filter leaves; a record may show more."""
ZERO_DOF: Final = 1.7
"""How much the data must show that it is more, in manoeuvres: the logarithm then has LEVEL_SD."""
ZERO_ROUNDS: Final = 20


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """Variances of the components of the noise."""

    noise: Array
    """(manoeuvres, 2 sensors): white, then slow."""
    gust: Array
    """(manoeuvres,) rad2, as the vane shows it."""
    missed: Array
    """(Axis.missed,) square of the share."""
    zeros: Array
    """(4,) of what zeros wander by from manoeuvre to manoeuvre: rad/s, m/s2, m/s2, rad."""

    def of(self, k: int) -> Array:
        """(components,) of a manoeuvre, in the order of Manoeuvre.columns."""
        return np.concatenate([self.noise[k], self.gust[k : k + 1], self.missed])


def prior_levels(manoeuvres: Sequence[Manoeuvre]) -> Levels:
    """What rigs state, or good installations have; no gust and nothing missed."""
    rows = []
    for m in manoeuvres:
        sensors, axis = m.trim.sensors, m.axis
        known = dict(axis.always) | (air_noise(m.recorded) if "pitot" in sensors else {})
        if "thrust" not in m.record.signals:
            known["thrust"] = THRUST_SHARE * max(m.setting.thrust, 1.0)
        sd, judged = (
            np.array([known.get(s) or of(s, m.recorded) for s in sensors]) for of in (white_noise, judged_noise)
        )
        white, slow = (judged * m.thinner) ** 2, SLOW_SHARE * sd**2
        if "thrust" in m.record.signals and "thrust" in sensors:
            # What an engine's deck gives is smooth, and no righter for that.
            slow[sensors.index("thrust")] = SLOW_SHARE * stated_noise("thrust", m.recorded) ** 2
        for i, name in enumerate(sensors):
            if (x := m.record.signals.get(name)) is not None:
                slow[i] = min(slow[i], max(_slow_shown(m, x, float(white[i])), LEAST_SLOW * sd[i] ** 2))
        if alone := _of_air(sensors):
            white[alone], apart = np.array(list(noise_alone(m.record, m.recorded).values())).T
            slow[alone] = np.maximum(apart, LEAST_SLOW * sd[alone] ** 2)
        rows.append(np.concatenate([white, slow]))
    least = manoeuvres[0].axis.least_missed
    return Levels(np.stack(rows), np.full(len(rows), 1e-5), np.square(least), np.square(ZERO_SD))


def prior_unseen(manoeuvres: Sequence[Manoeuvre], aircraft: Aircraft) -> Array:
    """(1 or 3, manoeuvres) prior standard deviations of air_data.Unseen."""
    drift = aircraft.uncertainty.drift
    rows = [[math.hypot(drift, lasting_gust(m.record)) for m in manoeuvres]]
    if not manoeuvres[0].axis.lateral:
        rows += [[lasting_updraught(m.record, aircraft) for m in manoeuvres], [LEVEL_SD] * len(manoeuvres)]
    return np.array(rows)


def _of_air(sensors: Sequence[str]) -> list[int]:
    """Where among them airspeed and dynamic pressure are."""
    return [sensors.index(s) for s in AIR_DATA if s in sensors]


def _slow_shown(m: Manoeuvre, x: Array, white: float) -> float:
    """Variance of slow noise, were all of a signal that its white noise leaves no motion but such: at most as much."""
    power = np.abs(spectra(x[None], m.setting, (0,), False).bins[0]) ** 2
    slow = m.shapes[1]
    return float(slow @ (power - white) / (slow @ slow))


def stiffness_of(manoeuvres: Sequence[Manoeuvre], prior: Levels) -> Array:
    """(manoeuvres, 2 sensors) inverse prior variances of the logarithms of the noise's variances."""
    made: Array = np.full(prior.noise.shape, 1 / LEVEL_SD**2)
    for k, m in enumerate(manoeuvres):
        n = len(m.trim.sensors)
        if m.recorded.dt <= FAST_S:
            # Of rounding, samples show the step, and how long it lasts; not what noise there is below it.
            rounded = {name for name, x in m.recorded.signals.items() if quantum(x)}
            made[k, [i for i, name in enumerate(m.trim.sensors) if name not in rounded]] = 1 / SEEN_SD**2
        made[k, [x for i in _of_air(m.trim.sensors) for x in (i, n + i)]] = 1 / SEEN_SD**2
        unstated = [i for i, s in enumerate(m.trim.sensors) if m.axis.always.get(s)]
        made[k, unstated] = made[k, [n + i for i in unstated]] = LOOSE_LEVEL
    return made


def _root(covariance: Complex) -> Complex:
    """Cholesky factors; not a number where variances are beyond what numbers hold."""
    try:
        return np.asarray(np.linalg.cholesky(covariance))
    except np.linalg.LinAlgError:
        return np.full_like(covariance, np.nan)


def _step(fisher: Array, gradient: Array, goes: NDArray[np.bool_], damping: float) -> Array:
    """Of the logarithms that go, by at most LONGEST, damped (Levenberg)."""
    own = fisher[np.ix_(goes, goes)]
    step = np.zeros(len(gradient))
    step[goes] = -np.linalg.solve(own + damping * np.diag(np.diag(own)), gradient[goes])
    return np.clip(step, -LONGEST, LONGEST)


def fitted(
    bins: Sequence[Complex], columns: Sequence[Complex], counts: Sequence[Array], start: Levels, prior: Levels,
    stiffness: Array, frozen: Sequence[int] = (),
) -> Levels:  # fmt: skip
    """The most likely variances at fixed parameters, by Fisher scoring of their logarithms.

    By manoeuvre: `bins` residuals (groups, k, most), `columns` of Manoeuvre (groups, k, components), `counts` of bins
    (groups,); `stiffness`: see `stiffness_of`; `frozen`: which of those missed stay as they are.
    """
    (count, many), missed = prior.noise.shape, len(prior.missed)
    x, centre = (np.log(np.concatenate([lv.noise.ravel(), lv.gust, lv.missed])) for lv in (start, prior))
    stiff = np.concatenate([stiffness.ravel(), np.full(count + missed, LOOSE)])
    low = np.concatenate(
        [
            centre[: count * many] - LOWEST,
            np.full(count, math.log(LEAST_GUST**2)),
            np.log(prior.missed),
        ]
    )
    picks = [
        np.concatenate([k * many + np.arange(many), [count * many + k], count * (many + 1) + np.arange(missed)])
        for k in range(count)
    ]

    def scored(x: Array, whole: bool) -> tuple[float, Array, Array]:
        total, gradient, fisher = float((stiff * (x - centre) ** 2).sum()), stiff * (x - centre), np.diag(stiff)
        for b, z, n, pick in zip(columns, bins, counts, picks, strict=True):
            v = np.exp(x[pick])
            root = _root((b * v) @ np.conj(b.swapaxes(-1, -2)))
            if whole:
                both = np.linalg.solve(root, np.concatenate([z, b], axis=-1))
                w, own = both[..., : z.shape[-1]], both[..., z.shape[-1] :]
                turned = np.conj(own.swapaxes(-1, -2))
                gram = turned @ own
                power = (np.abs(turned @ w) ** 2).sum((0, 2))
                gradient[pick] += INDEPENDENT * v * (n @ np.einsum("mii->mi", gram).real - power)
                fisher[np.ix_(pick, pick)] += INDEPENDENT * np.outer(v, v) * np.tensordot(n, np.abs(gram) ** 2, 1)
            else:
                w = np.linalg.solve(root, z)
            total += 2 * INDEPENDENT * float((np.abs(w) ** 2).sum())
            total += 4 * INDEPENDENT * float(n @ np.log(np.einsum("mii->mi", root).real).sum(-1))
        return total, gradient, fisher

    may = np.ones(len(x), dtype=bool)
    may[[k - missed for k in frozen]] = False
    here, gradient, fisher = scored(x, True)
    for _ in range(SCORINGS):
        # What would fall below its lowest stays there, and the others go where they would without it.
        goes = may & ((x > low) | (gradient < 0))
        for damping in DAMPED:
            trial = np.maximum(x + _step(fisher, gradient, goes, damping), low)
            there, *_ = scored(trial, False)
            if there <= here:
                break
        if not there <= here:
            break
        gained, x = here - there, trial
        if gained < DONE:
            break
        here, gradient, fisher = scored(x, True)
    v = np.exp(x)
    return Levels(v[: count * many].reshape(count, many), v[count * many : -missed], v[-missed:], start.zeros)


def wandering(manoeuvres: Sequence[Manoeuvre], spectra: Sequence[Spectra], levels: Levels) -> Array:
    """(4,) the most likely variances of what zeros wander by, by expectation and maximisation: about what manoeuvres
    have in common, which is a zero of the flight and a parameter of its own."""
    v = levels.zeros
    count = len(manoeuvres)
    known, shown = np.zeros((count, len(v))), np.zeros((count, len(v)))
    base, share = np.full((count, len(v)), np.inf), np.ones((count, len(v)))
    for k, (m, z) in enumerate(zip(manoeuvres, spectra, strict=True)):
        judged = np.array(m.setting.judged)
        at = judged < LIFT
        share[k, judged[at]] = m.of_zeros[at]
        base[k, judged[at]] = m.steady_variances(levels.of(k), 0 * v)[at]
        shown[k, judged[at]] = z.steady[at] / np.sqrt(m.of_zeros[at])
    there = np.isfinite(base)
    each, freedom = np.maximum(there.sum(0), 1), np.maximum(there.sum(0) - 1, 0)
    for _ in range(ZERO_ROUNDS if count > 1 else 0):
        known = share * v / (base + share * v)
        moved = known * (shown - shown.sum(0) / each) * there
        spread = (moved**2 + v * (1 - known) * there).sum(0) * (freedom > 0)
        v = (ZERO_DOF * np.square(ZERO_SD) + spread) / (ZERO_DOF + freedom)
    return np.asarray(v)


def log_determinants(
    manoeuvres: Sequence[Manoeuvre], responses: Sequence[Complex], levels: Levels, prior: Levels, stiffness: Array
) -> float:
    """log det Sigma of a candidate's responses, by manoeuvre, less log |det A|2 of those to the sensors at the heads of
    the series, and the priors of the variances, see `fitted`."""
    total = float((stiffness * (np.log(levels.noise) - np.log(prior.noise)) ** 2).sum())
    total += ZERO_DOF * float((prior.zeros / levels.zeros + np.log(levels.zeros)).sum())
    for k, (m, r) in enumerate(zip(manoeuvres, responses, strict=True)):
        b = m.columns(r, m.grouped.pick)
        root = np.linalg.cholesky((b * levels.of(k)) @ np.conj(b.swapaxes(-1, -2)))
        total += float(np.log(m.steady_variances(levels.of(k), levels.zeros)).sum())
        logs = np.log(np.einsum("mii->mi", root).real).sum(-1) - np.linalg.slogdet(m.of_heads(r))[1]
        total += 4 * INDEPENDENT * float(logs @ m.grouped.count)
    return total
