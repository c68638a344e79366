"""Where the aircraft's model itself may be in error: which of its parameters are freed, and by how much.

Terms that the profile lacks, and its derivatives well beyond their stated uncertainty, are nuisances all at once.
What the model still misses in lift, moment and drag is added to the noise of those series, so that only what exceeds it
can name anything.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.diagnosis_result import Effect, by_reduction
from station.diagnosis.effects import BY_ID, Term, derivative_effect, extended
from station.diagnosis.fit import Fit, Problem
from station.diagnosis.nonlinearity import Nonlinear
from station.diagnosis.nuisances import BIASES, DERIVATIVES, Nuisance, moved_by, nuisance_priors
from station.diagnosis.profile_changes import bias, boom, delay, derivative, unsteady
from station.diagnosis.reference import Reference, Whitener, spread
from station.diagnosis.residuals import DRAG, LIFT, MOMENT, SERIES, Spectra
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

WIDENING: Final = 3.0
"""Standard deviations of the derivatives, over those stated."""
TRIM_SD: Final[Mapping[str, float]] = {"CL_0": 0.2, "Cm_0": 0.1, "CD_0": 0.05}
"""Prior standard deviations of trim: next to nothing is known of it."""
NAMED: Final = 18.0
"""(value / standard deviation)2 from which a part of the model is named as wrong."""
LEAST_CHANGE: Final = 2.0
"""Stated standard deviations by which a derivative must have moved to be named as wrong."""
BEYOND: Final = 3.5
"""The same, with the model's structure taken as exact, under their priors."""
GYRO: Final = "q bias"
SHARES: Final = (1.0, 0.5, 0.25)
"""Of a step, tried in turn."""
ROUNDS: Final = 4
"""How often the model's misfit is found from the residuals and the model fitted again."""
WIDTH: Final = 11
"""Frequencies over which what the model misses is taken as smooth."""

ABSENT: Final[dict[str, float]] = {"Cm_alpha": 1.0, "Cm_q": 15.0, "Cm_de": 1.0, "CL_alpha": 5.0}
"""The same of derivatives that a profile does not have at all."""
NONLINEAR: Final[dict[str, float]] = {"CL_alpha3": 150.0, "Cm_alpha2": 5.0, "Cm_alpha3": 50.0}
"""The same of nonlinear lift and moment beside aero.alpha_squared: tables do not follow a parabola."""
TAIL: Final = (
    Nuisance("tail lift slope", 0.4, unsteady("tail_lift_slope")),
    Nuisance("downwash", 0.2, unsteady("downwash")),
)
"""How lift and moment are shared between wing and tail, which meet motion and gusts at different times."""
UNSTATED: Final = (
    Nuisance("vane position", 8.0, boom("vane_x")),
    Nuisance("vane upwash", 0.15, boom("upwash_body")),
    Nuisance("vane latency", 0.1, delay("alpha_vane")),
    Nuisance("vane bias", math.radians(1.0), bias("alpha_vane")),
)
"""Of a vane that the profile says nothing about: where it is, what the body does to the flow there, how late it is."""


def incomplete(aircraft: Aircraft) -> bool:
    """Whether the profile says nothing of a vane, or lacks one of the six derivatives."""
    return aircraft.boom is None or not all(aircraft.value(name) for name in DERIVATIVES)


def model_error_priors(aircraft: Aircraft, terms: Sequence[Term]) -> tuple[tuple[Nuisance, ...], dict[str, Term]]:
    """The nuisances where the model may be in error, and the terms, by nuisance, that name those that moved."""
    named: dict[str, Term] = {}
    out: list[Nuisance] = []
    for a in nuisance_priors(aircraft):
        if a.name in DERIVATIVES:
            out.append(replace(a, sd=WIDENING * a.sd))
            named[a.name] = derivative_effect(a.name, aircraft)
        else:
            out.append(replace(a, sd=TRIM_SD.get(a.name, a.sd)))
    for name, sd in (ABSENT | NONLINEAR).items():
        if not aircraft.value(name):
            out.append(Nuisance(name, sd, derivative(name), True))
            named[name] = derivative_effect(name, aircraft)
    for term in terms:
        sd = term.free_sd if aircraft.boom is None or term.free_sd_boom is None else term.free_sd_boom
        if sd:
            out.append(Nuisance(term.id, sd, term.extend))
            named[term.id] = term
    if aircraft.unsteady.memory:
        out += TAIL
    if aircraft.boom is None:
        out += UNSTATED
    return tuple(out), named


def with_constant_forces(aircraft: Aircraft) -> Aircraft:
    """An aircraft whose forces do not change: the residual against it is all of what was measured."""
    gone = {n: d.model_copy(update={"value": 0.0}) for n, d in aircraft.derivatives.items() if not n.endswith("_0")}
    drag = aircraft.drag and aircraft.drag.model_copy(update={"induced": 0.0})
    unsteady = aircraft.unsteady.model_copy(update={"memory": False})
    return aircraft.model_copy(
        update={"derivatives": {**aircraft.derivatives, **gone}, "drag": drag, "unsteady": unsteady}
    )


def structures(aircraft: Aircraft) -> tuple[Aircraft, ...]:
    """What the aircraft may be like: as the profile has it; and as the classical models have it, quasi-steady lift,
    wing and tail at one place. One is no small change of the other."""
    if not aircraft.unsteady.memory:
        return (aircraft,)
    plain = aircraft.unsteady.model_copy(update={"memory": False})
    return aircraft, aircraft.model_copy(update={"unsteady": plain})


def with_misfit_as_noise(
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


@dataclass(frozen=True, slots=True)
class Freed:
    """Manoeuvres with the model free, and what it still misses taken as noise."""

    problem: Problem
    shares: Mapping[str, float]
    """What the model misses, as a share of what was measured (root mean square), by series."""
    moved: Array
    """The nuisances, then the drift of each manoeuvre, in standard deviations."""
    cost: float
    """-2 log likelihood."""


def freed(
    references: Sequence[Reference], aircraft: Aircraft, nuisances: Sequence[Nuisance], gust: Sequence[float],
    values: Mapping[str, float], start: Array | None = None,
) -> Freed:  # fmt: skip
    """The model freed, and the noise of what it misses found from what it leaves, in turn.

    `gust` as the instruments alone have it: a model in error would take its misfit for gusts. `values` are effects
    thought to be there. `start` is what was moved before."""
    subject = extended(aircraft, values)
    whole = [r.differences(with_constant_forces(subject)) for r in references]
    strength = tuple(gust)
    moved = np.zeros(len(nuisances) + len(references)) if start is None else start

    def residuals() -> list[Spectra]:
        there = extended(moved_by(aircraft, nuisances, moved), values)
        own = moved[len(nuisances) :]
        return [r.differences(there, float(x) * r.drift_sd) for x, r in zip(own, references, strict=True)]

    for _ in range(ROUNDS):
        made = [
            with_misfit_as_noise(r, z, w, g)
            for r, z, w, g in zip(references, residuals(), whole, strength, strict=True)
        ]
        problem = Problem([m[0] for m in made], aircraft, nuisances, moved[: len(nuisances)])
        moved, cost = _on_the_way(problem, values, moved, problem.fixed(values, strength), strength)
    problem = Problem([m[0] for m in made], aircraft, nuisances, moved[: len(nuisances)])
    shares = {n: math.sqrt(sum(m[1][n][0] for m in made) / sum(m[1][n][1] for m in made)) for n in made[0][1]}
    return Freed(problem, shares, moved, cost)


def _on_the_way(
    problem: Problem, values: Mapping[str, float], start: Array, fit: Fit, gust: Sequence[float]
) -> tuple[Array, float]:
    """What is moved, as far towards a fit along straight lines as it gains, and the cost there."""
    before = problem.whole_cost(values, start, gust)
    for share in SHARES:
        trial = np.asarray(start + share * (fit.moved - start))
        cost = problem.whole_cost(values, trial, gust)
        if cost < before:
            return trial, cost
    return start, before


def parts(problem: Problem, fit: Fit, named: Mapping[str, Term]) -> tuple[Effect, ...]:
    """The parts of the model that the data have moved for good, the surest first."""
    out = []
    for nuisance, moved, sd in zip(problem.nuisances, *_posterior(problem, fit), strict=False):
        term = named.get(nuisance.name)
        if term is None or (moved / sd) ** 2 < NAMED:
            continue
        stated = problem.aircraft.derivatives.get(nuisance.name)
        if stated is not None and stated.value and abs(moved) * WIDENING < LEAST_CHANGE:
            continue
        out.append(Effect(term, float(moved * nuisance.sd), float(sd * nuisance.sd), float((moved / sd) ** 2)))
    return tuple(sorted(out, key=by_reduction))


def beyond(problem: Problem, fit: Fit) -> dict[str, Effect]:
    """Derivatives, and the gyro's bias, that the data put far outside their prior, though no residual remains; by
    nuisance."""
    far = {
        a.name: BY_ID["q.bias"] if a.name == GYRO else derivative_effect(a.name, problem.aircraft)
        for a, x in zip(problem.nuisances, fit.moved, strict=False)
        if a.name in (*DERIVATIVES, GYRO) and abs(x) > BEYOND
    }
    if not far:
        return {}
    loose = [replace(a, sd=WIDENING * a.sd) if a.name in far else a for a in problem.nuisances]
    freer = Problem(problem.references, problem.aircraft, loose)
    own = freer.refit(fit.ids, fit.values, fit.gust) if fit.values else freer.null()
    names = {term.id: name for name, term in far.items()}
    return {names[p.term.id]: p for p in parts(freer, own, far)}


LEAST_SD: Final = 0.02
"""Least standard deviation of a derivative that was found with the model in error, as a share of it."""


def corrected_profile(problem: Problem, fit: Fit) -> Aircraft:
    """The profile with the effects found, and with the model as the data have it; derivatives with what is then known
    of them. Usual biases of instruments are left out: they are of the flight."""
    aircraft = problem.aircraft
    out = extended(aircraft, fit.values)
    _, sds = _posterior(problem, fit)
    for a, moved, sd in zip(problem.nuisances, fit.moved, sds, strict=False):
        extended_by = a.extend(out, a.sd * float(moved))
        if a in BIASES or isinstance(extended_by, Nonlinear):
            continue
        out = extended_by
        known = out.derivatives.get(a.name)
        if known is not None:
            stated = aircraft.derivatives.get(a.name)
            size = abs(stated.value) if stated is not None and stated.value else 1.0
            sd_now = max(2 * a.sd * float(sd) * size, LEAST_SD * abs(known.value))
            out = out.model_copy(
                update={"derivatives": {**out.derivatives, a.name: known.model_copy(update={"sd": sd_now})}}
            )
    return out


def _posterior(problem: Problem, fit: Fit) -> tuple[Array, Array]:
    """The nuisances and their standard deviations, with the effects free, too."""
    here = problem.at(fit.values)
    own = [problem.effect_columns(BY_ID[i], fit.values, here) for i in fit.values]
    effects = [np.array([c[k] for c in own]).reshape(len(own), len(y)) for k, y in enumerate(here)]
    x, inverse, _, _ = problem.solve(here, effects, problem.nuisance_columns(fit.values, here), fit.gust)
    return x[len(own) :], np.sqrt(np.diag(inverse)[len(own) :])


def gusts(problem: Problem, fit: Fit) -> Effect | None:
    """The vertical gust as process noise: its strength, and what is lost without it."""
    here = problem.at(fit.values)
    none = [np.zeros((0, len(y))) for y in here]
    nuisances = problem.nuisance_columns(fit.values, here)
    _, _, found, cost = problem.solve(here, none, nuisances, fit.gust)
    calm, _, _, _ = problem.solve(here, none, nuisances, [0.0] * len(here), 1)
    residuals = [y + calm @ a for y, a in zip(here, nuisances, strict=True)]
    reduction = problem.cost(residuals, [0.0] * len(here), calm) - cost
    k = int(np.argmax(found))
    if reduction < NAMED or not found[k]:
        return None
    scale = problem.shares[k] / (1 + found[k] ** 2 * problem.shares[k])
    information = 0.5 * float((problem.counts[k] * scale**2).sum())
    return Effect(BY_ID["gust.vertical"], found[k], 0.5 / found[k] / math.sqrt(information), reduction)
