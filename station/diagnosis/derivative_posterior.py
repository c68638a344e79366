"""An extended aircraft's derivatives with the covariance that a diagnosis leaves them, and what follows from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.effects import BY_ID
from station.diagnosis.fit import Fit, Problem
from station.diagnosis.judge import SD_FACTOR
from station.diagnosis.measured_record import Record
from station.diagnosis.nuisances import DERIVATIVES
from station.diagnosis.procedure import Diagnosis
from station.model.airframe_error import relative_errors
from station.model.flying_qualities import Condition, Qualities, qualities
from station.profile import Aircraft

Array = NDArray[np.float64]

_STEP = 0.1
"""Over what share of a standard deviation the derivatives' slopes are taken."""


def posterior(problem: Problem, fit: Fit, alpha: float) -> Array:
    """Covariance of the DERIVATIVES (6, 6) at a fit and an angle of attack: of effects and nuisances together, priors
    included."""
    own = [BY_ID[i] for i in fit.values]
    here = problem.at(fit.values)
    columns = problem.nuisance_columns(fit.values, here)
    effects = [problem.effect_columns(t, fit.values, here) for t in own]
    stacked = [np.stack([c[k] for c in effects]) if own else np.zeros((0, len(y))) for k, y in enumerate(here)]
    _, inverse, _, _ = problem.solve(here, stacked, columns, fit.gust, 1)
    sds = np.sqrt(np.diag(inverse))

    def at(moved: Fit) -> Array:
        return np.array(list(local(problem.complete(moved), alpha).values()))

    middle = at(fit)
    slopes = np.zeros((len(DERIVATIVES), len(inverse)))
    for j, term in enumerate(own):
        step = _STEP * sds[j]
        values = {**fit.values, term.id: fit.values[term.id] + step}
        slopes[:, j] = (at(replace(fit, values=values)) - middle) / step
    for j in range(len(problem.nuisances)):
        there = fit.moved.copy()
        there[j] += _STEP
        slopes[:, len(own) + j] = (at(replace(fit, moved=there)) - middle) / _STEP
    return np.asarray(slopes @ inverse @ slopes.T * SD_FACTOR**2)


def local(aircraft: Aircraft, alpha: float) -> dict[str, float]:
    """The DERIVATIVES at an angle of attack (rad), where lift and moment are curves."""
    made = {n: aircraft.value(n) for n in DERIVATIVES}
    for c in ("CL", "Cm"):
        made[f"{c}_alpha"] += 2 * aircraft.value(f"{c}_alpha2") * alpha + 3 * aircraft.value(f"{c}_alpha3") * alpha**2
    return made


def diagnosed_qualities(found: Diagnosis) -> tuple[Qualities | str, Qualities | None]:
    """After the extension, with intervals, and before, by the profile alone; in level flight at the mean of what was
    flown. Or why there are none."""
    aircraft = found.after
    if aircraft.inertia.iyy is None:
        return "the profile gives no iyy", None
    records = [r.record for r in found.problem.references]
    at, alpha = _condition(aircraft, records)
    covariance = posterior(found.problem, found.found.accepted, alpha)
    recorded = all(r.mass is not None for r in records)
    mass, inertia = relative_errors(aircraft, ("CL_alpha", "Cm_alpha"))[int(recorded)]
    after = qualities(aircraft, at, local(aircraft, alpha), covariance, loading=(float(mass), float(inertia)))
    at, alpha = _condition(found.aircraft, records)
    before = qualities(found.aircraft, at, local(found.aircraft, alpha), 0.0 * covariance)
    return after, before


def _condition(aircraft: Aircraft, records: Sequence[Record]) -> tuple[Condition, float]:
    """The mean of what was flown, and its angle of attack (rad) by the steady vane."""

    def mean(of: Sequence[float]) -> float:
        return float(np.mean(of))

    own, boom = aircraft.inertia, aircraft.boom
    vane = mean([float(r.signals["alpha_vane"].mean()) for r in records])
    at = Condition(
        speed=mean([float(r.signals["airspeed"].mean()) for r in records]),
        density=mean([r.density for r in records]),
        mass=mean([own.mass if r.mass is None else r.mass for r in records]),
        iyy=mean([own.iyy or 1.0 if r.iyy is None else r.iyy for r in records]),
    )
    return at, vane if boom is None else (vane - boom.zero) * boom.steady_calibration
