"""A search with the aircraft's model in error: what instruments say of each other, and which effects still stand.

Two safeguards keep errors of the model, whose parameters are free, from being named as instruments: its misfit counts
as noise, and an instrument is a candidate only if the instruments among themselves, without any aerodynamics, say so
too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from station.diagnosis.diagnosis_result import Effect
from station.diagnosis.effects import BY_ID, Term
from station.diagnosis.fit import Fit, Problem
from station.diagnosis.memo import Memo
from station.diagnosis.model_error import (
    ABSENT,
    NONLINEAR,
    Complex,
    Freed,
    freed,
    incomplete,
    model_error_priors,
    parts,
    structures,
)
from station.diagnosis.nonlinearity import nonlinear_priors
from station.diagnosis.nuisances import DERIVATIVES, TRIM, moved_by
from station.diagnosis.reference import CALM_BELOW, TURBULENT, Reference, Whitener, spread, with_noise_through
from station.diagnosis.residuals import DOWN, DRAG, NORTH, SERIES, THETA, VANE, Spectra
from station.diagnosis.search import CONFOUNDED, Found, search
from station.profile import Aircraft

KINEMATIC: Final = (THETA, DOWN, NORTH, VANE)
"""Series in which instruments are compared with each other."""
KINEMATIC_CHI2: Final = 9.0
"""chi2 of an effect in the kinematic series, below which an instrument is no candidate."""
DISAGREEMENT: Final = 3.0
"""Standard deviations by which the kinematic value of an effect may differ from the one of the whole fit."""
COMPENSATION: Final = 0.4
"""Share of an effect's value, at most, that may compensate the model's error."""
NEXT: Final = 0.3
"""Share of the best chi2 that another effect must have to be a candidate beside it."""
UNCONFIRMED: Final = 50.0
"""(value / standard deviation)2 asked of an effect at the vane in turbulence that the kinematic series neither confirm
nor contradict: the gust hides it in them."""
ASKED: Final = 25.0
"""Deviance reduction asked of a first effect: a model's misfit taken as noise is not noise."""
MOST_ROUNDS: Final = 3
WELL_KNOWN: Final = 0.15
"""Standard deviation of a freed derivative, as a share of it, up to which it is known well."""
ALIKE: Final = 0.2
"""Least correlation of the measured motion with the simulated one, as a share of the latter."""
MOST_MISSED: Final = 0.25
"""Share of what was measured of lift or moment that a model may miss and still be a model."""


def kinematic_reference(reference: Reference) -> Reference:
    """The same manoeuvre with its series without aerodynamics only."""
    rows = np.array([i for i, j in enumerate(reference.setting.judged) if j in KINEMATIC])
    judged = tuple(reference.setting.judged[i] for i in rows)
    calm, turbulent = spread(reference.bins)
    calm_steady, gusty = spread(reference.steady)

    def pick(m: Complex) -> Complex:
        return m[:, rows[:, None], rows]

    return replace(
        reference,
        setting=replace(reference.setting, judged=judged),
        mean=Spectra(reference.mean.bins[rows], reference.mean.steady[rows]),
        bins=Whitener.of(pick(calm), pick(turbulent)),
        steady=Whitener.of(pick(calm_steady), pick(gusty)),
    )


def kinematic_problem(references: Sequence[Reference], aircraft: Aircraft) -> Problem:
    """What the instruments say of each other, without aerodynamics."""
    aerodynamic = {*DERIVATIVES, *ABSENT, *NONLINEAR, *(t.name for t in TRIM)}
    own = tuple(a for a in model_error_priors(aircraft, ())[0] if a.name not in aerodynamic)
    return Problem([kinematic_reference(r) for r in references], aircraft, own)


def kinematic_estimates(
    references: Sequence[Reference],
    problem: Problem,
    gust: Sequence[float],
    terms: Sequence[Term],
    values: Mapping[str, float],
) -> dict[str, tuple[float, float]]:
    """Value and standard deviation of each instrument's effect in the kinematic series (`problem`), given those
    accepted so far (`values`).

    How an effect shows is taken from the noiseless simulation: the measured motion answers the gust that the vane
    shows, and an effect that goes with the motion would be seen in every gust. How large it shows is taken from the
    measured motion, which is not the model's: the simulation is the instrument of the regression."""
    quiet = [replace(r, record=replace(r.record, signals=r.nominal), memo=Memo()) for r in references]
    motion = kinematic_problem(quiet, problem.aircraft)
    y = problem.at(values)
    at_nothing = motion.at({})
    there = [motion.effect_columns(BY_ID[n], {}, at_nothing) for n in values]
    nuisances = [
        np.concatenate([a, np.array([c[k] for c in there]).reshape(len(there), a.shape[1])])
        for k, a in enumerate(motion.nuisance_columns({}, at_nothing))
    ]
    weights = [c / (1 + g**2 * s) for c, s, g in zip(problem.counts, problem.shares, gust, strict=True)]
    inner = np.diag([*np.ones(len(nuisances[0]) - len(there)), *np.full(len(there), 1e-9)])
    right = np.zeros(len(inner))
    for a, w, data in zip(nuisances, weights, y, strict=True):
        inner += (a * w) @ a.T
        right += (a * w) @ data
    out = {}
    for term in terms:
        if not term.kinematic_check or term.id in values:
            continue
        column, shown = motion.effect_columns(term, {}, at_nothing), problem.effect_columns(term, values, y)
        cross, across = np.zeros(len(inner)), np.zeros(len(inner))
        own = both = slope = 0.0
        for a, w, c, x, data in zip(nuisances, weights, column, shown, y, strict=True):
            cross += (a * w) @ c
            across += (a * w) @ x
            own += float((c * w) @ c)
            both += float((c * w) @ x)
            slope += float((c * w) @ data)
        taken = np.linalg.solve(inner, cross)
        free, seen = own - float(taken @ cross), both - float(taken @ across)
        known = free > 1e-6 * own and seen > ALIKE * free
        out[term.id] = (-(slope - float(taken @ right)) / seen, math.sqrt(free) / seen) if known else (0.0, math.inf)
    return out


@dataclass(frozen=True, slots=True)
class WithModelError:
    """Outcome of a search with the model in error."""

    problem: Problem
    found: Found
    parts: tuple[Effect, ...]
    """What of the model is wrong or lacking."""
    shares: Mapping[str, float]
    """What the model misses of lift, moment and drag, as a share of what was measured (root mean square)."""
    kinematic_chi2: Mapping[str, float]
    """What the instruments among themselves say for each of their effects: chi2."""

    @property
    def misses_much(self) -> bool:
        return max((v for n, v in self.shares.items() if n != SERIES[DRAG]), default=0.0) > MOST_MISSED


def with_model_error(
    references: Sequence[Reference], aircraft: Aircraft, terms: Sequence[Term], progress: Callable[[str], None]
) -> WithModelError:
    """Search with the model in error."""
    progress("what instruments say of each other")
    without = kinematic_problem(references, aircraft)
    gust = without.null().gust
    if all(g < CALM_BELOW * r.flights.sigma / TURBULENT for g, r in zip(gust, references, strict=True)):
        terms = [t for t in terms if not t.gust_only]  # a vane without a profile looked like turbulence
    kinematic = kinematic_estimates(references, without, gust, terms, {})
    kinematic_chi2 = {n: (v / sd) ** 2 for n, (v, sd) in kinematic.items()}
    progress("freeing the model")
    tried = [_freed_structure(references, a, terms, gust) for a in structures(aircraft)]
    references, named, model = min(tried, key=lambda t: t[2].cost)
    problem, aircraft, nuisances = model.problem, model.problem.aircraft, model.problem.nuisances
    terms = [t for t in terms if t.applies(aircraft)]
    wrong = parts(problem, problem.null(), named)
    unsure = incomplete(aircraft) or any(a.sd > WELL_KNOWN for a in nuisances if a.name in DERIVATIVES)
    unsure = unsure or any(p.term.id.removeprefix("aero.") in DERIVATIVES for p in wrong)
    gusty = any(r.setting.gusty for r in references)
    others = [t for t in terms if t.id not in named and t.id not in kinematic and not (unsure and t.like_derivatives)]
    own = [t for t in terms if _candidate(t, aircraft, kinematic, gusty)]
    found = search(problem, [*others, *own], progress, ASKED)
    for _ in range(MOST_ROUNDS):
        accepted = found.accepted
        if not accepted.values:
            break
        against = [n for n in accepted.values if n in kinematic and _contradicted(accepted, n, kinematic[n])]
        against = against or _redundant(references, without, gust, found)
        instruments = {n: v for n, v in accepted.values.items() if n in kinematic and n not in against}
        beside = kinematic_estimates(references, without, gust, terms, instruments)
        more = [t for t in terms if t not in own and _candidate(t, aircraft, beside, False)]
        kinematic = {**kinematic, **{t.id: beside[t.id] for t in more}}
        own = [t for t in [*own, *more] if t.id not in against]
        if not against:
            # What the model misses was found with these effects taken for a part of it.
            model = freed(references, aircraft, nuisances, gust, accepted.values, model.moved)
            problem = model.problem
        found = search(problem, [*others, *own], progress, ASKED)
        if set(found.accepted.values) == set(accepted.values):
            break
    found = replace(
        found, alternatives=(*found.alternatives, *_kinematic_alternatives(problem, found, terms, kinematic))
    )
    wrong = parts(problem, found.accepted, named)
    found = replace(found, accepted=_with_kinematic_values(references, without, gust, problem, found.accepted))
    return WithModelError(problem, found, wrong, model.shares, kinematic_chi2)


def _kinematic_estimate(
    references: Sequence[Reference], problem: Problem, gust: Sequence[float], values: Mapping[str, float], name: str
) -> tuple[float, float]:
    """Value and standard deviation of an effect in the kinematic series, with the other `values` re-estimated."""
    others = {n: v for n, v in values.items() if n != name and BY_ID[n].kinematic_check}
    return kinematic_estimates(references, problem, gust, [BY_ID[name]], others).get(name, (0.0, math.inf))


def _redundant(references: Sequence[Reference], problem: Problem, gust: Sequence[float], found: Found) -> list[str]:
    """Of several effects at the vane the one that is not significant in the kinematic series given the others, and
    explains least alone: a model's misfit looks like a little of each."""
    values = found.accepted.values
    vane = [n for n in values if BY_ID[n].of_vane]
    if len(vane) <= 1:
        return []
    kinematic = {n: _kinematic_estimate(references, problem, gust, values, n) for n in vane}
    costs = {f.ids[0]: f.cost for f in found.singles}
    redundant = [n for n in vane if (kinematic[n][0] / kinematic[n][1]) ** 2 < KINEMATIC_CHI2]
    return [max(redundant, key=lambda n: costs.get(n, math.inf))] if redundant else []


def _with_kinematic_values(
    references: Sequence[Reference], without: Problem, gust: Sequence[float], problem: Problem, accepted: Fit
) -> Fit:
    """The effects with their kinematic values, where those are significant; elsewhere with an sd that includes how far
    a value may compensate the model's error."""
    values, sds = dict(accepted.values), dict(accepted.sds)
    for name in accepted.values:
        if not BY_ID[name].kinematic_check:
            continue
        value, sd = _kinematic_estimate(references, without, gust, accepted.values, name)
        if (value / sd) ** 2 >= KINEMATIC_CHI2:
            values[name], sds[name] = value, sd
        else:
            share = COMPENSATION if BY_ID[name].like_lift_slope else 0.5 * COMPENSATION
            sds[name] = math.hypot(sds[name], share * abs(values[name]))
    if not values:
        return accepted
    fit = problem.fixed(values, accepted.gust)
    return Fit(values, sds, fit.moved, fit.gust, accepted.cost)


def _freed_structure(
    references: Sequence[Reference], aircraft: Aircraft, terms: Sequence[Term], gust: Sequence[float]
) -> tuple[list[Reference], dict[str, Term], Freed]:
    """Manoeuvres with one structure of the model free, their noise as it passes through that, and the terms by
    nuisance."""
    nuisances, named = model_error_priors(aircraft, [t for t in terms if t.applies(aircraft)])
    angles = [r.flow_angle(aircraft) for r in references]
    nuisances += nonlinear_priors(aircraft, angles, [r.record.signals["elevator"] for r in references])
    first = freed(references, aircraft, nuisances, gust, {})
    moved = moved_by(aircraft, nuisances, first.moved)
    references = [with_noise_through(r, moved) for r in references]
    return references, named, freed(references, aircraft, nuisances, gust, {}, first.moved)


def _kinematic_alternatives(
    problem: Problem, found: Found, terms: Sequence[Term], kinematic: Mapping[str, tuple[float, float]]
) -> list[Fit]:
    """Candidates with another instrument's effect in place of an accepted one, which fit as well but are too uncertain
    in the kinematic series to be searched."""
    accepted = found.accepted
    out = []
    for name in accepted.values:
        kept = {n: v for n, v in accepted.values.items() if n != name}
        for term in terms:
            ids = frozenset({*kept, term.id})
            if term.id not in kinematic or term.id in accepted.values or ids in found.refitted:
                continue
            value, sd = kinematic[term.id]
            if not math.isfinite(sd):
                continue
            fit = problem.refit(tuple(ids), {**kept, term.id: value}, accepted.gust)
            if fit.cost < accepted.cost + CONFOUNDED and not _contradicted(fit, term.id, kinematic[term.id]):
                out.append(fit)
    return out


def _contradicted(fit: Fit, name: str, kinematic: tuple[float, float]) -> bool:
    """Whether the value of the whole fit contradicts the kinematic one, or is too uncertain where that is not
    significant."""
    value, sd = kinematic
    found, own = fit.values[name], fit.sds[name]
    if (value / sd) ** 2 < KINEMATIC_CHI2 and (found / own) ** 2 < UNCONFIRMED:
        return True
    return abs(found - value) > DISAGREEMENT * math.hypot(sd, own) + COMPENSATION * abs(value)


def _candidate(term: Term, aircraft: Aircraft, kinematic: Mapping[str, tuple[float, float]], gusty: bool) -> bool:
    """Whether an effect is significant in the kinematic series, and no other much more."""
    if term.id not in kinematic:
        return False
    if term.of_vane:
        if aircraft.boom is None:
            return False  # the profile says nothing that could be wrong
        if gusty and term.hidden_by_gusts:
            return True
    strength = {n: (v / sd) ** 2 for n, (v, sd) in kinematic.items()}
    return strength[term.id] >= max(KINEMATIC_CHI2, NEXT * max(strength.values()))
