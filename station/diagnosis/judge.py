"""After the search: what no effect explains, what is confounded, and the gain on held-out data."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc
from scipy.stats import chi2

from station.diagnosis import null_fit
from station.diagnosis.candidate import Estimate, State
from station.diagnosis.cross_sensitivity import Crossed, crossed
from station.diagnosis.diagnosis_result import Gain
from station.diagnosis.effects import BY_ID
from station.diagnosis.free_parameters import BEYOND, moved
from station.diagnosis.homogeneity import Inhomogeneous, inhomogeneous
from station.diagnosis.likelihood import Problem
from station.diagnosis.manoeuvre import Manoeuvre
from station.diagnosis.nonlinearity import Nonlinear, nonlinear
from station.diagnosis.refits import ASKED
from station.diagnosis.search import Found
from station.diagnosis.side_by_side import each
from station.diagnosis.variances import INDEPENDENT, Levels
from station.numerics.random_effects import NORMAL_95
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

FALSE_ALARM: Final = 2e-4
"""Chance of a false alarm of the residual test, over everything that it looks at."""
FAR_OFF: Final = 2.0
"""Prior standard deviations from which a parameter is told among those that are far."""
LEVEL_DOF: Final = 200
"""Independent values that a sensor's noise level is estimated from, which is as uncertain as that."""
MUCH: Final = 1.3
"""Times the least that any model misses, from which what is missed is told."""
BANDS: Final = 6
BLOCK: Final = 8
"""Neighbouring frequencies, by which it is told how large residuals are there."""


@dataclass(frozen=True, slots=True)
class RemainingResidual:
    """What no effect explains: shares of forces and signals that the model misses, and the most unlikely band."""

    missed: tuple[tuple[str, float], ...]
    """What is missed beyond doubt, and its share, the largest first."""
    log_p: float
    series: str
    signals: tuple[str, ...]
    band_hz: tuple[float, float]
    by_series: tuple[tuple[str, float], ...]
    """log p of each series as a whole."""
    log_p_limit: float
    """Beyond which a residual remains unexplained: the more tests, the further out."""
    strained: tuple[tuple[str, float], ...] = ()
    """Free parameters, and where they are in prior standard deviations, the farthest first, where all together are
    further from the profile than its stated doubt allows: another aircraft's profile, or an effect that none of the
    catalogue is."""
    beyond: tuple[tuple[str, float], ...] = ()
    """See Found."""
    inhomogeneous: tuple[Inhomogeneous, ...] = ()
    """Effects that were fitted and have not one value: what acts like them is the matter, and they are not named."""
    crossed: Crossed | None = None
    """An instrument that shows a share of what another one measures."""
    nonlinear: Nonlinear | None = None
    """An instrument that is nonlinear, or what answers it."""

    @property
    def not_judged(self) -> RemainingResidual:
        """The same where nothing may be said."""
        where = self.series, self.signals, self.band_hz, self.by_series, self.log_p_limit
        return RemainingResidual((), 0.0, *where)

    @property
    def in_signals(self) -> bool:
        """Whether a residual is no noise, or something is missed."""
        return bool(self.missed) or self.log_p < self.log_p_limit

    @property
    def present(self) -> bool:
        others = self.strained, self.beyond, self.inhomogeneous, self.crossed, self.nonlinear
        return self.in_signals or any(others)

    def words(self, of: str) -> list[str]:
        """What is the matter beside the residuals; `of`: the motion, where that must be said."""
        out = []
        if self.strained:
            far = ", ".join(f"{name} by {x:+.1f}" for name, x in self.strained)
            out.append(f"{of}fitted far beyond the profile's stated doubt, in its standard deviations: {far}")
        out += [
            f"{i} explains more than what is found, but only at an end of what is physical ({BY_ID[i].words(end)}): "
            "something that acts like it is the matter"
            for i, end in self.beyond
        ]
        out += [f"not named: {x.words}: something that acts like it is the matter" for x in self.inhomogeneous]
        out += [f"{of}{x.words}" for x in (self.crossed, self.nonlinear) if x]
        return out


def remaining_residual(
    problem: Problem, accepted: Estimate, beyond: Sequence[tuple[str, float]] = ()
) -> RemainingResidual:
    """The tests after the accepted effects: the posterior predictive check of the whitened residuals, per series and
    band, and whether the model misses a share of anything. `beyond`: see Found."""
    s = accepted.state
    worst = (0.0, 0, (0.0, 0.0))
    totals: dict[int, tuple[float, int]] = {}
    looks = 0
    for m, white in zip(problem.manoeuvres, s.white, strict=True):
        f = m.setting.frequencies
        edges = np.linspace(0, len(f), min(BANDS, len(f)) + 1).round().astype(int)
        power = np.abs(white) ** 2
        for row, j in enumerate(m.setting.judged):
            x = power[:, row]
            looks += len(edges) - 1
            for a, b in itertools.pairwise(edges):
                worst = min(worst, (_log_p(float(x[a:b].sum()), b - a), j, (float(f[a]), float(f[b - 1]))))
            total, count = totals.get(j, (0.0, 0))
            totals[j] = (total + float(x.sum()), count + len(x))
    missed = _missed(problem, s)
    axis = problem.axis
    signals = axis.signals_of[worst[1]]
    band = worst[2]
    name = axis.series[worst[1]]
    limit = math.log(FALSE_ALARM / looks)
    if missed and worst[0] >= limit:
        name = missed[0][0]
        f = problem.manoeuvres[0].setting.frequencies
        signals = axis.signals_of[axis.series.index(name)] if name in axis.series else (name,)
        band = (float(f[0]), float(f[-1]))
    by_series = tuple((axis.series[j], _log_p(t, c)) for j, (t, c) in sorted(totals.items()))
    apart = inhomogeneous(problem, accepted, any(name in axis.forces for name, _ in missed))
    others = _strained(problem, s), tuple(beyond), apart, crossed(problem, accepted), nonlinear(problem, accepted)
    return RemainingResidual(missed, worst[0], name, signals, band, by_series, limit, *others)


def _strained(problem: Problem, s: State) -> tuple[tuple[str, float], ...]:
    """Free parameters far from the profile, where their squares sum to more than chance allows; what is itself named
    for being far is not counted."""
    there = [(f.name, float(x)) for f, x in zip(problem.frees, s.a, strict=False) if not f.of or f.of in s.values]
    named = (*problem.axis.derivatives, *problem.axis.of_zero)
    there = [(n, x) for n, x in there if abs(x) < BEYOND or n not in named]
    if chi2.logsf(sum(x * x for _, x in there), len(there)) > math.log(FALSE_ALARM):
        return ()
    return tuple(sorted(((n, x) for n, x in there if abs(x) > FAR_OFF), key=lambda x: -abs(x[1])))


def _missed(problem: Problem, s: State) -> tuple[tuple[str, float], ...]:
    """Shares above MUCH without which the data are that much less likely."""
    out = []
    here = problem.cost(s)
    for k, name in enumerate(problem.axis.missed):
        share = math.sqrt(float(s.levels.missed[k]))
        if share < MUCH * problem.axis.least_missed[k]:
            continue
        without = s.levels.missed.copy()
        without[k] = problem.axis.least_missed[k] ** 2
        there = problem.relevelled(replace(s, levels=replace(s.levels, missed=without)), frozen=[k])
        if problem.cost(there) - here > ASKED:
            out.append((name, share))
    return tuple(sorted(out, key=lambda x: -x[1]))


def _log_p(total: float, count: float) -> float:
    """log probability that `count` powers of mean 1, by an estimated level, sum to more: Fisher's distribution."""
    values = 2 * count * INDEPENDENT
    share = float(betainc(0.5 * LEVEL_DOF, 0.5 * values, LEVEL_DOF / (LEVEL_DOF + values * total / count)))
    return math.log(share) if share > 0 else -math.inf


# --- gain


def gain(before: Aircraft, after: Aircraft, held_out: Sequence[Manoeuvre]) -> Gain | None:
    """Held-out error without and with the effects; None with nothing held out. Trims and the zeros of instruments are
    of the day and are fitted to either; the noise is that of the better one."""
    if not held_out:
        return None
    states = list(each(_settled, [(craft, held_out) for craft in (before, after)]))
    _, best = min(states, key=lambda x: x[0].cost(x[1]))
    one, other = (own.state(s.values, s.a, best.levels, best.flown).white for own, s in states)
    reduction, sd = lowered(one, other)
    by_record = tuple(
        (m.record.name, _size([w_one]), _size([w_other]))
        for m, w_one, w_other in zip(held_out, one, other, strict=True)
    )
    half = NORMAL_95 * sd
    return Gain(_size(one), _size(other), reduction, reduction - half, reduction + half, by_record)


def within_doubt(problem: Problem, null: Estimate, accepted: Estimate) -> Aircraft | None:
    """The aircraft fitted without effects and within the profile's doubt: what is BEYOND it in `null`, and not with the
    effects (`accepted`), is held at its end. None where there is nothing such. A vane's own lag, seven standard
    deviations off, matches what is held out as well as the delay that it stands for."""
    count = len(problem.frees)
    far, near = null.state.a[:count], accepted.state.a[:count]
    relieved = (np.abs(far) > BEYOND) & (np.abs(near) < NORMAL_95)
    if not relieved.any():
        return None
    ends = np.where(relieved, np.copysign(NORMAL_95, far), 0.0)
    others = [f for f, is_relieved in zip(problem.frees, relieved, strict=True) if not is_relieved]
    bounded = Problem(problem.manoeuvres, moved(problem.aircraft, problem.frees, ends), others)
    state = null_fit.null(bounded).state
    return bounded.aircraft_at(state.values, state.a)


def _size(white: Sequence[Complex]) -> float:
    """Root mean square of whitened residuals, by record."""
    return math.sqrt(sum(float((np.abs(w) ** 2).sum()) for w in white) / sum(w.size for w in white))


def lowered(one: Sequence[Complex], other: Sequence[Complex]) -> tuple[float, float]:
    """The share by which the error of `other` is below that of `one`, both whitened residuals (bins, k) by record, and
    its standard deviation.

    What was flown is given, and noise is what scatters: where the model changes a residual w by d, its power changes by
    2 Re(w* d) + |d|2, of variance 2 |d|2 |w|2, with a w as large as those near it.
    """
    scatter = 0.0
    for w_one, w_other in zip(one, other, strict=True):
        changed, power = np.abs(w_one - w_other) ** 2, np.abs(w_other) ** 2
        for a in range(0, len(power), BLOCK):
            part = slice(a, a + BLOCK)
            scatter += 2 * float(changed[part].sum()) * float(power[part].mean()) / INDEPENDENT
    before, after = _size(one), _size(other)
    count = sum(w.size for w in one)
    return 1 - after / before, math.sqrt(scatter) / (2 * before * after * count)


def _settled(craft: Aircraft, manoeuvres: Sequence[Manoeuvre]) -> tuple[Problem, State]:
    """An aircraft with what is of the day fitted to the manoeuvres."""
    speed = float(np.mean([m.record.signals["airspeed"].mean() for m in manoeuvres]))
    axis = manoeuvres[0].axis
    frees = [f for f in axis.free_parameters(craft, speed, False) if f.name in axis.day]
    problem = Problem(manoeuvres, craft, frees)
    return problem, null_fit.null(problem).state


def alternatives_of(found: Found, effect: str) -> tuple[str, ...]:
    """Effects that could stand in this one's place."""
    out: dict[str, None] = {}
    accepted = set(found.accepted.state.values)
    for alternative in found.alternatives:
        others = set(alternative.state.values)
        if effect not in others:
            for name in sorted(others - accepted):
                out[name] = None
    return tuple(out)


def channel_error(m: Manoeuvre, aircraft: Aircraft, levels: Array) -> dict[str, float]:
    """Rms of each series over the standard deviation that noise, gust and what is missed give it, correlation with the
    others not regarded; `levels` as Levels.of."""
    z = m.differences(aircraft)
    b = m.columns(m.responses(aircraft))
    variance = (np.abs(b) ** 2 * levels).sum(-1)
    return {
        m.axis.series[j]: math.sqrt(float((np.abs(z.bins[row]) ** 2 / variance[:, row]).mean()))
        for row, j in enumerate(m.setting.judged)
    }


class SeriesError(NamedTuple):
    """One series of the fitted records: rms over its own noise before and after, and whether the residual is white."""

    name: str
    before: float
    after: float
    white: bool


def series_errors(
    problem: Problem, levels: Levels, remaining: RemainingResidual, before: Aircraft, after: Aircraft
) -> list[SeriesError]:
    """The errors of each series judged, over all records."""
    one, other = (
        [channel_error(m, craft, levels.of(k)) for k, m in enumerate(problem.manoeuvres)] for craft in (before, after)
    )

    def rms(errors: list[dict[str, float]], name: str) -> float:
        return math.sqrt(float(np.mean([e[name] ** 2 for e in errors if name in e])))

    return [
        SeriesError(name, rms(one, name), rms(other, name), log_p > remaining.log_p_limit)
        for name, log_p in remaining.by_series
    ]
