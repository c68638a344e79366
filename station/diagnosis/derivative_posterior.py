"""An extended aircraft's derivatives with the covariance that a diagnosis leaves them, and what follows from them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.candidate import Estimate
from station.diagnosis.free_parameters import DERIVATIVES
from station.diagnosis.likelihood import Problem
from station.diagnosis.manoeuvre import Manoeuvre
from station.diagnosis.procedure import Diagnosis
from station.diagnosis.vane_gust import undone
from station.model.flying_qualities import THRUST_ARM, Condition, Qualities, bend, mixture, qualities
from station.model.late_lift import constants_of
from station.numerics.atmosphere import scale_height
from station.numerics.separation import of_wing, steady
from station.profile import Aircraft

Array = NDArray[np.float64]

APART: Final[Mapping[str, str]] = {"thrust.moment": THRUST_ARM, "aero.speed_terms": "CL_V"}
"""Effects told with their own standard error, and what of the aircraft they are."""
_STEP = 0.1
"""Over what share of a standard deviation the derivatives' slopes are taken."""
_BESIDE = 1e-4
"""rad: the lift curve is straight over as little."""


def posterior(problem: Problem, e: Estimate, about: Aircraft, alpha: float) -> Array:
    """Covariance (n, n) of what is `shown` of an aircraft over `about`, at an estimate and an angle of attack (rad): of
    effects and free parameters together, priors included."""
    values, a, covariance = e.state.values, e.state.a, e.solved.covariance

    def at(values: Mapping[str, float], a: Array) -> Array:
        return np.array(list(shown(problem.aircraft_at(values, a), about, alpha).values()))

    middle = at(values, a)
    slopes = np.zeros((len(middle), len(covariance)))
    for j, (name, value) in enumerate(values.items()):
        step = _STEP * float(np.sqrt(covariance[j, j]))
        slopes[:, j] = (at({**values, name: value + step}, a) - middle) / step
    for j in range(len(problem.frees)):
        there = a.copy()
        there[j] += _STEP
        slopes[:, len(values) + j] = (at(values, there) - middle) / _STEP
    return np.asarray(slopes @ covariance @ slopes.T)


def shown(aircraft: Aircraft, about: Aircraft, alpha: float) -> dict[str, float]:
    """The DERIVATIVES at an angle of attack (rad), and the constants that the motion depends on beside them, some over
    those of `about`: see constants_of."""
    return local(aircraft, alpha) | constants_of(aircraft, about)


def local(aircraft: Aircraft, alpha: float) -> dict[str, float]:
    """The DERIVATIVES at an angle of attack (rad), where lift and moment are curves."""
    made = {n: aircraft.value(n) for n in DERIVATIVES}
    for c in ("CL", "Cm"):
        made[f"{c}_alpha"] += bend(aircraft, c, alpha)
    if aircraft.separation.alpha_star is not None:
        (below, less), (above, more) = (steady(aircraft.separation, alpha + k * _BESIDE) for k in (-1, 1))
        from_no_lift = alpha - aircraft.separation.alpha_0
        lift = (more * (from_no_lift + _BESIDE) - less * (from_no_lift - _BESIDE)) / (2 * _BESIDE)
        made["CL_alpha"] += of_wing(aircraft) * (lift - 1)
        made["Cm_alpha"] -= aircraft.separation.Cm_X * (above - below) / (2 * _BESIDE)
    return made


def diagnosed_qualities(found: Diagnosis) -> tuple[Qualities | str, Qualities | None]:
    """After the extension, with intervals, and before, by the profile alone; in level flight at the mean of what was
    flown. Or why there are none. What is asked for and not confirmed may be there or not: intervals hold both."""
    if found.after.inertia.iyy is None:
        return "the profile gives no iyy", None
    flown = found.problem.manoeuvres
    after = _qualities(found.problem, found.found.accepted)
    if found.unconfirmed is not None:
        after = mixture(after, _qualities(found.problem, found.unconfirmed, after.condition.speed))
    at = _condition(found.aircraft, flown)
    known = local(found.aircraft, at.alpha)
    before = qualities(found.aircraft, at, known, np.zeros((len(known), len(known))))
    return after, before


def _qualities(problem: Problem, e: Estimate, speed: float | None = None) -> Qualities:
    """At a `speed` (m/s), or at the one that was flown by what the estimate says of the airspeed's error."""
    aircraft = problem.aircraft_at(e.state.values, e.state.a)
    at = _condition(aircraft, problem.manoeuvres)
    at = replace(at, speed=speed or at.speed)
    covariance, own = posterior(problem, e, aircraft, at.alpha), list(e.state.values)
    apart = {w: math.sqrt(e.solved.covariance[own.index(n), own.index(n)]) for n, w in APART.items() if n in own}
    return qualities(aircraft, at, shown(aircraft, aircraft, at.alpha), covariance, apart=apart)


def _condition(aircraft: Aircraft, flown: Sequence[Manoeuvre]) -> Condition:
    """The mean of what was flown, at the angle of attack that the vane shows steadily."""

    def mean(of: Callable[[Manoeuvre], float]) -> float:
        return float(np.mean([of(m) for m in flown]))

    def read(name: str) -> float:
        own = aircraft.instruments.get(name)
        return mean(lambda m: float(undone(m.record.signals[name], own, m.record.dt).mean()))

    boom, vane, density = aircraft.boom, read("alpha_vane"), mean(lambda m: m.record.density)
    return Condition(
        speed=read("airspeed"),
        density=density,
        mass=mean(lambda m: m.loaded(aircraft).inertia.mass),
        iyy=mean(lambda m: m.loaded(aircraft).inertia.iyy or 1.0),
        alpha=vane if boom is None else (vane - boom.zero) * boom.steady_calibration,
        scale_height=scale_height(density),
    )
