"""What attitude, rates, accelerations and ground speeds say of an effect among themselves: without aerodynamics, and
without the air."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from station.diagnosis.axis import Axis
from station.diagnosis.effects import BY_ID
from station.diagnosis.likelihood import ROUNDS, Problem
from station.diagnosis.manoeuvre import manoeuvre
from station.diagnosis.measured_record import Record
from station.diagnosis.null_fit import null
from station.diagnosis.residuals import VANE
from station.profile import Aircraft

INERTIAL: Final = frozenset(("p", "q", "r", "phi", "theta", "psi", "v_north", "v_east", "v_down"))
ACCELERATIONS: Final = frozenset(("ax", "ay", "az"))


def is_inertial(effect: str) -> bool:
    """Whether an effect is of nothing but these signals."""
    return set(BY_ID[effect].target.split()) <= INERTIAL | ACCELERATIONS


def inertial_reduction(problem: Problem, values: Mapping[str, float], effect: str) -> float:
    """By how much less likely the records are in the series that integrate accelerations and rates alone, where of the
    effects `values` (SI, by id) one is left out: a deviance, either fitted to its end."""
    axis = _alone(problem.axis)
    own = Problem([manoeuvre(m.recorded, problem.aircraft, axis) for m in problem.manoeuvres], problem.aircraft)
    others = {i: x for i, x in values.items() if i != effect and is_inertial(i)}
    fewer = null(own)
    for here in (others, {**others, effect: values[effect]}):
        without, s = fewer, fewer.state
        if here:
            begun = own.relevelled(own.beside(s, here, s.a))
            fewer = own.estimate(begun, ROUNDS, own.whole)
    return without.cost - fewer.cost


def _alone(axis: Axis) -> Axis:
    """The same motion, of whose series those of the air and of forces are not judged."""

    def unjudged(name: str, record: Record, aircraft: Aircraft) -> bool:
        return name in axis.series[VANE:] or axis.unjudged(name, record, aircraft)

    return replace(axis, unjudged=unjudged)
