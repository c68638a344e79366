"""A search with the aircraft's model in doubt: what instruments say of each other, and what then still stands.

Two safeguards keep instruments from being blamed for the model, which is free (`structure`): what it misses counts as
noise, and an instrument is a candidate only if the instruments among themselves, without any aerodynamics, say so too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from station.diagnosis.effects import BY_ID, DERIVATIVES, NEEDS_MEMORY, Term
from station.diagnosis.fit import Fit, Problem, moved_by
from station.diagnosis.model_doubt import (
    ABSENT,
    BENT,
    Complex,
    Freed,
    Part,
    doubts,
    freed,
    incomplete,
    parts,
    structures,
)
from station.diagnosis.nonlinearity import bends
from station.diagnosis.reference import CALM_BELOW, TURBULENT, Reference, Whitener, heard_through, spread
from station.diagnosis.residuals import DOWN, DRAG, NORTH, SERIES, THETA, VANE, Memo, Spectra
from station.diagnosis.search import RIVAL, Found, search
from station.profile import Aircraft

KINEMATIC: Final = (THETA, DOWN, NORTH, VANE)
"""Series in which instruments are compared with each other."""
SUPPORT: Final = 9.0
"""chi2 of an effect, of the instruments among themselves, without which an instrument is no candidate."""
APART: Final = 3.0
"""Standard deviations by which its value there may differ from the one named."""
LEANS: Final = 0.4
"""Share of its value by which an effect may lean, at most, to make up for the model."""
LIKE_SLOPE: Final = ("alpha_vane.scale", "boom.flexure")
"""What acts on a gust as a wrong lift slope does, which is free: these may lean as far as that twice as often."""
NEXT: Final = 0.3
"""Share of the best chi2 that another effect must have to be a candidate beside it."""
HIDDEN: Final = ("alpha_vane.delay", "alpha_vane.scale", "alpha_vane.position", "boom.flexure")
"""What a gust at the vane hides from the other instruments."""
UNSUPPORTED: Final = 50.0
"""(value / standard deviation)2 asked of an effect at the vane in turbulence that the other instruments neither confirm
nor deny: the gust hides it from them."""
ASKED: Final = 25.0
"""Drop of -2 log likelihood asked of a first effect: noise made of what a model misses is not noise."""
MOST_ROUNDS: Final = 3
GAINS: Final = (
    "mass.scale", "inertia.scale", "cg.shift", "aero.icing", "elevator.scale", "dynamic_pressure.scale",
)  # fmt: skip
"""Effects that act as wrong derivatives do: no candidates where those are wrong or not known well."""
SURE: Final = 0.15
"""Standard deviation of a freed derivative, as a share of it, up to which it is known well."""
ALIKE: Final = 0.2
"""Share of the model's motion that the measured one must be."""
INSTRUMENTS: Final = ("alpha_vane", "boom", "accelerometer", "q", "imu", "theta", "velocity")
"""First parts of the ids that instruments can check among themselves."""
MOST_MISSED: Final = 0.25
"""Share of what was measured of lift or moment that a model may miss and still be a model."""


def judged_alone(reference: Reference) -> Reference:
    """The same manoeuvre with its series without aerodynamics only."""
    rows = np.array([i for i, j in enumerate(reference.setting.judged) if j in KINEMATIC])
    judged = tuple(reference.setting.judged[i] for i in rows)
    calm, turbulent = spread(reference.bins)
    still, gusty = spread(reference.steady)

    def pick(m: Complex) -> Complex:
        return m[:, rows[:, None], rows]

    return replace(
        reference,
        setting=replace(reference.setting, judged=judged),
        mean=Spectra(reference.mean.bins[rows], reference.mean.steady[rows]),
        bins=Whitener.of(pick(calm), pick(turbulent)),
        steady=Whitener.of(pick(still), pick(gusty)),
    )


def alone(references: Sequence[Reference], aircraft: Aircraft) -> Problem:
    """What the instruments say of each other, without aerodynamics."""
    aerodynamic = {*DERIVATIVES, *ABSENT, *BENT, "CL_0", "Cm_0", "CD_0"}
    own = tuple(a for a in doubts(aircraft, ())[0] if a.name not in aerodynamic)
    return Problem([judged_alone(r) for r in references], aircraft, own)


def supported(
    references: Sequence[Reference],
    problem: Problem,
    gust: Sequence[float],
    terms: Sequence[Term],
    values: Mapping[str, float],
) -> dict[str, tuple[float, float]]:
    """Value and standard deviation of each instrument's effect, of the instruments among themselves (`problem`), beside
    those thought to be there (`values`).

    How an effect shows is taken from the noiseless simulation: the measured motion answers the gust that the vane
    shows, and an effect that goes with the motion would be seen in every gust. How large it shows is taken from the
    measured motion, which is not the model's: the simulation is the instrument of the regression."""
    quiet = [replace(r, record=replace(r.record, signals=r.nominal), memo=Memo()) for r in references]
    motion = alone(quiet, problem.aircraft)
    y = problem.at(values)
    still = motion.at({})
    there = [motion.effect_columns(BY_ID[n], {}, still) for n in values]
    allowed = [
        np.concatenate([a, np.array([c[k] for c in there]).reshape(len(there), a.shape[1])])
        for k, a in enumerate(motion.allowed_columns({}, still))
    ]
    weights = [c / (1 + g**2 * s) for c, s, g in zip(problem.counts, problem.shares, gust, strict=True)]
    inner = np.diag([*np.ones(len(allowed[0]) - len(there)), *np.full(len(there), 1e-9)])
    right = np.zeros(len(inner))
    for a, w, data in zip(allowed, weights, y, strict=True):
        inner += (a * w) @ a.T
        right += (a * w) @ data
    out = {}
    for term in terms:
        if term.id.split(".")[0] not in INSTRUMENTS or term.id in values:
            continue
        column, shown = motion.effect_columns(term, {}, still), problem.effect_columns(term, values, y)
        cross, across = np.zeros(len(inner)), np.zeros(len(inner))
        own = both = slope = 0.0
        for a, w, c, x, data in zip(allowed, weights, column, shown, y, strict=True):
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
class Doubted:
    """Outcome of a search with the model in doubt."""

    problem: Problem
    found: Found
    parts: tuple[Part, ...]
    """What of the model is wrong or lacking."""
    shares: Mapping[str, float]
    """What the model misses of lift, moment and drag, as a share of what was measured (root mean square)."""
    support: Mapping[str, float]
    """What the instruments among themselves say for each of their effects: chi2."""

    @property
    def misses_much(self) -> bool:
        return max((v for n, v in self.shares.items() if n != SERIES[DRAG]), default=0.0) > MOST_MISSED


def in_doubt(
    references: Sequence[Reference], aircraft: Aircraft, terms: Sequence[Term], progress: Callable[[str], None]
) -> Doubted:
    """Search with the model in doubt."""
    progress("what instruments say of each other")
    without = alone(references, aircraft)
    gust = without.null().gust
    if all(g < CALM_BELOW * r.flights.sigma / TURBULENT for g, r in zip(gust, references, strict=True)):
        terms = [t for t in terms if not t.gust_only]  # a vane that nothing is said of looked like turbulence
    said = supported(references, without, gust, terms, {})
    support = {n: (v / sd) ** 2 for n, (v, sd) in said.items()}
    progress("freeing the model")
    tried = [_free(references, a, terms, gust) for a in structures(aircraft)]
    references, named, model = min(tried, key=lambda t: t[2].cost)
    problem, aircraft, allowed = model.problem, model.problem.aircraft, model.problem.allowed
    terms = [t for t in terms if _applies(t, aircraft)]
    wrong = parts(problem, problem.null(), named)
    unsure = incomplete(aircraft) or any(a.sd > SURE for a in allowed if a.name in DERIVATIVES)
    gains = GAINS if unsure or any(p.term.id.removeprefix("aero.") in DERIVATIVES for p in wrong) else ()
    gusty = any(r.setting.gusty for r in references)
    others = [t for t in terms if t.id not in named and t.id not in gains and t.id not in said]
    own = [t for t in terms if _candidate(t, aircraft, said, gusty)]
    found = search(problem, [*others, *own], progress, ASKED)
    for _ in range(MOST_ROUNDS):
        accepted = found.accepted
        if not accepted.values:
            break
        against = [n for n in accepted.values if n in said and _contradicted(accepted, n, said[n])]
        against = against or _needless(references, without, gust, found)
        instruments = {n: v for n, v in accepted.values.items() if n in said and n not in against}
        beside = supported(references, without, gust, terms, instruments)
        more = [t for t in terms if t not in own and _candidate(t, aircraft, beside, False)]
        said = {**said, **{t.id: beside[t.id] for t in more}}
        own = [t for t in [*own, *more] if t.id not in against]
        if not against:
            # What the model misses was found with these effects taken for a part of it.
            model = freed(references, aircraft, allowed, gust, accepted.values, model.moved)
            problem = model.problem
        found = search(problem, [*others, *own], progress, ASKED)
        if set(found.accepted.values) == set(accepted.values):
            break
    found = replace(found, rivals=(*found.rivals, *_unheard(problem, found, terms, said)))
    wrong = parts(problem, found.accepted, named)
    found = replace(found, accepted=_valued(references, without, gust, problem, found.accepted))
    return Doubted(problem, found, wrong, model.shares, support)


def of_vane(name: str) -> bool:
    """Whether an effect is one of what the alpha vane shows."""
    return name.startswith(("alpha_vane.", "boom."))


def _beside(
    references: Sequence[Reference], problem: Problem, gust: Sequence[float], values: Mapping[str, float], name: str
) -> tuple[float, float]:
    """What the instruments among themselves say of an effect with the other `values` there, those as large as it
    takes."""
    others = {n: v for n, v in values.items() if n != name and n.split(".")[0] in INSTRUMENTS}
    return supported(references, problem, gust, [BY_ID[name]], others).get(name, (0.0, math.inf))


def _needless(references: Sequence[Reference], problem: Problem, gust: Sequence[float], found: Found) -> list[str]:
    """Of several effects at the vane that one which the instruments among themselves can do without beside the others,
    and which explains least alone: what the model misses is also shaped like a little of each."""
    values = found.accepted.values
    vane = [n for n in values if of_vane(n)]
    if len(vane) < 2:
        return []
    said = {n: _beside(references, problem, gust, values, n) for n in vane}
    alone = {f.ids[0]: f.cost for f in found.singles}
    needless = [n for n in vane if (said[n][0] / said[n][1]) ** 2 < SUPPORT]
    return [max(needless, key=lambda n: alone.get(n, math.inf))] if needless else []


def _valued(
    references: Sequence[Reference], without: Problem, gust: Sequence[float], problem: Problem, accepted: Fit
) -> Fit:
    """The effects with the values that instruments tell among themselves, where they can; elsewhere as sure as a value
    is that may lean to make up for the model."""
    values, sds = dict(accepted.values), dict(accepted.sds)
    for name in accepted.values:
        if name.split(".")[0] not in INSTRUMENTS:
            continue
        value, sd = _beside(references, without, gust, accepted.values, name)
        if (value / sd) ** 2 >= SUPPORT:
            values[name], sds[name] = value, sd
        else:
            leans = LEANS if name in LIKE_SLOPE else 0.5 * LEANS
            sds[name] = math.hypot(sds[name], leans * abs(values[name]))
    if not values:
        return accepted
    fit = problem.fixed(values, accepted.gust)
    return Fit(values, sds, fit.moved, fit.gust, accepted.cost)


def _free(
    references: Sequence[Reference], aircraft: Aircraft, terms: Sequence[Term], gust: Sequence[float]
) -> tuple[list[Reference], dict[str, Term], Freed]:
    """Manoeuvres with one structure of the model free, their noise as it passes through that, and the terms by
    allowance."""
    allowed, named = doubts(aircraft, [t for t in terms if _applies(t, aircraft)])
    angles = [r.flow_angle(aircraft) for r in references]
    allowed += bends(aircraft, angles, [r.record.signals["elevator"] for r in references])
    first = freed(references, aircraft, allowed, gust, {})
    moved = moved_by(aircraft, allowed, first.moved)
    heard = [heard_through(r, moved) for r in references]
    return heard, named, freed(heard, aircraft, allowed, gust, {}, first.moved)


def _applies(term: Term, aircraft: Aircraft) -> bool:
    return aircraft.unsteady.memory or term.id not in NEEDS_MEMORY


def _unheard(
    problem: Problem, found: Found, terms: Sequence[Term], said: Mapping[str, tuple[float, float]]
) -> list[Fit]:
    """What could stand in place of an effect named, were the instruments among themselves not too unsure of it to name
    it first."""
    accepted = found.accepted
    out = []
    for name in accepted.values:
        kept = {n: v for n, v in accepted.values.items() if n != name}
        for term in terms:
            ids = frozenset({*kept, term.id})
            if term.id not in said or term.id in accepted.values or ids in found.refitted:
                continue
            value, sd = said[term.id]
            if not math.isfinite(sd):
                continue
            fit = problem.refit(tuple(ids), {**kept, term.id: value}, accepted.gust)
            if fit.cost < accepted.cost + RIVAL and not _contradicted(fit, term.id, said[term.id]):
                out.append(fit)
    return out


def _contradicted(fit: Fit, name: str, said: tuple[float, float]) -> bool:
    """Whether the value that the model asks for is not the one that the instruments say, or too unsure without them."""
    value, sd = said
    found, own = fit.values[name], fit.sds[name]
    if (value / sd) ** 2 < SUPPORT and (found / own) ** 2 < UNSUPPORTED:
        return True
    return abs(found - value) > APART * math.hypot(sd, own) + LEANS * abs(value)


def _candidate(term: Term, aircraft: Aircraft, said: Mapping[str, tuple[float, float]], gusty: bool) -> bool:
    """Whether the instruments say so of an effect, and of no other much more."""
    if term.id not in said:
        return False
    if term.id.split(".")[0] in ("alpha_vane", "boom"):
        if aircraft.boom is None:
            return False  # nothing was said that could be wrong
        if gusty and term.id in HIDDEN:
            return True
    strength = {n: (v / sd) ** 2 for n, (v, sd) in said.items()}
    return strength[term.id] >= max(SUPPORT, NEXT * max(strength.values()))
