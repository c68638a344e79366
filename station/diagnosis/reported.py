"""What reports tell of a diagnosis's fits: free parameters, each effect alone, the noise of each manoeuvre."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from station.conventions import LATERAL, from_si
from station.diagnosis.air_data_noise import of_signals
from station.diagnosis.effects import BY_ID
from station.diagnosis.free_parameters import DERIVATIVES
from station.diagnosis.procedure import Diagnosis

_UNITS: Final[Mapping[str, str]] = {
    "downwash delay": "ms", "gust span": "ft", "gust span, tail": "ft", "convection": "1", "upwash body": "1",
    "upwash wing": "1", "vane lead": "ft", "vane zero": "deg", "vane delay": "ms", "theta bias": "deg",
    "pressure delay": "ms", "gust span shape": "1", "turned at once": "1", "gust tilt": "1", "tail speed": "1",
    "az bias": "g", "ax bias": "g", "q bias": "deg/s", "CL_0": "1", "Cm_0": "1", "CD_0": "1",
    "CY_0": "1", "Cl_0": "1", "Cn_0": "1", "phi bias": "deg", "p bias": "deg/s", "r bias": "deg/s", "ay bias": "g",
    "principal axes": "deg", "sidewash": "1", "gust turning": "1", "sidewash delay": "ms", "fin lift slope": "1",
}  # fmt: skip
"""Units that free parameters are told in; those without one are relative to the profile's value."""


@dataclass(frozen=True, slots=True)
class Moved:
    """A free parameter as fitted."""

    name: str
    prior_sd: float
    """SI, or relative to the profile's value."""
    in_prior_sd: float
    """How far from the profile's value."""
    sd: float
    """Standard deviation that the fit leaves it, in prior standard deviations."""

    @property
    def of_derivative(self) -> bool:
        return self.name in (*DERIVATIVES, *LATERAL)

    @property
    def change(self) -> float:
        """SI, or relative."""
        return self.prior_sd * self.in_prior_sd

    @property
    def unit(self) -> str:
        """That `change` is told in."""
        return _UNITS.get(self.name, "%")

    @property
    def words(self) -> str:
        """The change with its standard deviation and unit."""
        change, sd = (from_si(x, self.unit) for x in (self.change, self.prior_sd * self.sd))
        return f"{change:+.3g} ± {sd:.2g}{'' if self.unit == '1' else f' {self.unit}'}"


def free_parameters_of(d: Diagnosis) -> list[Moved]:
    """Every free parameter as fitted."""
    e = d.found.accepted
    sds = np.sqrt(np.diag(e.solved.covariance))[len(e.state.values) :]
    return [
        Moved(f.name, f.sd, float(x), float(sd))
        for f, x, sd in zip(d.problem.frees, e.state.a, sds, strict=False)
    ]  # fmt: skip


class Alone(NamedTuple):
    """One effect as the only one: its best value, SI, and its deviance reduction then."""

    id: str
    value: float
    reduction: float


def alone(d: Diagnosis) -> list[Alone]:
    """Every effect alone, the largest reduction first: as fitted, or as the linear model has it where that was too
    little to be fitted."""
    made = []
    for reduction, name, value in d.found.singles:
        fitted = d.found.tried.get(frozenset((name,)))
        if fitted is not None and math.isfinite(fitted.cost):
            value, reduction = fitted.state.values[name], d.found.null.cost - fitted.cost
        elif value:
            # The linear model knows no range; at its end less is gained.
            share = min(max(value, BY_ID[name].low), BY_ID[name].high) / value
            value, reduction = share * value, share * (2 - share) * reduction
        made.append(Alone(name, value, max(reduction, 0.0)))
    return sorted(made, key=lambda x: (-x.reduction, x.id))


def not_accepted(d: Diagnosis) -> list[Alone]:
    """Of these, those that are neither named nor left unconfirmed by held-out data."""
    told = {e.term.id for e in (*d.effects, *d.not_named)}
    return [x for x in alone(d) if x.id not in told]


def noise_of(d: Diagnosis) -> list[dict[str, float]]:
    """Standard deviation of the white noise found for each sensor, SI, as recorded, by manoeuvre fitted."""
    levels = d.found.accepted.state.levels
    return [
        {
            name: sd / m.thinner
            for name, sd in of_signals(dict(zip(m.trim.sensors, own, strict=False)), m.record).items()
        }
        for m, own in zip(d.problem.manoeuvres, levels.noise.tolist(), strict=True)
    ]
