"""Where the aircraft's model itself is in doubt: what may be wrong with it, by how much, and what then still stands.

Three safeguards keep instruments from being blamed for the model. Terms that the profile lacks, and its derivatives
well beyond their stated uncertainty, are all allowed for at once. What the model still misses in lift, moment and drag
is added to the noise of those series, so that only what exceeds it can name anything. And an instrument is a candidate
only if the instruments among themselves, without any aerodynamics, say so too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.discrepancy.effects import (
    BY_ID,
    DERIVATIVES,
    Allowance,
    Term,
    allowances,
    bias,
    boom,
    delay,
    derivative,
    extended,
    unsteady,
)  # fmt: skip
from station.discrepancy.fit import Fit, Problem
from station.discrepancy.reference import Reference, Whitener, spread
from station.discrepancy.residuals import DOWN, DRAG, LIFT, MOMENT, NORTH, SERIES, THETA, VANE, Memo, Spectra
from station.discrepancy.search import Found, search
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

KINEMATIC: Final = (THETA, DOWN, NORTH, VANE)
"""Series in which instruments are compared with each other."""
LOOSER: Final = 3.0
"""Standard deviations of the derivatives, over those stated."""
SUPPORT: Final = 4.0
"""chi2 of an effect, of the instruments among themselves, without which an instrument is no candidate."""
APART: Final = 3.0
"""Standard deviations by which its value there may differ from the one named."""
LEANS: Final = 0.4
"""Share of its value by which an effect may lean to make up for the model."""
NEXT: Final = 0.3
"""Share of the best chi2 that another effect must have to be a candidate beside it."""
HIDDEN: Final = ("alpha_vane.delay", "alpha_vane.scale", "alpha_vane.position", "boom.flexure")
"""What a gust at the vane hides from the other instruments."""
UNSUPPORTED: Final = 50.0
"""(value / standard deviation)2 asked of an effect at the vane in turbulence that the other instruments neither confirm
nor deny: the gust hides it from them."""
ASKED: Final = 25.0
"""Drop of -2 log likelihood asked of a first effect: noise made of what a model misses is not noise."""
TRIM: Final[Mapping[str, float]] = {"CL_0": 0.2, "Cm_0": 0.1, "CD_0": 0.05}
"""Standard deviations of what says where the aircraft trims: next to nothing is known of it."""
NAMED: Final = 18.0
"""(value / standard deviation)2 from which a part of the model is named as wrong."""
LEAST_CHANGE: Final = 2.0
"""Stated standard deviations by which a derivative must have moved to be named as wrong."""
MOST_ROUNDS: Final = 3
ROUNDS: Final = 3
"""How often what the model misses is found from what is left and the model fitted again."""
WIDTH: Final = 11
"""Frequencies over which what the model misses is taken as smooth."""

LOOSE: Final[Mapping[str, float]] = {
    "aero.alpha_squared": 15.0, "aero.speed_terms": 0.5, "aero.unsteady_lift": 1.0, "gust.tail_penetration": 0.5,
    "aero.downwash_lag": 0.05, "aero.CL_q": 15.0, "aero.CL_de": 0.5, "thrust.moment": 0.3,
}  # fmt: skip
"""Standard deviations, SI, of the parts that a model may lack, where nothing is known."""
ABSENT: Final[Mapping[str, float]] = {"Cm_alpha": 1.0, "Cm_q": 15.0, "Cm_de": 1.0, "CL_alpha": 5.0}
"""The same of derivatives that a profile does not have at all."""
TAIL: Final = (
    Allowance("tail lift slope", 0.4, unsteady("tail_lift_slope")),
    Allowance("downwash", 0.2, unsteady("downwash")),
)
"""How lift and moment are shared between wing and tail, which meet motion and gusts at different times."""
UNSTATED: Final = (
    Allowance("vane position", 8.0, boom("vane_x")),
    Allowance("vane upwash", 0.15, boom("upwash_body")),
    Allowance("vane latency", 0.1, delay("alpha_vane")),
    Allowance("vane zero", math.radians(1.0), bias("alpha_vane")),
)
"""Of a vane that the profile says nothing about: where it is, what the body does to the flow there, how late it is."""

GAINS: Final = (
    "mass.scale", "inertia.scale", "cg.shift", "aero.icing", "elevator.scale", "dynamic_pressure.scale",
)  # fmt: skip
"""Effects that act as wrong derivatives do: no candidates where those are wrong or not known well."""
SURE: Final = 0.15
"""Standard deviation of a freed derivative, as a share of it, up to which it is known well."""
INSTRUMENTS: Final = ("alpha_vane", "boom", "accelerometer", "q", "imu", "theta", "velocity")
"""First parts of the ids that instruments can check among themselves."""


GUST: Final = Term(
    "gust.vertical", "alpha_vane CL Cm", 0, "m/s", "m/s", 0, 20, 0.1,
    "The air moves: a vertical gust of {value} (standard deviation), process noise that the profile's model lacks.",
    "the same manoeuvre in calm air", lambda a, _: a,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Part:
    """A part of the model that was allowed for, and where the data have moved it."""

    term: Term
    value: float
    sd: float
    drop: float


def incomplete(aircraft: Aircraft) -> bool:
    """Whether the profile says nothing of a vane, or lacks one of the six derivatives."""
    return aircraft.boom is None or not all(aircraft.value(name) for name in DERIVATIVES)


def doubts(aircraft: Aircraft, terms: Sequence[Term]) -> tuple[tuple[Allowance, ...], dict[str, Term]]:
    """What is allowed for where the model is in doubt, and the terms, by allowance, that name what was moved."""
    named: dict[str, Term] = {}
    out: list[Allowance] = []
    for a in allowances(aircraft):
        if a.name in DERIVATIVES:
            out.append(replace(a, sd=LOOSER * a.sd))
            named[a.name] = _derivative_term(a.name, aircraft)
        else:
            out.append(replace(a, sd=TRIM.get(a.name, a.sd)))
    for name, sd in ABSENT.items():
        if not aircraft.value(name):
            out.append(Allowance(name, sd, derivative(name), True))
            named[name] = _derivative_term(name, aircraft)
    for term in terms:
        if term.id in LOOSE:
            out.append(Allowance(term.id, LOOSE[term.id], term.extend))
            named[term.id] = term
    if aircraft.unsteady.memory:
        out += TAIL
    if aircraft.boom is None:
        out += UNSTATED
    return tuple(out), named


def _derivative_term(name: str, aircraft: Aircraft) -> Term:
    known = f"aero.{name}"
    stated = aircraft.value(name)
    if not stated and known in BY_ID:
        return BY_ID[known]
    if not stated:
        return Term(known, name[:2], 0, "1", "1", -math.inf, math.inf, 1.0, f"The model lacks {name} = {{value}}.",
                    "a multisine in calm air", derivative(name), aerodynamic=True)  # fmt: skip
    return Term(known, name[:2], 0, "1", "%", -1, 3, 0.05, f"{name} is {{value}} off the profile's.",
                "a multisine in calm air", derivative(name, relative=True), aerodynamic=True)  # fmt: skip


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


def _still(aircraft: Aircraft) -> Aircraft:
    """An aircraft whose forces do not change: what is left against it is all of what was measured."""
    gone = {n: d.model_copy(update={"value": 0.0}) for n, d in aircraft.derivatives.items() if not n.endswith("_0")}
    drag = aircraft.drag and aircraft.drag.model_copy(update={"induced": 0.0})
    unsteady = aircraft.unsteady.model_copy(update={"memory": False})
    return aircraft.model_copy(
        update={"derivatives": {**aircraft.derivatives, **gone}, "drag": drag, "unsteady": unsteady}
    )


def tolerant(
    reference: Reference, left: Spectra, whole: Spectra, gust: float
) -> tuple[Reference, dict[str, tuple[float, float]]]:
    """The manoeuvre with what the model leaves in lift, moment and drag taken as noise; and by series the power of that
    and of all that was measured (`whole`)."""
    calm, turbulent = spread(reference.bins)
    own = calm + gust**2 * turbulent
    wide = calm.copy()
    powers = {}
    for row, j in enumerate(reference.setting.judged):
        if j not in (LIFT, MOMENT, DRAG):
            continue
        excess = np.maximum(_smooth(np.abs(left.bins[row]) ** 2) - own[:, row, row].real, 0.0)
        wide[:, row, row] += excess
        powers[SERIES[j]] = float(excess.sum()), float((np.abs(whole.bins[row]) ** 2).sum())
    return replace(reference, bins=Whitener.of(wide, turbulent)), powers


def _smooth(x: Array) -> Array:
    """Mean over WIDTH neighbours, fewer at the ends."""
    width = min(WIDTH, len(x))
    ones = np.ones(width)
    return np.asarray(np.convolve(x, ones, "same") / np.convolve(np.ones(len(x)), ones, "same"))


def alone(references: Sequence[Reference], aircraft: Aircraft) -> Problem:
    """What the instruments say of each other, without aerodynamics."""
    aerodynamic = {*DERIVATIVES, *ABSENT, "CL_0", "Cm_0", "CD_0"}
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
    shows, and an effect that goes with the motion would be seen in every gust."""
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
        column = motion.effect_columns(term, {}, still)
        cross = sum((a * w) @ c for a, w, c in zip(allowed, weights, column, strict=True))
        own = sum(float((c * w) @ c) for w, c in zip(weights, column, strict=True))
        slope = sum(float((c * w) @ data) for w, c, data in zip(weights, column, y, strict=True))
        free = own - float(cross @ np.linalg.solve(inner, cross))
        slope -= float(cross @ np.linalg.solve(inner, right))
        out[term.id] = (-slope / free, 1 / math.sqrt(free)) if free > 1e-6 * own else (0.0, math.inf)
    return out


def doubtful(
    references: Sequence[Reference], aircraft: Aircraft, allowed: Sequence[Allowance], gust: Sequence[float],
    values: Mapping[str, float],
) -> tuple[Problem, dict[str, float]]:  # fmt: skip
    """The manoeuvres with an allowance for what the model misses, found from what it leaves, and its share of what was
    measured, by series.

    `gust` as the instruments alone have it: a model in doubt would take its own errors for gusts. `values` are effects
    thought to be there."""
    subject = extended(aircraft, values)
    whole = [r.differences(_still(subject)) for r in references]
    left = [r.differences(subject) for r in references]
    strength = tuple(gust)
    for _ in range(ROUNDS):
        made = [tolerant(r, z, w, g) for r, z, w, g in zip(references, left, whole, strength, strict=True)]
        problem = Problem([m[0] for m in made], aircraft, allowed)
        fit = problem.fixed(values, strength)
        moved = problem.complete(fit)
        left = [r.differences(moved, problem.drift(fit, k)) for k, r in enumerate(references)]
    shares = {n: math.sqrt(sum(m[1][n][0] for m in made) / sum(m[1][n][1] for m in made)) for n in made[0][1]}
    return problem, shares


def parts(problem: Problem, fit: Fit, named: Mapping[str, Term]) -> tuple[Part, ...]:
    """The parts of the model that the data have moved for good, the surest first."""
    out = []
    for allowance, moved, sd in zip(problem.allowed, *_posterior(problem, fit), strict=False):
        term = named.get(allowance.name)
        if term is None or (moved / sd) ** 2 < NAMED:
            continue
        stated = problem.aircraft.derivatives.get(allowance.name)
        if stated is not None and stated.value and abs(moved) * LOOSER < LEAST_CHANGE:
            continue
        out.append(Part(term, float(moved * allowance.sd), float(sd * allowance.sd), float((moved / sd) ** 2)))
    return tuple(sorted(out, key=lambda p: -p.drop))


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
    said = supported(references, without, gust, terms, {})
    support = {n: (v / sd) ** 2 for n, (v, sd) in said.items()}
    allowed, named = doubts(aircraft, terms)
    problem, shares = doubtful(references, aircraft, allowed, gust, {})
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
        instruments = {n: v for n, v in accepted.values.items() if n in said and n not in against}
        beside = supported(references, without, gust, terms, instruments)
        more = [t for t in terms if t not in own and _candidate(t, aircraft, beside, False)]
        said = {**said, **{t.id: beside[t.id] for t in more}}
        own = [t for t in [*own, *more] if t.id not in against]
        if not against:
            # What the model misses was found with these effects taken for a part of it.
            problem, shares = doubtful(references, aircraft, allowed, gust, accepted.values)
        found = search(problem, [*others, *own], progress, ASKED)
        if set(found.accepted.values) == set(accepted.values):
            break
    return Doubted(problem, found, parts(problem, found.accepted, named), shares, support)


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


BIASES: Final = ("theta bias", "az bias", "ax bias", "q bias")
MOST_MISSED: Final = 0.25
"""Share of what was measured of lift or moment that a model may miss and still be a model."""
TOLD: Final = 0.02
"""Least standard deviation of a derivative that was found with the model in doubt, as a share of it."""


def mended(d: Doubted, aircraft: Aircraft) -> Aircraft:
    """The profile with the effects found, and with the model as the data have it; derivatives with what is then known
    of them. Zeros of instruments within what is usual are left out: they are of the flight."""
    fit = d.found.accepted
    out = extended(aircraft, fit.values)
    _, sds = _posterior(d.problem, fit)
    for a, moved, sd in zip(d.problem.allowed, fit.moved, sds, strict=False):
        if a.name in BIASES:
            continue
        out = a.extend(out, a.sd * float(moved))
        known = out.derivatives.get(a.name)
        if known is not None:
            stated = aircraft.derivatives.get(a.name)
            size = abs(stated.value) if stated is not None and stated.value else 1.0
            sd_now = max(2 * a.sd * float(sd) * size, TOLD * abs(known.value))
            out = out.model_copy(
                update={"derivatives": {**out.derivatives, a.name: known.model_copy(update={"sd": sd_now})}}
            )
    return out


def _posterior(problem: Problem, fit: Fit) -> tuple[Array, Array]:
    """What is allowed for, and its standard deviation, with the effects free beside it."""
    here = problem.at(fit.values)
    own = [problem.effect_columns(BY_ID[i], fit.values, here) for i in fit.values]
    effects = [np.array([c[k] for c in own]).reshape(len(own), len(y)) for k, y in enumerate(here)]
    x, inverse, _, _ = problem.solve(here, effects, problem.allowed_columns(fit.values, here), fit.gust)
    return x[len(own) :], np.sqrt(np.diag(inverse)[len(own) :])


def gusts(problem: Problem, fit: Fit) -> Part | None:
    """The vertical gust as process noise: its strength, and what is lost without it."""
    here = problem.at(fit.values)
    none = [np.zeros((0, len(y))) for y in here]
    allowed = problem.allowed_columns(fit.values, here)
    _, _, found, cost = problem.solve(here, none, allowed, fit.gust)
    still, _, _, _ = problem.solve(here, none, allowed, [0.0] * len(here), 1)
    left = [y + still @ a for y, a in zip(here, allowed, strict=True)]
    drop = problem.cost(left, [0.0] * len(here), still) - cost
    k = int(np.argmax(found))
    if drop < NAMED or not found[k]:
        return None
    scale = problem.shares[k] / (1 + found[k] ** 2 * problem.shares[k])
    information = 0.5 * float((problem.counts[k] * scale**2).sum())
    return Part(GUST, found[k], 0.5 / found[k] / math.sqrt(information), drop)
