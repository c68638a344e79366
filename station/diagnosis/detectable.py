"""How large an effect must be to be found: for planning, from the information of the same likelihood."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.candidate import LEAST_KNOWN, SUBTRACTED, Estimate, Normal, Slopes
from station.diagnosis.effects import judged_effects
from station.diagnosis.likelihood import Problem
from station.diagnosis.refits import ASKED, CONFOUNDED
from station.diagnosis.screening import least_judged

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


def detectable_sizes(problem: Problem, about: Estimate, made: Sequence[Slopes] | None = None) -> list[Detectable]:
    """Sizes found (and named alone) nine times in ten with a problem's manoeuvres, in the noise and gusts of an
    estimate, of the effects that can be so large. `made`: the effects' slopes, where they are at hand."""
    s = about.state
    present = set.intersection(*(set(m.record.signals) for m in problem.manoeuvres))
    held = any(len(m.record.held) for m in problem.manoeuvres)
    # An effect that no small change shows has no size by the information there is without it.
    terms = [t for t in judged_effects(problem.aircraft, present, True, held, problem.axis.lateral) if not t.probes]
    own, e = len(s.values), len(terms)
    free = [Slopes(x.bins[own:], x.steady[own:], x.response[own:]) for x in about.slopes]
    effects = problem.effect_slopes(s, terms) if made is None else made
    slopes = [f.after(x) for f, x in zip(free, effects, strict=True)]
    information = _information(problem.normal(s, slopes), e)
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    alike = _correlation(information)
    limits = least_judged(problem, s, terms, effects)
    least = np.array([limits.get(t.id, 0.0) for t in terms])
    found = np.maximum(math.sqrt(ASKED), least * scale) / scale + NINE_IN_TEN / scale
    apart = math.sqrt(CONFOUNDED) + NINE_IN_TEN
    # What could not be seen at any size that there is, is no rival.
    shown = [i for i, t in enumerate(terms) if found[i] <= t.high - t.low]
    out = []
    for i in shown:
        j = max((j for j in shown if j != i), key=lambda j: abs(alike[i, j]), default=None)
        alternative, correlation = ("", 0.0) if j is None else (terms[j].id, float(alike[i, j]))
        separate = apart / scale[i] / math.sqrt(max(1 - correlation**2, 1e-9))
        named = max(float(found[i]), float(separate))
        out.append(Detectable(terms[i].id, float(found[i]), named, alternative, correlation))
    return out


def _information(normal: Normal, effects: int) -> Array:
    """(effects, effects), the free parameters fitted beside; what noise in the slopes feigns is taken out, as far as
    that leaves every free parameter as well known as Problem.solve asks."""
    own, rest = slice(effects), slice(effects, None)
    for share in SUBTRACTED:
        matrix = normal.seen - share * normal.noise
        inner = matrix[rest, rest]
        if np.linalg.eigvalsh(inner)[0] > LEAST_KNOWN - 1.0:
            break
    inner = inner + np.eye(len(inner))
    return np.asarray(matrix[own, own] - matrix[own, rest] @ np.linalg.solve(inner, matrix[rest, own]))


def _correlation(information: Array) -> Array:
    """Of effects; where noise is all that slopes show, what is left of the information may fall below none: nothing in
    place of that."""
    size = np.sqrt(np.abs(np.diag(information)))
    values, vectors = np.linalg.eigh(information / size[:, None] / size)
    there = (vectors * np.maximum(values, 0.0)) @ vectors.T
    sd = np.sqrt(np.maximum(np.diag(there), 1e-12))
    return np.asarray(there / sd[:, None] / sd)
