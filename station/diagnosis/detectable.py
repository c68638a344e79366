"""How large an effect must be to be found: for planning, from the Fisher information of the same likelihood."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.effects import judged_effects
from station.diagnosis.fit import Problem
from station.diagnosis.memo import Memo
from station.diagnosis.reference import Reference
from station.diagnosis.search import CONFOUNDED, FIRST, least_judged

Array = NDArray[np.float64]

NINE_IN_TEN: Final = 1.2816
"""Normal quantile."""


@dataclass(frozen=True, slots=True)
class Detectable:
    """One effect in one card and air; SI. `named` is the size that also separates it from its nearest alternative."""

    id: str
    found: float
    named: float
    alternative: str
    correlation: float


def detectable_sizes(problem: Problem, gust: Sequence[float]) -> list[Detectable]:
    """Sizes found (and named alone) nine times in ten with a problem's manoeuvres in gusts (m/s, by manoeuvre), of the
    effects that can be so large."""
    # A correction moves a signal's noise too, which is no information: the flights are those of the simulation.
    references = [_quiet(r, g) for r, g in zip(problem.references, gust, strict=True)]
    problem = Problem(references, problem.aircraft, problem.nuisances)
    present = set.intersection(*(set(r.record.signals) for r in references))
    gusty, held = any(r.setting.gusty for r in references), any(len(r.record.held) for r in references)
    terms = judged_effects(problem.aircraft, present, gusty, held)
    base = problem.at({})
    nuisances = problem.nuisance_columns({}, base)
    columns = [problem.effect_columns(t, {}, base) for t in terms]
    e, a = len(terms), len(nuisances[0])
    whole = np.zeros((e + a, e + a))
    for k in range(len(references)):
        stacked = np.concatenate([np.stack([c[k] for c in columns]), nuisances[k]])
        whole += (stacked * (problem.counts[k] / (1 + gust[k] ** 2 * problem.shares[k]))) @ stacked.T
    inner = whole[e:, e:] + np.eye(a)
    information = whole[:e, :e] - whole[:e, e:] @ np.linalg.solve(inner, whole[e:, :e])
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    alike = information / scale[:, None] / scale
    limits = least_judged(problem, terms)
    least = np.array([limits.get(t.id, 0.0) for t in terms])
    asked = np.sqrt([FIRST + t.price for t in terms])
    found = np.maximum((asked + NINE_IN_TEN) / scale, least + NINE_IN_TEN / scale)
    apart = math.sqrt(CONFOUNDED) + NINE_IN_TEN
    out = []
    for i, term in enumerate(terms):
        if found[i] > term.high - term.low:
            continue
        others = np.abs(alike[i]).copy()
        others[i] = -1.0
        j = int(np.argmax(others))
        separate = apart / scale[i] / math.sqrt(max(1 - alike[i, j] ** 2, 1e-9))
        named = max(float(found[i]), float(separate))
        out.append(Detectable(term.id, float(found[i]), named, terms[j].id, float(alike[i, j])))
    return out


def _quiet(r: Reference, gust: float) -> Reference:
    """A manoeuvre as it would be without noise, in one of its simulated gust fields of that strength (m/s)."""
    share = gust / r.flights.sigma
    signals = {n: x + share * (r.flights.turbulent[n][0] - x) for n, x in r.flights.nominal.items()}
    return replace(r, record=replace(r.record, signals=signals), memo=Memo())
